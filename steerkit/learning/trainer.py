"""Training while driving goes on: in a process of its own on a car, or charged to the driving time in simulation.

Both trainers are used alike: `submit` a job, and ask `poll` between two control samples. Neither call waits, so an
exchange of nets happens between two samples or not at all. Results are handed out newest only: when a later job was
submitted before an earlier one was fetched, the earlier one's nets are what the later one starts from, and no more.
"""

import logging
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import NamedTuple

from steerkit._support.errors import require, require_within
from steerkit.controllers.delay_compensator import DelayCompensator
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.iterate import NOTHING_LEARNED, Learned, Nets, Problem, update

Pending = tuple[float, int, Learned]
"""Driving time at which an unfinished job is done [s], its number, what it gives the policy."""
NICE = 10
"""How far the training process steps back behind the loop's (os.nice)."""
PATIENCE = 600.0
"""Time without a sign of the training process after which it is taken for dead [s]."""
ATTEMPTS = 3
"""Deaths of the training process over one job after which the job, not the process, is blamed."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, kw_only=True)
class Job:
    """One update of the Q-function: the arguments of `update`, but for what was before, which a trainer knows."""

    number: int
    """Of the update; each job's is larger than those before it."""
    transitions: Transitions
    """What to learn from, as it is at `submit`."""
    problem: Problem
    seed: int = 0

    def train(self, before: Learned) -> Learned:
        """Do it, here and now."""
        return update(self.transitions, self.problem, before, self.seed)


class Result(NamedTuple):
    """What became of the newest job."""

    number: int
    """The job's."""
    nets: Nets | None
    """The new nets; None: there are none, and `fault` says why."""
    seconds: float
    """Computing time of it and of the jobs before it that were never handed out [s]."""
    fault: str = ""
    """What went wrong; with nets: what went wrong before they were made all the same."""
    forecast: DelayCompensator | None = None
    """What goes with the nets: see `Learned`."""


class SimulatedTrainer:
    """Trains in `submit`, and hands the nets out when the training would have been done on a car.

    seconds: driving time charged for one update [s]. A job begins when the one before it is done. learned: what the
    first job starts from. pending: a checkpoint's unfinished job, to go on with. An error in training is raised by
    `submit`.
    """

    def __init__(self, *, seconds: float = 1.0, learned: Learned = NOTHING_LEARNED, pending: Pending | None = None):
        require_within("SimulatedTrainer", "seconds", seconds, "s", 0.0, 1e9)
        self.seconds, self.learned = seconds, pending[2] if pending else learned
        self.pending = pending
        """The unfinished job, for a checkpoint to keep and another trainer to go on with."""
        self._newest, self._spent = pending[1] if pending else 0, 0.0

    def submit(self, job: Job, t: float) -> None:
        """Train now; the result is there `seconds` after t, or after the job before."""
        _require_newer(job, self._newest)
        began = time.perf_counter()
        self.learned = job.train(self.learned)
        self._newest, self._spent = job.number, self._spent + time.perf_counter() - began
        start = max(t, self.pending[0]) if self.pending else t
        self.pending = (start + self.seconds, job.number, self.learned)

    def poll(self, t: float) -> Result | None:
        """The newest nets, once, if they would be ready at driving time t [s]."""
        if self.pending is None or t < self.pending[0] - 1e-9:
            return None
        (_, number, learned), self.pending = self.pending, None
        seconds, self._spent = self._spent, 0.0
        return Result(number, learned.nets, seconds, forecast=learned.forecast)

    @property
    def busy(self) -> bool:
        """Is there a job whose result is still to come?"""
        return self.pending is not None

    def idle(self, t: float) -> bool:
        """Is all done at driving time t [s], fetched or not?"""
        return self.pending is None or t >= self.pending[0] - 1e-9


class Trainer(AbstractContextManager["Trainer"]):
    """Trains in a process of its own, behind the loop in priority; nothing here waits for it.

    When the process dies (out of memory, kill -9) or is silent for PATIENCE, it is started again with the same job; the
    result's `fault`, `faults` and the log `steerkit.learning.trainer` tell. After ATTEMPTS deaths over one job, or an
    error in training, the result has no nets; the next job is taken up as usual. learned: what the first job starts
    from.

    The process imports the main module, as multiprocessing's spawn does: a script needs `if __name__ == "__main__":`.
    Close it, or use it in a `with`; the process ends with its parent too.
    """

    def __init__(self, *, learned: Learned = NOTHING_LEARNED):
        self.faults: list[str] = []
        """All that went wrong so far."""
        self._learned, self._jobs = learned, deque[Job]()
        self._newest, self._spent = 0, 0.0
        self._told: list[str] = []  # the faults over the job that is due
        self._closed = False
        self._start()

    def _start(self) -> None:
        """A new process, with all that is to be done."""
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, initializer=_begin, initargs=(self._learned,))
        self._pool.submit(os.getpid)  # starts the process
        (self._process,) = self._pool._processes.values()
        self._futures = deque(self._pool.submit(_train, job) for job in self._jobs)
        self._heard = time.monotonic()

    def submit(self, job: Job, t: float = 0.0) -> None:
        """Train as soon as the jobs before are done; what is recorded after this call is not learned from.

        Raises ValueError for a number that is not larger than the one before, RuntimeError after `close`.
        """
        _require_newer(job, self._newest)
        if self._closed:
            raise RuntimeError("Trainer: closed; make a new one")
        while self._jobs and self._futures[0].done():  # what nobody fetched is not done again if the process dies
            self._result()
        self._newest = job.number
        if not self._jobs:
            self._heard = time.monotonic()
        self._jobs.append(replace(job, transitions=job.transitions.frozen()))
        try:
            self._futures.append(self._pool.submit(_train, self._jobs[-1]))
        except BrokenProcessPool:
            self._fault(f"training process {self.pid} died while idle")
            self._start()

    def poll(self, t: float = 0.0) -> Result | None:
        """The newest job's result, once, if it is there."""
        if self._jobs and not self._futures[0].done() and time.monotonic() - self._heard > PATIENCE:
            self._process.kill()
        while self._jobs and self._futures[0].done() and not self._closed:
            result = self._result()
            if result and result.number == self._newest:
                seconds, self._spent = self._spent, 0.0
                return result._replace(seconds=seconds)
        return None

    def _result(self) -> Result | None:
        """What became of the first job that is due; None: it is done again."""
        job, error, learned = self._jobs[0], self._futures[0].exception(), None
        died = isinstance(error, BrokenProcessPool)
        if error is None:
            self._learned, seconds = learned, _ = self._futures[0].result()
            self._spent += seconds
        elif died:
            self._told.append(self._fault(f"training process {self.pid} died over net {job.number}"))
        else:
            self._told.append(self._fault(f"net {job.number} could not be trained: {type(error).__name__}: {error}"))
        again = died and len(self._told) < ATTEMPTS
        if not again:
            self._jobs.popleft()
            self._futures.popleft()
        self._heard = time.monotonic()
        if died:
            self._start()
        if again:
            return None
        told, self._told = "; ".join(self._told), []
        nets, forecast = learned or (None, None)
        return Result(job.number, nets, 0.0, told, forecast=forecast)

    def _fault(self, fault: str) -> str:
        self.faults.append(fault)
        _log.warning(fault)
        return fault

    @property
    def busy(self) -> bool:
        """Is there a job whose result is still to come?"""
        return bool(self._jobs)

    def idle(self, t: float = 0.0) -> bool:
        """Is all done, fetched or not?"""
        return all(future.done() for future in self._futures)

    @property
    def pid(self) -> int | None:
        """The training process's id."""
        return self._process.pid

    def close(self) -> None:
        """End the process, whatever it is doing."""
        if not self._closed:
            self._closed = True
            self._process.kill()
            self._pool.shutdown(cancel_futures=True)

    def __exit__(self, *error: object) -> None:
        self.close()


_learned = Learned()
"""Of the training process: what its last job gave."""


def _begin(learned: Learned) -> None:
    """Make this process one that trains: behind the loop's, deaf to Ctrl-C (the loop's), and gone with its parent."""
    global _learned
    _learned = learned
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICE)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _train(job: Job) -> tuple[Learned, float]:
    """What a job gives, and the computing time that it took [s]."""
    global _learned
    began = time.perf_counter()
    _learned = job.train(_learned)
    return _learned, time.perf_counter() - began


Training = SimulatedTrainer | Trainer


def _require_newer(job: Job, newest: int) -> None:
    require(job.number > newest, "submit", f"job number {job.number}, expected > {newest}, the one before")
