"""Blocks that call code of their own: compiled loops call it too, and where they cannot, they say so."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit import compiled
from steerkit._support import native
from steerkit.compiled import Compiled, TraceError, compile
from steerkit.compiled.trace import trace
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.export.c import export_c
from tests.support.traced_blocks import Held, mixed_loop, worst

TABLE = m.Table([[0.5 * i, 1.0 + i] for i in range(9)])


def root(a: float, b: float) -> tuple[float, float]:
    x, step, n = 0.0, 1.0, 0
    while step * step > 1e-28:
        step = (x * x * x + x - a * b) / (3.0 * x * x + 1.0)
        x, n = x - step, n + 1
    return x, float(n)


@dataclass(frozen=True, eq=False, kw_only=True)
class Rooted(Block):
    """x with x^3 + x = (given + sum) factor; the steps that it took choose a row of a table, the next factor."""

    given = In("1")
    x = Out("1")
    steps = Out("1")

    @cached_property
    def calls(self) -> np.ndarray:
        return np.zeros(1)

    @cached_property
    def routine(self) -> m.Routine:
        return m.Routine(name="Rooted", size=2, call=self.root)

    def root(self, a: float, b: float) -> tuple[float, float]:
        self.calls[0] += 1.0
        return root(a, b)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(1.0, batch), m.filled(0.0, batch))

    def output(self, t: Any, x: State, u: Any) -> Any:
        if not m.is_symbol(x[0]) and np.ndim(x[0]):  # a batch, car by car
            each = [self.output(t, (float(a), float(b)), self.D(float(g))) for a, b, g in zip(*x, u.given)]
            return self.Y(*map(np.array, zip(*each)))
        found, steps = self.routine(u.given + x[1], x[0])
        row = TABLE(m.minimum(steps, 8.0))
        again, _ = self.routine(row[1], found)
        same, _ = self.routine(u.given + x[1], x[0])
        return self.Y(again + 0.0 * same, steps)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (TABLE(m.minimum(y.steps, 8.0))[0], 0.5 * x[1] + y.x)


def loop_of(value: float = 3.0) -> Loop:
    held, rooted = Held(value=value), Rooted()
    return Loop(blocks={"held": held, "rooted": rooted}, wires=[(held.v, rooted.given)])


@pytest.mark.parametrize("backend", ["c", "python"])
def test_a_routine_is_called_by_compiled_loops(backend: Any) -> None:
    loop = loop_of()
    simulated, program = simulate(loop, 2.0), compile(loop, backend=backend)
    assert np.ptp(simulated["rooted.x"]) > 0.1
    assert np.ptp(simulated["rooted.steps"]) > 0.0
    rooted, start = vars(loop.blocks["rooted"]), loop.init()
    rooted["calls"][0] = 0.0
    assert worst(program.run(2.0, state=start), simulated) <= 1e-13
    assert rooted["calls"][0] == 80.0  # the third call asks what the first did


@pytest.mark.parametrize("backend", ["c", "python"])
def test_cars_are_run_one_after_the_other(backend: Any) -> None:
    loop = loop_of()
    program = compile(loop, backend=backend, parameters=["held.value"])
    values = np.array([1.0, 3.0, -2.0])
    together = program.run(1.0, parameters={"held.value": values})
    for car, value in enumerate(values):
        alone = simulate(loop_of(float(value)), 1.0)
        np.testing.assert_allclose(together["rooted.x"][:, car], alone["rooted.x"], atol=1e-13)
        assert together.state.x[1][0][car] == pytest.approx(alone.state.x[1][0], abs=1e-13)


def test_two_programs_of_one_routine_take_turns() -> None:
    """A routine may keep its workspace: while somebody else calls it, a compiled loop waits."""
    loop = loop_of()
    program, rooted, start = compile(loop, backend="c"), loop.blocks["rooted"], loop.init()
    program.run(0.1)
    done = threading.Event()
    with rooted.routine.lock:  # type: ignore[attr-defined]
        thread = threading.Thread(target=lambda: (program.run(0.1, state=start), done.set()), daemon=True)
        thread.start()
        assert not done.wait(0.2)
    assert done.wait(30.0)


def test_what_has_no_place_for_a_routine_says_so(tmp_path: Path) -> None:
    loop = loop_of()
    for attempt in (lambda: trace(loop), lambda: export_c(loop, tmp_path, blocks=("rooted",))):
        with pytest.raises(TraceError, match=r"\(Rooted\).*Rooted runs code of its own.*only compiled loops"):
            attempt()


@pytest.mark.parametrize("backend", ["c", "python"])
@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
def test_an_error_of_a_routine_is_raised_and_the_next_run_is_not_harmed(backend: Any, error: Any) -> None:
    loop = loop_of()
    program, rooted, start = compile(loop, backend=backend), vars(loop.blocks["rooted"]), loop.init()
    expected = program.run(1.0, state=start)["rooted.x"]
    call, failed = rooted["routine"].call, []

    def fail(a: float, b: float) -> Any:
        failed.append(a)
        raise error

    rooted["routine"].call = fail
    with pytest.raises(error):
        program.run(1.0, state=start)
    assert len(failed) == 1
    rooted["routine"].call = call
    np.testing.assert_array_equal(program.run(1.0, state=start)["rooted.x"], expected)


@pytest.mark.parametrize("cars", [17, 70, 200])
def test_threads_share_all_cars_among_them(cars: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part a core, or four; to the last bit what one thread drives."""
    program = compile(mixed_loop(0.05), backend="c")
    monkeypatch.setattr(compiled.os, "sched_getaffinity", lambda _: range(3), raising=False)
    pools: list[int] = []
    monkeypatch.setattr(compiled, "ThreadPoolExecutor", lambda n: pools.append(n) or ThreadPoolExecutor(n))
    alone = program.run(2.0, batch=cars)
    assert not pools, "too little to do for threads"
    monkeypatch.setattr(compiled, "_ENOUGH", 0.0)
    shared = program.run(2.0, batch=cars)
    assert pools == [3]
    assert np.ptp(alone["mixed.noise"][5]) > 0.1
    for name in alone:
        np.testing.assert_array_equal(shared[name], alone[name], err_msg=name)
    for ours, theirs in zip(shared.state.x, alone.state.x, strict=True):
        np.testing.assert_array_equal(np.array(ours), np.array(theirs))


@dataclass(frozen=True, eq=False, kw_only=True)
class Logistic(Block):
    """x(k+1) = a x - a x^2, chaotic: a bit that is rounded another way is a different number thirty steps later."""

    x, rest = Out("1", direct=()), Out("1", direct=())
    a: float = 3.9
    dt: float = 0.05

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.3, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0], 1.0 - x[0] * x[0])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (self.a * x[0] - self.a * x[0] * x[0],)


def chaos() -> Compiled:
    """The program of a loop in which every rounding shows."""
    return compile(Loop(blocks={"logistic": Logistic()}, wires=[]), backend="c")


@pytest.mark.parametrize("batch", [None, 5])
def test_a_run_that_goes_on_has_the_bits_of_one_that_never_stopped(batch: int | None) -> None:
    """The state comes from the loop itself; what is carried in it is as the run has rounded it."""
    program = chaos()
    whole = program.run(6.0, batch=batch)
    for first in map(float, np.arange(0.05, 2.0, 0.05)):
        start = program.run(first, batch=batch)
        rest = program.run(6.0 - first, state=start.state)
        for name in whole:
            np.testing.assert_array_equal(np.concatenate([start[name], rest[name]]), whole[name], err_msg=name)


def test_the_state_after_a_run_is_made_when_it_is_asked_for_and_is_the_last_row(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    load, loads = native.load, list[str]()
    monkeypatch.setattr(native, "load", lambda *a, **k: loads.append(a[0]) or load(*a, **k))
    program = chaos()
    for ticks in range(1, 40):
        log = program.run(0.05 * ticks)
        assert log.state.y == ((log["logistic.x"][-1], log["logistic.rest"][-1]),)
    assert len(loads) == 1, "it needs no code of its own"


@pytest.mark.parametrize("batch", [None, 5])
def test_who_writes_into_a_log_does_not_change_the_state_after_it(batch: int | None) -> None:
    program = chaos()
    untouched, scaled = program.run(1.0, batch=batch), program.run(1.0, batch=batch)
    for name in scaled:
        scaled[name][...] *= 3.6
    np.testing.assert_array_equal(np.array(scaled.state.y), np.array(untouched.state.y))
