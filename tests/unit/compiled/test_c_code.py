"""Generated C: what Python's numbers and tables are there, and where a batch of cars goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from steerkit._support import native
from steerkit.compiled import compile
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, Out, State
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Table
from steerkit.diagram.simulation import simulate
from tests.support.traced_blocks import mixed_loop, oscillating_loop, worst

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="needs a C compiler")


@dataclass(frozen=True, eq=False, kw_only=True)
class Asks(Block):
    """Counts up from `start` and asks a table of three rows, unlimited; `floor` bounds it from below."""

    row = Out("1", direct=())
    count = Out("1", direct=())
    start: float = 0.0
    floor: float = -math.inf
    table: Table = field(default_factory=lambda: Table([[5.0], [6.0], [7.0]]))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(self.start, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        (value,) = self.table(x[0])
        return self.Y(value, m.maximum(x[0], self.floor))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (x[0] + 1.0,)


@pytest.mark.parametrize("cars", [None, 5])
def test_a_table_asked_outside_of_its_rows_answers_nan(cars: int | None) -> None:
    loop = Loop(blocks={"asks": Asks()}, wires=[])
    below = m.filled(-3.0, () if cars is None else (cars,))
    start = loop.with_block_state(loop.init(batch=cars), "asks", (below,))
    log = compile(loop, backend="c").run(0.5, state=start, allow_nonfinite=True)
    column = log["asks.row"] if cars is None else log["asks.row"][:, -1]
    np.testing.assert_array_equal(column, [*[math.nan] * 3, 5.0, 6.0, 7.0, *[math.nan] * 4])


@pytest.mark.parametrize("floor", [-math.inf, -2.0])
def test_infinite_parameters_keep_their_sign(floor: float) -> None:
    loop = Loop(blocks={"asks": Asks(floor=floor)}, wires=[])
    start = loop.with_block_state(loop.init(), "asks", (-5.0,))
    log = compile(loop, backend="c").run(0.3, state=start, allow_nonfinite=True)
    np.testing.assert_array_equal(log["asks.count"], np.maximum(np.arange(-5.0, 1.0), floor))


@pytest.mark.parametrize("every", [2, 3])
def test_many_cars_go_on_from_any_tick_with_any_decimation(every: int) -> None:
    loop = mixed_loop(0.025)
    record = ["mixed.y", "decay.x"]
    program = compile(loop, backend="c", every=every, record=record)
    first, reference = program.run(0.325, batch=5), simulate(loop, 0.325, batch=5, every=every, record=record)
    assert worst(first, reference) <= 1e-13
    assert first.state.k % every
    second = program.run(0.7, state=first.state)
    assert worst(second, simulate(loop, 0.7, state=reference.state, every=every, record=record)) <= 1e-13


def test_cars_with_several_held_values_each_keep_their_own() -> None:
    """Collapsed for one value, cars of another one would all swing alike."""
    loop = oscillating_loop()
    program = compile(loop, backend="c", collapse=True)
    values = np.array([4.0, 9.0, 1.0])
    start = loop.with_block_state(loop.init(batch=3), "held", (values,))
    log = program.run(3.0, state=start)
    np.testing.assert_allclose(log["oscillator.x"], np.cos(np.sqrt(values) * log.t[:, None]), atol=1e-8)
