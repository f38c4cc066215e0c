"""How many workers one scheduler and the machine that asks can keep busy, by made-up work; two workers against one.

* Made-up work: workers that compute nothing (--workers of them, in one process) hand back files as large as those of a
  case; they come and are written as those of suites. Where scheduler and asker have a core each, what counts is their
  processor time for a case, which does not depend on what else this machine does: scheduler_ms_per_task,
  client_ms_per_result and write_ms_per_result, both of the process that asks. Their inverses are what they take in a
  second, and shortest_case_s is how long a case has to be that 1,000 workers keep busy. memory_kb_per_task: of the
  scheduler, for a case that waits.
* Two workers, processes of their own, against one, with the same cases of `robustness` with LQR. two_workers_x: ratio
  of wall times; it needs a machine with two idle cores and a bit. two_workers_free_x: what would come out with a core
  for every process, of the workers' processor time and of idle_ms, their time between two cases.

    python -m benchmarks study scheduler [--workers N] [--tasks N] [--cases N] [--json]
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.run import runner
from benchmarks.run.cluster import dask_client
from benchmarks.run.made_up import MadeUp, held, made_up
from benchmarks.run.results import FOLDERS, Store
from benchmarks.run.runner import Done, Work, carry_out
from benchmarks.run.sources import ROOT
from benchmarks.run.spread import Cluster
from benchmarks.suites import jobs, suite

MANY = 1000
"""So many workers the shortest case is worked out for."""
_START = 120.0  # for processes to start [s]


@dataclass(frozen=True)
class Timed:
    """A case with who carried it out, from when to when, and the processor time that it took [s]."""

    done: Done
    worker: int
    begin: float
    end: float
    cpu: float


def timed(work: Work) -> Timed:
    """On a worker: the case, timed."""
    begin, cpu = time.time(), time.process_time()
    done = carry_out(work)
    return Timed(done, os.getpid(), begin, time.time(), time.process_time() - cpu)


def timed_all(batch: Sequence[Work]) -> list[Timed]:
    """On a worker: several, as the runner hands them out."""
    return [timed(work) for work in batch]


@contextmanager
def process(*words: str) -> Iterator[None]:
    """A Python of its own that finds both packages, ended at the end."""
    found = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    quiet: dict[str, Any] = dict(stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    one = subprocess.Popen([sys.executable, *words], env={**os.environ, "PYTHONPATH": found}, **quiet)
    try:
        yield
    finally:
        one.kill()
        one.wait(30.0)


@contextmanager
def scheduler() -> Iterator[str]:
    """The address of a scheduler of its own. Raises TimeoutError where it does not start."""
    with tempfile.TemporaryDirectory(prefix="steerkit-scheduler-") as folder:
        file, end, address = Path(folder) / "scheduler.json", time.monotonic() + _START, ""
        options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
        with process("-m", "dask", "scheduler", *options):
            while not address:
                try:
                    address = json.loads(file.read_text(encoding="utf-8"))["address"]
                except (FileNotFoundError, ValueError):  # not there yet, or half written
                    _wait(end, "no scheduler has started")
            yield address


@contextmanager
def workers(address: str, *starts: tuple[str, ...], count: int) -> Iterator[Any]:
    """A client with worker processes that are started so, `count` workers in all and no others.

    Raises TimeoutError where they do not come.
    """
    with ExitStack() as stack:
        for words in starts:
            stack.enter_context(process(*words))
        client = stack.enter_context(dask_client(address))
        end = time.monotonic() + _START
        while len(client.nthreads()) != count:
            _wait(end, f"{count} workers have not come")
        yield client


def _wait(end: float, what: str) -> None:
    if time.monotonic() > end:
        raise TimeoutError(f"{what} within {_START:g} s")
    time.sleep(0.02)


@contextmanager
def results() -> Iterator[Store]:
    """Where cases are written, for as long as they are looked at."""
    with tempfile.TemporaryDirectory(prefix="steerkit-scheduler-") as folder:
        for name in FOLDERS:
            (Path(folder) / name).mkdir()
        yield Store(folder)


def cases(count: int) -> list[Work]:
    """The first so many cases of `robustness` with LQR, as the runner hands them to a cluster."""
    one = suite("robustness")
    every, scenes = jobs([one], 1, ["lqr"]), {scene.name: scene for scene in one.scenarios}
    return [runner.work_of(job, scenes, {}, Store("none-is-read"), None) for job in every[:count]]


def with_made_up_work(address: str, work: Work, tasks: int, count: int) -> dict[str, Any]:
    """Processor time and memory of a case; work: the case that those made up are as large as."""
    done = carry_out(work)
    size, told = sum(map(len, (done.files or {}).values())), pickle.dumps(work)
    serving = ("-c", f"from benchmarks.run.made_up import serve; serve({address!r}, {count})")
    pieces = [MadeUp(number, told, size) for number in range(tasks)]
    with results() as store, workers(address, serving, count=count) as client:

        def written(some: Sequence[MadeUp]) -> None:
            coming = (Done(done.case, files) for _, files in Cluster(client).done(made_up, some))
            for _ in runner.kept(coming, store):
                pass

        def spent() -> dict[str, float]:
            theirs = client.run_on_scheduler(time.process_time)
            return {"wall": time.perf_counter(), "scheduler": theirs, "client": time.process_time()}

        def since(before: dict[str, float]) -> dict[str, float]:
            return {name: (now - before[name]) / tasks for name, now in spent().items()}

        written(pieces[: 2 * count])  # whatever is done once
        before = spent()
        for _ in Cluster(client).done(made_up, pieces):
            pass
        taken, before = since(before), spent()
        written(pieces)
        kept = since(before)
        empty = _memory(client, 0)  # what was done before is let go of some time after its result was taken
        waiting = [client.submit(made_up, MadeUp(n, told, 0, 60.0), pure=False) for n in range(tasks)]
        memory = (_memory(client, tasks) - empty) / len(waiting)
    each = 0.5 * (taken["scheduler"] + kept["scheduler"])
    slowest = max(each, kept["client"])
    return {
        "made_up_workers": count,
        "tasks": tasks,
        "result_kb": size / 1e3,
        "scheduler_ms_per_task": 1e3 * each,
        "client_ms_per_result": 1e3 * taken["client"],
        "write_ms_per_result": 1e3 * (kept["client"] - taken["client"]),
        "scheduler_tasks_per_second": 1.0 / each,
        "client_results_per_second": 1.0 / kept["client"],
        "tasks_per_second_here": 1.0 / kept["wall"],
        "memory_kb_per_task": memory,
        "shortest_case_s": MANY * slowest,
        "network_mb_per_second": 1e-6 * size / slowest,
    }


def _memory(client: Any, tasks: int) -> float:
    """The scheduler's memory when it knows so many tasks [kB]."""
    end = time.monotonic() + _START
    while (now := client.run_on_scheduler(held))[0] != tasks:
        _wait(end, f"the scheduler knows {now[0]} tasks and has not come to {tasks}")
    return float(now[1])


def with_workers(address: str, work: Sequence[Work], count: int) -> tuple[float, float, list[Timed]]:
    """The cases by `count` workers: wall time [s], processor time of scheduler and asker a case [s], and each case."""
    alone = ("-m", "dask", "worker", address, "--nworkers", "1", "--nthreads", "1", "--no-dashboard", "--no-nanny")
    rows: list[Timed] = []

    def noted(coming: Iterator[tuple[int, list[Timed]]]) -> Iterator[Done]:
        for _, several in coming:
            rows.extend(several)
            yield from (one.done for one in several)

    with results() as store, workers(address, *[alone] * count, count=count) as client:
        client.run(timed, work[0])  # each: whatever is done once
        cpu = time.process_time() + client.run_on_scheduler(time.process_time)
        batches, begun = runner.together(work, count), time.perf_counter()
        for _ in runner.kept(noted(Cluster(client).done(timed_all, batches)), store):
            pass
        wall = time.perf_counter() - begun
        cpu = time.process_time() + client.run_on_scheduler(time.process_time) - cpu
    return wall, cpu / len(work), rows


def idle_of(rows: Sequence[Timed]) -> list[float]:
    """Times between two cases of the same worker [s]."""
    by_worker: dict[int, list[Timed]] = {}
    for row in sorted(rows, key=lambda row: row.begin):
        by_worker.setdefault(row.worker, []).append(row)
    return [b.begin - a.end for mine in by_worker.values() for a, b in itertools.pairwise(mine)]


def busiest(rows: Sequence[Timed], idle: float) -> float:
    """How long the worker with most to do would take if it had a core of its own [s]; idle: between two cases."""
    spent: dict[int, float] = {}
    for row in rows:
        spent[row.worker] = spent.get(row.worker, 0.0) + row.cpu + idle
    return max(spent.values())


def against_one(address: str, work: Sequence[Work]) -> dict[str, Any]:
    """Two workers against one, with the same cases."""
    (wall_1, _, one), (wall_2, overhead, two) = (with_workers(address, work, count) for count in (1, 2))
    between = [sorted(idle_of(rows)) for rows in (one, two)]
    idle_1, idle_2 = (sum(times) / max(1, len(times)) for times in between)
    return {
        "cases": len(work),
        "case_s": sum(row.cpu for row in one) / len(one),
        "two_workers_x": wall_1 / wall_2,
        "two_workers_free_x": busiest(one, idle_1) / busiest(two, idle_2),
        "cpu_x": sum(row.cpu for row in two) / sum(row.cpu for row in one),
        "idle_ms": 1e3 * idle_2,
        "idle_median_ms": 1e3 * between[1][len(between[1]) // 2] if between[1] else float("nan"),
        "overhead_ms_per_case": 1e3 * overhead,
        "errors": sum(row.done.case.status != "done" for row in (*one, *two)),
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick: four workers, forty made-up cases, four real ones."""
    parser.add_argument("--workers", type=int, default=100, help="workers of the made-up work (default 100)")
    parser.add_argument("--tasks", type=int, default=5000, help="made-up cases (default 5000)")
    parser.add_argument("--cases", type=int, default=141, help="real cases for two workers and one (default 141: all)")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure both and print them."""
    many, tasks, count = (4, 40, 4) if options.quick else (options.workers, options.tasks, options.cases)
    work = cases(count)
    with scheduler() as address:
        figures = with_made_up_work(address, work[0], tasks, many) | against_one(address, work)
    for name, value in figures.items():
        print(f"{name:28s} {value:.4g}" if isinstance(value, float) else f"{name:28s} {value}", flush=True)
    return figures
