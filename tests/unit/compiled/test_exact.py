"""Generated C that gives the bits of Python's floats, or stops where Python has an exception."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from steerkit._support.native import compiler
from steerkit.compiled.exact import ExactProgram
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Table

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")

TABLE = Table(np.random.default_rng(0).normal(size=(7, 3)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Walk(Block):
    """A number that jumps about, by every function that equations have."""

    value = Out("1", direct=())
    gain: float = 0.7
    divisor: float = 3.0
    far: float = 0.0
    dt: float = 0.01

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (m.filled(0.3, batch), m.filled(-1.7, batch))

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0])

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        a, b = x
        row = TABLE(m.floor(3.5 + 3.4 * m.sin(7.0 * a)) + self.far)
        c = m.sin(a) * m.cos(a) + m.tan(0.3 * b) - m.tanh(a * b) / self.divisor + self.gain * row[0] * m.atan(b)
        d = m.exp(-m.absolute(b)) + m.log(1.0 + a * a) - m.sqrt(m.absolute(c)) + m.atan2(a, b) * row[2] + 0.01 * t
        return m.wrap(3.0 * c + row[1]), m.where(d > 0.5, d - 1.3, m.clip(d * 1.1, -2.0, 2.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Slow(Walk):
    """The same, every third tick."""

    dt: float = 0.03


def rows_of(loop: Loop, k: int, samples: int, ticks: int, state: Any) -> tuple[list[Any], list[Any]]:
    x, y = list(state.x), list(state.y)
    first, last = [], []
    for tick in range(k, k + samples * ticks):
        loop.advance(tick, x, y)
        now = [v for block in x for v in block] + [v for block in y for v in block]
        if (tick - k) % ticks == 0:
            first.append(now)
        if (tick - k) % ticks == ticks - 1:
            last.append(now)
    return first, last


def run(program: ExactProgram, k: int, samples: int, state: Any, *parameters: float) -> tuple[Any, Any]:
    return program.run(k, samples, np.array(program.trace.layout.pack(state.x, state.y)), np.array(parameters))


@pytest.mark.parametrize(("ticks", "k"), [(1, 0), (5, 0), (5, 10), (2, 7)])
def test_every_sample_has_the_bits_of_the_interpreted_loop(ticks: int, k: int) -> None:
    loop = Loop(blocks={"fast": Walk(), "slow": Slow()}, wires=[])
    program = ExactProgram(loop, ticks=ticks)
    first, last = run(program, k, 300, loop.init())
    plainly = rows_of(loop, k, 300, ticks, loop.init())
    assert first.tobytes() == np.array(plainly[0]).tobytes()
    assert last.tobytes() == np.array(plainly[1]).tobytes()
    assert len(np.unique(first[:, 0])) > 290


def test_open_parameters_are_those_of_the_run() -> None:
    program = ExactProgram(Loop(blocks={"fast": Walk()}, wires=[]), ticks=2, parameters=["fast.gain"])
    for gain in (0.7, -0.2):
        loop = Loop(blocks={"fast": Walk(gain=gain)}, wires=[])
        _, last = run(program, 0, 50, loop.init(), gain)
        assert last.tobytes() == np.array(rows_of(loop, 0, 50, 2, loop.init())[1]).tobytes()


@pytest.mark.parametrize("fault", [{"divisor": 0.0}, {"far": 9.0}, {"far": -9.0}, {"far": math.nan}])
def test_it_stops_before_a_sample_in_which_python_might_raise(fault: dict[str, float]) -> None:
    name, value = next(iter(fault.items()))
    program = ExactProgram(Loop(blocks={"fast": Walk()}, wires=[]), ticks=2, parameters=[f"fast.{name}"])
    loop = Loop(blocks={"fast": Walk(**fault)}, wires=[])
    first, last = run(program, 0, 10, loop.init(), value)
    assert len(first) == len(last) == 0
    if value == -9.0:
        return  # Python counts a negative index from the end; C does not begin to
    with pytest.raises((ZeroDivisionError, IndexError, ValueError)):
        rows_of(loop, 0, 1, 2, loop.init())


@dataclass(frozen=True, eq=False, kw_only=True)
class Inverse(Block):
    """At most five, which an infinity would be as well."""

    value = Out("1", direct=())
    divisor: float = 3.0
    dt: float = 0.01

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(m.minimum(5.0, 1.0 / self.divisor))


def test_an_infinity_that_shows_nowhere_stops_it_where_python_does_not_divide() -> None:
    program = ExactProgram(Loop(blocks={"one": Inverse()}, wires=[]), ticks=1, parameters=["one.divisor"])
    state = program.trace.layout
    for divisor, done in ((0.1, 10), (0.0, 0)):
        loop = Loop(blocks={"one": Inverse(divisor=divisor or 1.0)}, wires=[])
        slots = np.array(state.pack(loop.init().x, loop.init().y))
        first, _ = program.run(0, 10, slots, np.array([divisor]))
        assert len(first) == done
    with pytest.raises(ZeroDivisionError):
        Inverse(divisor=0.0).output(0.0, (), ())


def test_a_number_that_overflows_stops_it_too_and_the_samples_before_are_there() -> None:
    loop = Loop(blocks={"fast": Walk(gain=2.0)}, wires=[])
    program = ExactProgram(loop, ticks=1, parameters=["fast.gain"])
    state = loop.init()
    first, _ = run(program, 0, 10, state, 1e308)
    assert len(first) < 10


def test_loops_that_differ_in_their_course_alone_are_the_same_c() -> None:
    sources = []
    for rows in (TABLE, Table(np.ones((4, 3)))):
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(globals(), "TABLE", rows)
            sources.append(ExactProgram(Loop(blocks={"fast": Walk()}, wires=[]), ticks=2).source)
    assert sources[0] == sources[1]
