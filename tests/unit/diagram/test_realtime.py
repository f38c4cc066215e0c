"""The runner, on a clock that the test moves: no drift, misses counted and acted on, slots left out."""

import gc
import math
import os
import resource
from dataclasses import dataclass, field
from typing import Any

import pytest

from steerkit._support.clock import Clock
from steerkit.diagram.block import Block, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.realtime import BIN, Run, Timing, preferred, run


@pytest.fixture(autouse=True, scope="module")
def frozen() -> None:
    """A run looks for garbage before it begins; that of other tests is none of ours."""
    gc.freeze()


class Hand(Clock):
    """A clock that stands still until somebody waits or works."""

    def __init__(self, late: dict[int, float] | None = None):
        super().__init__()
        self.t, self.waits = 1000.0, list[float]()
        self.late = late or {}
        """How much later than asked the n-th wait returns."""

    def now(self) -> float:
        return self.t

    def sleep_until(self, t: float) -> None:
        self.waits.append(t)
        self.t = max(self.t, t + self.late.get(len(self.waits) - 1, 0.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Worker(Block):
    """Counts, and takes its time."""

    n = Out("1", direct=())
    work: dict[int, float] = field(default_factory=dict)
    clock: Hand = field(default_factory=Hand)
    dt: float = 0.05

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (0.0,)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0])

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        self.clock.t += self.work.get(int(x[0]), 0.001)
        return (x[0] + 1.0,)


Late = dict[int, float] | None


def go(work: Late = None, late: Late = None, seconds: float = 1.0, **options: Any) -> Any:
    clock = Hand(late)
    worker = Worker(work=work or {}, clock=clock)
    return run(Loop(blocks={"worker": worker}, wires=[]), seconds, timer=clock, **options), clock


EVEN = {k: 0.01 + 0.001 * (k % 7) for k in range(20)} | {12: 0.05}
"""Work that is done just in time."""


@pytest.mark.parametrize(
    ("work", "late", "misses", "slots", "worst"),
    [
        (EVEN, {k: 0.0005 * (k % 3) for k in range(20)}, 0, range(20), 0.001),
        ({3: 0.06}, {}, 1, range(20), 0.01),  # the next one comes at once
        ({3: 0.17}, {}, 3, (0, 1, 2, 3, *range(6, 20)), 0.02),  # slots that have passed are left out
        ({}, {4: 0.055}, 1, range(20), 0.055),  # the system wakes us too late
    ],
)
def test_every_step_is_due_at_start_plus_k_dt(work: Late, late: Late, misses: int, slots: Any, worst: float) -> None:
    live, clock = go(work, late)
    assert (live.timing.misses, live.timing.steps, live.k) == (misses, len(slots), len(slots))
    assert clock.waits == pytest.approx([1000.0 + 0.05 * k for k in slots], abs=1e-9)
    assert live.timing.worst == pytest.approx(worst)


def test_misses_are_told_at_once_and_may_end_the_run() -> None:
    told: list[tuple[int, int]] = []

    def on_miss(live: Run) -> bool:
        told.append((live.k, live.timing.misses))
        return live.timing.misses >= 3

    live, _ = go({3: 0.06, 6: 0.06, 9: 0.06, 12: 0.06}, on_miss=on_miss)
    assert told == [(4, 1), (7, 2), (10, 3)]
    assert live.k == 10


def test_the_watcher_ends_the_run_and_may_start_the_loop_again() -> None:
    def watch(live: Run) -> bool:
        if live.k == 5 and live.timing.steps < 10:
            live.restart(live.loop.init())
        return live.timing.steps == 12

    live, _ = go(watch=watch)
    assert live.timing.steps == 12
    assert live.k == 7


def test_an_exception_says_when_and_garbage_is_collected_again() -> None:
    def watch(live: Run) -> bool:
        assert not gc.isenabled()
        return False

    @dataclass(frozen=True, eq=False, kw_only=True)
    class Broken(Worker):
        def output(self, t: Any, x: Any, u: Any) -> Any:
            if x[0] == 7.0:
                raise RuntimeError("gone")
            return self.Y(x[0])

    clock = Hand()
    with pytest.raises(RuntimeError) as caught:
        run(Loop(blocks={"worker": Broken(clock=clock)}, wires=[]), 1.0, timer=clock, watch=watch)
    assert "in tick 7" in caught.value.__notes__[0]
    assert gc.isenabled()


def test_jitter_comes_from_the_histogram() -> None:
    timing = Timing(period=0.05)
    for k in range(1000):
        timing.started(1e-4 if k < 985 else 5e-3)
    assert timing.jitter(0.5) == pytest.approx(1e-4, abs=1.01 * BIN)
    assert timing.jitter(0.99) == pytest.approx(5e-3, abs=1.01 * BIN)
    assert math.isnan(Timing(period=0.05).jitter(0.5))
    assert timing.jitter(0.5) >= 1e-4 - 1e-12, "half of them stayed below it"
    assert timing.jitter(0.99) >= 5e-3 - 1e-12
    assert timing.summary()["steps"] == 1000


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan])
def test_bad_durations(duration: float) -> None:
    with pytest.raises(ValueError, match="duration"):
        go(seconds=duration)


# ---- SCHED_FIFO ---------------------------------------------------------------------------------------------------


def test_a_machine_that_refuses_sched_fifo_is_told_apart_and_the_run_goes_on() -> None:
    """For real: a child without any rights asks for it."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
            if os.geteuid() == 0:
                os.setuid(65534)
            said = preferred()
            live, _ = go({}, seconds=0.5)
            os.write(writing, f"{said}|{live.timing.steps}".encode())
        finally:
            os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    said, steps = os.read(reading, 4096).decode().split("|")
    os.close(reading)
    assert said.startswith("SCHED_FIFO 50: not permitted; run as root, or")
    assert said.endswith("; going on without: expect late steps when the machine is busy")
    assert steps == "10"


def test_where_it_is_granted_threads_and_children_do_not_have_it_unless_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, param: asked.append((policy, param.sched_priority))
    )
    assert {preferred(), preferred(threads=True)} == {"SCHED_FIFO 50: granted"}
    assert asked == [(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 50), (os.SCHED_FIFO, 50)]
