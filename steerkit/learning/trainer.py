"""Training while driving goes on: in a process of its own on a car, or charged to the driving time in simulation.

Both trainers are used alike: `submit` a job, and ask `poll` between two control samples. Neither call waits, so an
exchange of nets happens between two samples or not at all. Results are handed out newest only: when a later job was
submitted before an earlier one was fetched, the earlier one's nets are what the later one starts from, and no more.
"""

from __future__ import annotations

import contextlib
import logging
import math
import multiprocessing
import os
import pickle
import queue
import signal
import threading
import time
import weakref
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, NamedTuple, Protocol, Self

from steerkit._support.errors import require
from steerkit.controllers.delay_compensator import DelayCompensator
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.iterate import Learned, Nets, Problem, update

Pending = tuple[float, int, Learned]
"""Driving time at which an unfinished job is done [s], its number, what it gives the policy."""
NICE = 10
"""How far the training process steps back behind the loop's (os.nice)."""
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


class Training(Protocol):
    """What an experiment asks of a trainer."""

    def submit(self, job: Job, t: float) -> None:
        """Train at driving time t [s], after the jobs before; returns at once (in simulation: when computed)."""
        ...

    def poll(self, t: float) -> Result | None:
        """The newest job's result, once, when it is there at driving time t [s]; never waits."""
        ...

    @property
    def busy(self) -> bool:
        """Is there a job whose result is still to come?"""
        ...

    @property
    def pending(self) -> Pending | None:
        """What a checkpoint can keep of an unfinished job."""
        ...

    def close(self) -> None:
        """End it, whatever it is doing."""
        ...


class SimulatedTrainer:
    """Trains in `submit`, and hands the nets out when the training would have been done on a car.

    seconds: driving time charged for one update [s]; None: the computing time it really took (runs are then not
    repeatable). A job begins when the one before it is done. nets: what the first job starts from. pending: the
    unfinished job of a checkpoint, to go on with. An error in training is raised by `submit`.
    """

    def __init__(self, *, seconds: float | None = 1.0, nets: Nets = (), pending: Pending | None = None):
        ok = seconds is None or (math.isfinite(seconds) and seconds >= 0.0)
        require(ok, "SimulatedTrainer", f"seconds = {seconds} s, expected >= 0, or None for the time really taken")
        self.seconds, self.learned = seconds, pending[2] if pending else Learned(nets)
        self._pending = pending
        self._newest, self._spent = pending[1] if pending else 0, 0.0

    def submit(self, job: Job, t: float) -> None:
        """Train now; the result is there `seconds` after t, or after the job before."""
        _require_newer(job, self._newest)
        began = time.perf_counter()
        self.learned = job.train(self.learned)
        taken = time.perf_counter() - began
        self._newest, self._spent = job.number, self._spent + taken
        start = max(t, self._pending[0]) if self._pending else t
        self._pending = (start + (taken if self.seconds is None else self.seconds), job.number, self.learned)

    def poll(self, t: float) -> Result | None:
        """The newest nets, once, if they would be ready at driving time t [s]."""
        if self._pending is None or t < self._pending[0] - 1e-9:
            return None
        (_, number, learned), self._pending = self._pending, None
        seconds, self._spent = self._spent, 0.0
        return Result(number, learned.nets, seconds, forecast=learned.forecast)

    @property
    def busy(self) -> bool:
        """Is there a job whose result is still to come?"""
        return self._pending is not None

    @property
    def pending(self) -> Pending | None:
        """The unfinished job, for a checkpoint to keep and another trainer to go on with."""
        return self._pending

    def close(self) -> None:
        """Nothing to end."""


class Trainer:
    """Trains in a process of its own, behind the loop in priority; nothing here waits for it.

    A thread of the trainer's own talks to the process. When the process dies (out of memory, kill -9) or is silent
    for `patience` [s], it is started again with the same job; the result's `fault`, `faults` and the log
    `steerkit.learning.trainer` tell. After ATTEMPTS deaths over one job, or an error in training, the result has no
    nets; the next job is taken up as usual. nets: what the first job starts from.

    The process imports the main module, as multiprocessing's spawn does: a script needs `if __name__ == "__main__":`.
    Close it, or use it in a `with`; it also ends with the program, and the process ends with its parent.
    """

    def __init__(self, *, nets: Nets = (), nice: int = NICE, patience: float = 600.0):
        require(patience > 0.0, "Trainer", f"patience = {patience} s, expected > 0")
        self._worker = _Worker(Learned(nets), nice, patience)
        self._newest = self._fetched = 0
        self._spent = 0.0
        self._end = weakref.finalize(self, _Worker.end, self._worker)

    def submit(self, job: Job, t: float = 0.0) -> None:
        """Train as soon as the jobs before are done; what is recorded after this call is not learned from.

        Raises ValueError for a number that is not larger than the one before, RuntimeError after `close`.
        """
        _require_newer(job, self._newest)
        if not self._end.alive:
            raise RuntimeError("Trainer: closed; make a new one")
        self._newest = job.number
        self._worker.jobs.put(_frozen(job))

    def poll(self, t: float = 0.0) -> Result | None:
        """The newest job's result, once, if it is there."""
        with contextlib.suppress(queue.Empty):
            while True:
                result = self._worker.results.get_nowait()
                self._spent += result.seconds
                if result.number == self._newest:
                    self._fetched = result.number
                    seconds, self._spent = self._spent, 0.0
                    return result._replace(seconds=seconds)
        return None

    @property
    def busy(self) -> bool:
        """Is there a job whose result is still to come?"""
        return self._fetched < self._newest

    @property
    def pending(self) -> Pending | None:
        """None: an unfinished job cannot be kept; after a restart, submit it again."""
        return None

    @property
    def faults(self) -> tuple[str, ...]:
        """All that went wrong so far."""
        return tuple(self._worker.faults)

    @property
    def pid(self) -> int | None:
        """The training process's id."""
        return self._worker.process.pid

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self._end()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


class _Worker(threading.Thread):
    """The thread that keeps a training process alive and busy."""

    def __init__(self, learned: Learned, nice: int, patience: float):
        super().__init__(name="steerkit trainer", daemon=True)
        self.learned, self.nice, self.patience = learned, nice, patience
        self.jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self.results: queue.SimpleQueue[Result] = queue.SimpleQueue()
        self.faults: list[str] = []
        self._deaths = 0  # since the last success
        self._ending = False
        self._start_process()  # here, so that a main module without its guard fails loudly
        self.start()

    def run(self) -> None:
        while not self._ending:
            if not self.process.is_alive() and self._deaths < ATTEMPTS:
                self._restart("while idle")
            with contextlib.suppress(queue.Empty):
                job = self.jobs.get(timeout=0.2)
                if job is not None:
                    self.results.put(self._result(job))
        self.process.kill()
        self.process.join()

    def _result(self, job: Job) -> Result:
        began, faults = time.monotonic(), list[str]()
        for _ in range(ATTEMPTS):
            if not self.process.is_alive():
                faults.append(self._restart("while idle"))
            try:
                _send(self._link, (job, self.learned))
                if not self._link.poll(self.patience):
                    self.process.kill()
                learned, error, seconds = _receive(self._link)
            except (EOFError, OSError):  # the process is dead
                if self._ending:
                    return Result(job.number, None, 0.0, "closed")
                faults.append(self._restart(f"while training net {job.number}"))
                continue
            except (pickle.PicklingError, TypeError, AttributeError) as why:
                learned, error, seconds = None, f"net {job.number}: the job cannot be sent to a process: {why}", 0.0
            self._deaths = 0
            self.learned = learned or self.learned
            fault = "; ".join([*faults, *([self._fault(error)] if error else [])])
            if learned is None:
                return Result(job.number, None, seconds, fault)
            return Result(job.number, learned.nets, seconds, fault, forecast=learned.forecast)
        faults.append(self._fault(f"net {job.number} is given up: the process died {ATTEMPTS} times over it"))
        return Result(job.number, None, time.monotonic() - began, "; ".join(faults))

    def _restart(self, when: str) -> str:
        """A new process; returns what became of the old one."""
        self.process.join()
        self._deaths += 1
        old = self.process
        self._start_process()
        return self._fault(f"training process {old.pid} ended {when} ({_ending_of(old.exitcode)}); restarted")

    def _start_process(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._link, far = context.Pipe()
        self.process = context.Process(target=_serve, args=(far, self.nice), name="steerkit trainer", daemon=True)
        self.process.start()
        far.close()  # so that the end of the process is the end of the pipe

    def _fault(self, fault: str) -> str:
        self.faults.append(fault)
        _log.warning(fault)
        return fault

    def end(self) -> None:
        self._ending = True
        self.jobs.put(None)
        while self.is_alive():  # it may just be starting a process
            self.process.kill()
            self.join(0.05)


def _serve(link: Connection, nice: int) -> None:
    """The training process: jobs in, nets out, until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the loop's
    os.nice(nice)
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            job, learned = _receive(link)
            began = time.perf_counter()
            error = ""
            try:
                learned = job.train(learned)
            except Exception as why:
                learned, error = None, f"net {job.number} could not be trained: {type(why).__name__}: {why}"
            _send(link, (learned, error, time.perf_counter() - began))


def _require_newer(job: Job, newest: int) -> None:
    require(job.number > newest, "submit", f"job number {job.number}, expected > {newest}, the one before")


def _frozen(job: Job) -> Job:
    """The job with the transitions as they are now; costs nothing, as recorded rows never change."""
    return replace(job, transitions=_Snapshot(job.transitions))


class _Snapshot(Transitions):
    """A record's rows of this moment, without a copy; turns into plain `Transitions` on the way to a process."""

    def __init__(self, record: Transitions):
        self.names, self._n = record.names, len(record)
        self._s, self._a, self._s_next, self._episode = record.s, record.a, record.s_next, record.episode

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self.names, self.s, self.a, self.s_next, self.episode)


def _rebuilt(names: tuple[str, ...], s: Any, a: Any, s_next: Any, episode: Any) -> Transitions:
    record = Transitions(names)
    record.extend(s, a, s_next, episode)
    return record


def _send(link: Connection, message: Any) -> None:
    """Pickle with the arrays beside it, uncopied: no long stretch in which the loop's thread would have to wait."""
    arrays: list[pickle.PickleBuffer] = []
    head = pickle.dumps(message, protocol=5, buffer_callback=arrays.append)
    link.send((head, len(arrays)))
    for array in arrays:
        link.send_bytes(array.raw())


def _receive(link: Connection) -> Any:
    head, count = link.recv()
    return pickle.loads(head, buffers=[link.recv_bytes() for _ in range(count)])


def _ending_of(code: int | None) -> str:
    return f"killed by signal {-code}" if code is not None and code < 0 else f"exit code {code}"
