"""Carries out the cases of suites, on all cores or on a cluster, and keeps each as soon as it has finished."""

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

from rich.console import Console
from rich.progress import Progress

from benchmarks.entries import controller
from benchmarks.run.drives import Policy, drive, shape
from benchmarks.run.provenance import digest, provenance
from benchmarks.run.results import Case, Results, Store, load_results, packed
from benchmarks.run.spread import Where, Workers, computing
from benchmarks.run.trainings import TRAININGS, learn
from benchmarks.suites import Job, Suite, jobs
from benchmarks.tables import say
from steerkit.scenario import Scenario

_BATCH = 8  # cases that are handed out together at most
_BATCHES = 16  # batches a worker at least: the last ones are done side by side
_WRITERS = 4  # threads
_WAITING = 64  # cases that may wait for the disk


@dataclass(frozen=True)
class Work:
    """A case and all that a worker needs for it; it crosses to other processes and machines."""

    job: Job
    scenario: Scenario | None
    timed_steps: int
    policy: Policy | None
    place: FilePath | None
    """Where the worker itself keeps the case; None: it hands its files back (other machine, other disk)."""


@dataclass(frozen=True)
class Done:
    """A finished case, and its files where nobody has written them yet."""

    case: Case
    files: Mapping[str, bytes] | None = None


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
    """Carry out all cases that have not finished yet, and read all.

    workers, backend, address: who computes, see `Where`. Raises ValueError for what does not go together there, for a
    directory of other results, and for a cluster that cannot do it (see `dask_client`); WorkersDiedError when workers
    die again and again.
    """
    tell = (lambda text: None) if quiet else say
    where = Where(backend, address, workers)
    planned = jobs(suites, seeds, only)
    scenarios = {scene.name: scene for one in suites for scene in one.scenarios}
    timed = {one.name: one.timed_steps for one in suites}
    alone = {one.name for one in suites if one.alone}
    console = Console(stderr=True)
    with computing(where) as those, Progress(console=console, disable=quiet or not console.is_terminal) as bar:
        store = Store(place)
        store.open(provenance(suites, planned, seeds))
        todo = [job for job in planned if not store.has(job.id)]
        phases = (
            [job for job in todo if job.kind == "learn"],
            [job for job in todo if job.kind == "drive" and job.suite not in alone],
            [job for job in todo if job.kind == "drive" and job.suite in alone],
        )
        count, tenth = len(planned) - len(todo), max(1, len(planned) // 10)
        task = bar.add_task("cases", total=len(planned), completed=count)
        if count:
            tell(f"{count} of {len(planned)} cases have finished before; going on")
        for number, phase in enumerate(phases):
            these = Workers(1) if number == 2 else those
            shared = place if these.client is None else None
            work = [work_of(job, scenarios, timed, store, shared) for job in phase]
            batches = together(work, these.count)
            coming = (done for _, several in these.done(carry_out_all, batches, say=tell) for done in several)
            for done in kept(coming, store):
                count, case = count + 1, done.case
                if case.status == "error":
                    tell(f"{case.id}: {case.error}")
                told = f"{count} of {len(planned)} cases: {case.scenario} {case.controller} {case.seed}"
                bar.update(task, completed=count, description=told)
                if bar.disable and (count % tenth == 0 or count == len(planned)):
                    tell(told)
    return load_results(place)


def carry_out_all(batch: Sequence[Work]) -> list[Done]:
    """Cases one after the other, in whatever process."""
    return [carry_out(work) for work in batch]


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
    more: dict[str, Any] = {}
    try:
        if missing:
            case = Case(**said, status="not installed", error=missing)  # type: ignore[arg-type]
        elif job.kind == "learn":
            one = controller(job.controller)
            learnt = learn(TRAININGS[one.training], one.setting, seed=job.seed, driven=work.scenario)
            case = Case(**said, metrics=learnt.metrics)  # type: ignore[arg-type]
            net = learnt.policy
            more = dict(curve=learnt.curve, net=None if net is None else net.save)
        else:
            assert work.scenario is not None
            if work.policy is None and controller(job.controller).learns:
                raise RuntimeError(f"its training {job.training} did not finish")
            driven = drive(
                work.scenario, job.controller, seed=job.seed, policy=work.policy, timed_steps=work.timed_steps
            )
            case, more = Case(**said, metrics=driven.metrics), dict(trajectory=driven.trajectory)  # type: ignore[arg-type]
    except Exception as error:  # one bad case must not end a night's run; it is shown as an error
        text = (str(error).splitlines() or [""])[0]
        case, more = Case(**said, status="error", error=f"{type(error).__name__}: {text}"), {}  # type: ignore[arg-type]
    case = replace(case, cpu_seconds=_cpu_seconds() - began)
    if work.place is None:
        return Done(case, packed(case, **more))
    Store(work.place).keep(case, **more)
    return Done(case)


def together(work: Sequence[Work], workers: int) -> list[list[Work]]:
    """What is handed out at once: drives that are compiled alike, so that few workers compile the same drive.

    Where there are many workers for the cases there are, each is handed out alone.
    """
    most = min(_BATCH, len(work) // (_BATCHES * workers))
    batches: list[list[Work]] = []
    open_ones: dict[Any, list[Work]] = {}
    for piece in work:
        key = None
        if piece.job.kind == "drive" and piece.policy is None and piece.scenario is not None:
            key = (piece.job.controller, shape(controller(piece.job.controller).as_believed(piece.scenario)))
        batch = open_ones.get(key)
        if key is None or batch is None or len(batch) >= most:
            batch = open_ones[key] = []
            batches.append(batch)
        batch.append(piece)
    return batches


def kept(coming: Iterator[Done], store: Store) -> Iterator[Done]:
    """All that comes; what nobody has written yet is written beside that: waiting for the disk holds nobody up."""
    with ThreadPoolExecutor(_WRITERS) as threads:  # whose end waits for what is being written, whatever happens
        writing: set[Future[None]] = set()
        for done in coming:
            if done.files is not None:
                writing.add(threads.submit(store.write, done.files))
            written, writing = wait(writing, None if len(writing) >= _WAITING else 0.0, FIRST_COMPLETED)
            for future in written:
                future.result()
            yield Done(done.case)
        for future in writing:
            future.result()


def _cpu_seconds() -> float:
    """Computing time of this process and of what it has waited for (the compiler) [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def work_of(
    job: Job, scenarios: Mapping[str, Scenario], timed: Mapping[str, int], store: Store, place: FilePath | None
) -> Work:
    """A case as it is handed out, with the net of its training where there is one. place: where its files are written
    by whoever carries it out; None: handed back."""
    one, policy = controller(job.controller), None
    if job.kind == "drive" and one.learns:
        file = store.net_file(job.training)
        policy = Policy.load(file, one.setting) if file.exists() else None
    return Work(job, scenarios.get(job.taught_on or job.scenario), timed.get(job.suite, 0), policy, place)
