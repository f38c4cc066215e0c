"""Run a loop in real time: at a fixed rate, without drift, with every late step counted and answered."""

import gc
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from steerkit._support.clock import Clock
from steerkit.diagram.loop import Loop, LoopState, Sample

BIN = 2e-5
"""Width of a bin of the jitter histogram [s]."""
_BINS = 10_000


@dataclass(kw_only=True)
class Timing:
    """How punctual a run was."""

    period: float
    """Of the loop [s]."""
    steps: int = 0
    misses: int = 0
    """Deadlines missed: steps that ended after their successor was due, each with the number it made late or void."""
    longest: float = 0.0
    """Longest computation of a step [s]."""
    worst: float = 0.0
    """Latest start of a step [s]."""
    histogram: np.ndarray = field(default_factory=lambda: np.zeros(_BINS, dtype=np.int64), repr=False)
    """Steps by how late they started, in bins of `BIN`; the last one holds all that were later."""

    def started(self, late: float) -> None:
        """Count a step that started `late` [s] after it was due."""
        self.steps += 1
        self.worst = max(self.worst, late)
        self.histogram[min(_BINS - 1, max(0, int(late / BIN)))] += 1

    def jitter(self, share: float) -> float:
        """The lateness that `share` of the steps stayed below [s], to `BIN`: 0.99 for p99."""
        if not self.steps:
            return math.nan
        return float((1 + np.searchsorted(np.cumsum(self.histogram), share * self.steps)) * BIN)

    def summary(self) -> dict[str, float]:
        """Figures for a report: counts, and times in milliseconds."""
        return {
            "steps": self.steps,
            "misses": self.misses,
            "rate_hz": 1.0 / self.period,
            **{f"jitter_p{p}_ms": 1e3 * self.jitter(p / 100) for p in (50, 99, 99.9)},
            "jitter_max_ms": 1e3 * self.worst,
            "longest_step_ms": 1e3 * self.longest,
        }


class Run:
    """A loop in real time, in progress: its tick, states and outputs, which a watcher may read and exchange."""

    def __init__(self, loop: Loop, state: LoopState, timing: Timing):
        self.loop, self.timing = loop, timing
        self.k, self.x, self.y = state.k, list(state.x), list(state.y)

    @property
    def sample(self) -> Sample:
        """The outputs of the last tick."""
        return Sample(self.loop, max(0, self.k - 1) * self.loop.dt, self.y)

    @property
    def state(self) -> LoopState:
        """The loop's state, to go on from."""
        return LoopState(self.k, tuple(self.x), tuple(self.y))

    def restart(self, state: LoopState) -> None:
        """Go on from another state, such as `loop.init()`."""
        self.k, self.x, self.y = state.k, list(state.x), list(state.y)


Watcher = Callable[[Run], bool | None]


def run(
    loop: Loop,
    duration: float = math.inf,
    *,
    state: LoopState | None = None,
    timer: Clock | None = None,
    watch: Watcher | None = None,
    on_miss: Watcher | None = None,
) -> Run:
    """Run a loop in real time for `duration` [s]; step k is due at start + k*dt, whatever the steps before took.

    state: where to start (default: `loop.init()`). timer: the time (default: the machine's monotonic clock). watch:
    called after every step, within its deadline; on_miss: called after a step that missed one, before `watch`. Either
    ends the run by returning True. A step that is still busy when its successor is due has missed a deadline; slots
    that have passed altogether are left out, never caught up in a rush, and the loop's own t counts steps.

    Garbage is collected in the pauses only. Raises ValueError for a bad duration, and what a block raises, with a
    note which tick it was.
    """
    if not duration > 0.0:
        raise ValueError(f"run: duration = {duration} s, expected more than 0, or infinity")
    clock = timer or Clock()
    live = Run(loop, loop.init() if state is None else state, Timing(period=loop.dt))
    timing, dt = live.timing, loop.dt
    collecting = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        start, slot = clock.now(), 0
        slots = duration / dt
        while slot < slots - 1e-9:
            due = start + slot * dt
            clock.sleep_until(due)
            began = clock.now()
            timing.started(began - due)
            try:
                live.loop.advance(live.k, live.x, live.y)
            except Exception as error:
                error.add_note(f"in tick {live.k}, {began - start:.2f} s into a run in real time of {live.loop!r}")
                raise
            live.k += 1
            stop = bool(watch(live)) if watch else False
            end = clock.now()
            missed = max(0, math.floor((end - start) / dt - slot - 1e-9))
            timing.longest, timing.misses = max(timing.longest, end - began), timing.misses + missed
            if missed and on_miss:
                stop = bool(on_miss(live)) or stop
            if stop:
                break
            slot += max(1, missed)
            if slot % 20 == 0 and start + slot * dt - clock.now() > 0.5 * dt:
                gc.collect(0)
    finally:
        if collecting:
            gc.enable()
    return live


def preferred(*, threads: bool = False) -> str:
    """Ask the system to run this thread before others (SCHED_FIFO 50); returns what came of it, for the user to read.

    threads: those it starts from now on too, and processes; else they begin with the ordinary priority, as a training
    process must. Late steps are likelier where the system does not permit it.
    """
    policy = os.SCHED_FIFO if threads else os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(50))
    except PermissionError:
        return (
            "SCHED_FIFO 50: not permitted; run as root, or `sudo setcap cap_sys_nice+ep $(readlink -f $(which python))`"
            ", or set rtprio for this user in /etc/security/limits.conf; going on without: expect late steps when the "
            "machine is busy"
        )
    return "SCHED_FIFO 50: granted"
