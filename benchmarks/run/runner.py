"""Carries out the cases of suites, on all cores or on a cluster, and keeps each as soon as it has finished."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.entries import controller
from benchmarks.run.cluster import dask_pool
from benchmarks.run.drives import Policy, drive
from benchmarks.run.provenance import digest, provenance, source
from benchmarks.run.results import Case, Results, Store
from benchmarks.run.trainings import TRAININGS, learn
from benchmarks.suites import Job, Suite, jobs
from steerkit.controllers.network_policy import PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.scenario import Scenario

BACKENDS = ("loky", "dask")
_PATIENCE = 3  # times that workers may die with no case finished in between


class WorkersDiedError(RuntimeError):
    """Worker processes die again and again."""


@dataclass(frozen=True)
class Work:
    """A case and all that a worker needs for it; it crosses to other processes and machines."""

    job: Job
    scenario: Scenario | None
    timed_steps: int
    policy: Policy | None
    source: str
    place: FilePath | None
    """Where the worker itself keeps the case; None: it only hands it back (other machine, other disk)."""


@dataclass(frozen=True)
class Done:
    """A finished case with what belongs to it."""

    case: Case
    trajectory: Mapping[str, np.ndarray] | None = None
    curve: Mapping[str, np.ndarray] | None = None
    net: NfqPolicy | PolicyBlock | None = None

    def keep(self, store: Store) -> None:
        """Write it."""
        store.keep(
            self.case, trajectory=self.trajectory, curve=self.curve, net=None if self.net is None else self.net.save
        )


def run(
    suites: Sequence[Suite],
    place: FilePath,
    *,
    seeds: int | None = None,
    only: Sequence[str] = (),
    workers: int = -1,
    backend: str = "loky",
    address: str | None = None,
    quiet: bool = False,
) -> Results:
    """Carry out all cases that have not finished yet, and merge them.

    workers: processes at once, -1: one a core (loky). backend: `loky`, processes of this machine, or `dask`, the
    workers of the scheduler at `address`, which must have the same sources. Raises ValueError for a directory of
    other results or a cluster that cannot do it (see `dask_pool`); WorkersDiedError when workers die again and again.
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend '{backend}' is not known; valid: {', '.join(BACKENDS)}")
    if (backend == "dask") != (address is not None):
        raise ValueError("--backend dask needs --address tcp://HOST:PORT of a scheduler, and only it takes one")
    if workers == 0 or workers < -1:
        raise ValueError(f"--jobs {workers}, expected a count >= 1, or -1 for one a core")
    planned = jobs(suites, seeds, only)
    scenarios = {scene.name: scene for one in suites for scene in one.scenarios}
    timed = {one.name: one.timed_steps for one in suites}
    alone = {one.name for one in suites if one.alone}
    with ExitStack() as stack:
        pool = stack.enter_context(_pool(backend, address))
        store = Store(place)
        store.open(provenance(suites, planned, seeds))
        todo = [job for job in planned if not store.has(job.id)]
        phases = (
            [job for job in todo if job.kind == "learn"],
            [job for job in todo if job.kind == "drive" and job.suite not in alone],
            [job for job in todo if job.kind == "drive" and job.suite in alone],
        )
        display = stack.enter_context(_progress(len(planned), len(planned) - len(todo), quiet))
        for number, phase in enumerate(phases):
            one_by_one = number == 2
            shared = None if backend == "dask" and not one_by_one else place
            work = [_work(job, scenarios, timed, store, shared) for job in phase]
            for done in _all_done(work, {} if one_by_one else pool, 1 if one_by_one else workers, display.say):
                if shared is None:
                    done.keep(store)
                display.finished(done.case)
    return store.merge()


def carry_out(work: Work) -> Done:
    """One case, in whatever process; what goes wrong in it is kept as its result."""
    job = work.job
    said = dict(
        suite=job.suite,
        scenario=job.scenario,
        controller=job.controller,
        seed=job.seed,
        kind=job.kind,
        digest=digest(job, work.scenario, work.timed_steps),
    )
    began = _cpu_seconds()
    missing = controller(job.controller).missing
    try:
        if work.source != source():
            raise RuntimeError(f"the worker's sources ({source()}) are not the run's ({work.source}): update them")
        if missing:
            done = Done(Case(**said, status="not installed", error=missing))  # type: ignore[arg-type]
        elif job.kind == "learn":
            one = controller(job.controller)
            learnt = learn(TRAININGS[one.training], one.setting, seed=job.seed, driven=work.scenario)
            case = Case(**said, metrics=learnt.metrics)  # type: ignore[arg-type]
            done = Done(case, learnt.trajectory, learnt.curve, learnt.policy)
        else:
            assert work.scenario is not None
            if work.policy is None and controller(job.controller).learns:
                raise RuntimeError(f"its training {job.training} did not finish")
            driven = drive(
                work.scenario, job.controller, seed=job.seed, policy=work.policy, timed_steps=work.timed_steps
            )
            done = Done(Case(**said, metrics=driven.metrics), driven.trajectory)  # type: ignore[arg-type]
    except Exception as error:  # one bad case must not end a night's run; it is shown as an error
        text = (str(error).splitlines() or [""])[0]
        done = Done(Case(**said, status="error", error=f"{type(error).__name__}: {text}"))  # type: ignore[arg-type]
    done = replace(done, case=replace(done.case, cpu_seconds=_cpu_seconds() - began))
    if work.place is not None:
        done.keep(Store(work.place))
        return Done(done.case)
    return done


def _cpu_seconds() -> float:
    """Computing time of this process and of what it has waited for (the compiler) [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _work(
    job: Job, scenarios: Mapping[str, Scenario], timed: Mapping[str, int], store: Store, place: FilePath | None
) -> Work:
    one, policy = controller(job.controller), None
    if job.kind == "drive" and one.learns:
        file = store.net_file(job.training)
        policy = Policy.load(file, one.setting) if file.exists() else None
    return Work(job, scenarios.get(job.taught_on or job.scenario), timed.get(job.suite, 0), policy, source(), place)


def _all_done(work: Sequence[Work], pool: Mapping[str, Any], workers: int, say: Any) -> Iterator[Done]:
    """Every piece of work, in the order in which they finish; where workers die, the rest is begun again."""
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    left = {piece.job.id: piece for piece in work}
    deaths = 0
    while left:
        before = len(left)
        try:
            with joblib.parallel_config(**pool) if pool else ExitStack():
                parallel = joblib.Parallel(n_jobs=workers, return_as="generator_unordered", batch_size=1)
                for done in parallel(joblib.delayed(carry_out)(piece) for piece in list(left.values())):
                    yield done
                    del left[done.case.id]
        except TerminatedWorkerError:
            deaths = 1 if len(left) < before else deaths + 1
            if deaths >= _PATIENCE:
                raise WorkersDiedError(
                    f"workers died {deaths} times with no case finished (killed, or out of memory?); finished cases "
                    f"are kept, and the same command goes on; left: {', '.join([*left][:5])}"
                ) from None
            say(f"a worker died; {len(left)} cases are begun again")


@contextmanager
def _pool(backend: str, address: str | None) -> Iterator[dict[str, Any]]:
    """Arguments of `joblib.parallel_config` for the backend, with a client while it is needed."""
    if backend == "loky":
        yield {"backend": "loky", "inner_max_num_threads": 1}
        return
    assert address is not None
    with dask_pool(address) as arguments:
        yield arguments


class _Display:
    """Tells how far it is: a bar on a terminal, a line every tenth of the way elsewhere."""

    def __init__(self, bar: Progress, total: int, before: int, quiet: bool):
        self.bar, self.total, self.quiet = bar, total, quiet
        self.count, self.errors = before, 0
        self.task = bar.add_task("cases", total=total, completed=before, story="")

    def finished(self, case: Case) -> None:
        """One more case."""
        self.count += 1
        if case.status == "error":
            self.errors += 1
            self.say(f"{case.id}: {case.error}")
        story = f"{case.scenario} {case.controller} {case.seed}" + (f", {self.errors} errors" if self.errors else "")
        self.bar.update(self.task, completed=self.count, story=story)
        tenth = max(1, self.total // 10)
        if not self.bar.console.is_terminal and (self.count % tenth == 0 or self.count == self.total):
            self.say(f"{self.count} of {self.total} cases: {story}")

    def say(self, text: str) -> None:
        """A line, unless quiet."""
        if not self.quiet:
            self.bar.console.print(text, soft_wrap=True, markup=False, highlight=False)


@contextmanager
def _progress(total: int, before: int, quiet: bool) -> Iterator[_Display]:
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[story]}"),
    )
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal) as bar:
        display = _Display(bar, total, before, quiet)
        if before:
            display.say(f"{before} of {total} cases have finished before; going on")
        yield display
