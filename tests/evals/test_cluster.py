"""The cluster lines of docs/benchmarks.md as written: processes of their own, in a directory that is no checkout."""

import contextlib
import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path

import pytest

import benchmarks
from benchmarks.run.compare import compare
from benchmarks.run.results import load_results
from benchmarks.run.runner import run as carry_out
from benchmarks.suites import suite
from tests.support.places import ROOT

HOME = Path(benchmarks.__file__ or "").parents[1]
"""The folder with both packages: a checkout, or where they are installed."""
Start = Callable[..., subprocess.Popen[str]]


def lines() -> dict[str, str]:
    """The documentation's lines: scheduler, worker, run, study."""
    section = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8").split("## On a cluster")[1]
    (block,) = re.findall(r"^```\n(.*?)^```$", section, re.M | re.S)
    return dict(zip(("scheduler", "worker", "run", "study"), block.splitlines(), strict=True))


def words(line: str, port: int) -> list[str]:
    """A line of the documentation for this machine: HOST:8786 is here, and commands are this Python's."""
    first, *rest = shlex.split(line.replace("HOST:8786", f"127.0.0.1:{port}"), comments=True)
    assert first in ("dask", "python")
    return [sys.executable, *(["-m", "dask"] if first == "dask" else []), *rest]


def environment() -> dict[str, str]:
    """Both packages are found from any directory."""
    return {**os.environ, "PYTHONPATH": str(HOME), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "5"}


@pytest.fixture
def port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts processes in `tmp_path`, each with a log; ends them and all that they started."""
    started: list[subprocess.Popen[str]] = []

    def begin(name: str, command: list[str], environment: Mapping[str, str]) -> subprocess.Popen[str]:
        with (tmp_path / f"{name}.log").open("w") as log:
            process = subprocess.Popen(
                command, cwd=tmp_path, env=environment, stdout=log, stderr=log, text=True, start_new_session=True
            )
        started.append(process)
        return process

    yield begin
    for process in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(30.0)


def until(holds: Callable[[], bool], what: str, *, seconds: float = 240.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, f"{what} within {seconds:g} s"
        time.sleep(0.05)


def worker(start: Start, port: int, number: int, *, nanny: bool) -> int:
    """Start a worker; returns its id."""
    options = ["--nworkers", "1", "--nthreads", "1", "--no-dashboard", *([] if nanny else ["--no-nanny"])]
    line = words(lines()["worker"], port) + options
    return start(f"worker{number}", line, environment()).pid


def command(port: int, *more: str) -> list[str]:
    """The documentation's run, of a suite that is soon done."""
    line = lines()["run"].replace(" run robustness ", " run golden ")
    return [*words(line, port), "--only", "stanley", "--out", "results", *more]


@pytest.mark.skipif(find_spec("distributed") is None, reason="comes with the extra bench")
def test_a_cluster_as_documented_and_killed_workers(start: Start, port: int, tmp_path: Path) -> None:
    """All is done, with the numbers of this machine, though one of two workers is killed on the way."""
    options = ["--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    start("scheduler", words(lines()["scheduler"], port) + options, environment())
    log = tmp_path / "scheduler.log"
    until(lambda: "Scheduler at" in log.read_text(), "a scheduler")
    # the one that is killed is without a nanny, another process that would be killed with it
    victim, _ = (worker(start, port, n, nanny=n == 1) for n in range(2))
    until(lambda: log.read_text().count("Register worker") >= 2, "two workers")
    run = start("run", command(port, "--seeds", "3", "--json"), environment())
    finished = lambda: len(list(tmp_path.glob("results/cases/*.json")))  # noqa: E731
    until(lambda: finished() >= 2 or run.poll() is not None, "two cases")
    before = finished()
    os.killpg(victim, signal.SIGKILL)
    said = lambda: (tmp_path / "run.log").read_text()  # noqa: E731
    assert run.wait(240.0) == 0, said()
    figures = json.loads(said().splitlines()[-1])
    results = load_results(tmp_path / "results")
    assert before < figures["done"] == len(results.cases) == len(results.provenance["planned"])
    assert {case.status for case in results.cases} == {"done"}
    assert results.missing == ()
    here = carry_out([suite("golden")], tmp_path / "here", seeds=1, only=["stanley"], workers=1, quiet=True)
    compared = compare(here, results, rel=0.0, absolute=0.0)
    assert compared.compared >= 4 * 20
    assert compared.changes == ()
