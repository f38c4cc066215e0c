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
from collections.abc import Callable, Iterator
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
OPTIONS = {
    "scheduler": "--host 127.0.0.1 --port {port} --no-dashboard",
    "worker": "--nworkers 1 --nthreads 1 --no-dashboard",
    "run": "--only stanley --out results --seeds 3 --json",
}
"""What makes the documentation's lines small."""
Start = Callable[..., subprocess.Popen[str]]


def words(what: str, port: int) -> list[str]:
    """The documentation's line for scheduler, worker or run on this machine, with a suite that is soon done."""
    section = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8").split("## On a cluster")[1]
    (block,) = re.findall(r"^```\n(.*?)^```$", section, re.M | re.S)
    line = dict(zip(("scheduler", "worker", "run", "study"), block.splitlines(), strict=True))[what]
    line = line.replace("HOST:8786", f"127.0.0.1:{port}").replace(" run robustness ", " run golden ")
    first, *rest = shlex.split(line, comments=True)
    assert first in ("dask", "python")
    command = [sys.executable, *(["-m", "dask"] if first == "dask" else []), *rest]
    return [*command, *OPTIONS[what].format(port=port).split()]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts processes in `tmp_path`, each with a log; ends them and all that they started."""
    started: list[subprocess.Popen[str]] = []
    both = {**os.environ, "PYTHONPATH": str(HOME), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "5"}

    def begin(name: str, command: list[str]) -> subprocess.Popen[str]:
        with (tmp_path / f"{name}.log").open("w") as log:
            how = dict(cwd=tmp_path, env=both, stdout=log, stderr=log, text=True, start_new_session=True)
            started.append(subprocess.Popen(command, **how))
        return started[-1]

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


def test_a_cluster_as_documented_and_killed_workers(start: Start, tmp_path: Path) -> None:
    """All is done, with the numbers of this machine, though one of two workers is killed on the way."""
    pytest.importorskip("distributed", reason="comes with the extra bench")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = int(free.getsockname()[1])
    start("scheduler", words("scheduler", port))
    log = tmp_path / "scheduler.log"
    until(lambda: "Scheduler at" in log.read_text(), "a scheduler")
    # the one that is killed is without a nanny, another process that would be killed with it
    victim = start("worker0", [*words("worker", port), "--no-nanny"])
    start("worker1", words("worker", port))
    until(lambda: log.read_text().count("Register worker") >= 2, "two workers")
    run = start("run", words("run", port))
    finished = lambda: len(list(tmp_path.glob("results/cases/*.json")))  # noqa: E731
    until(lambda: finished() >= 2 or run.poll() is not None, "two cases")
    before = finished()
    os.killpg(victim.pid, signal.SIGKILL)
    code, said = run.wait(240.0), (tmp_path / "run.log").read_text()
    assert code == 0, said
    figures = json.loads(said.splitlines()[-1])
    results = load_results(tmp_path / "results")
    assert before < figures["done"] == len(results.cases) == len(results.provenance["planned"])
    assert {case.status for case in results.cases} == {"done"}
    here = carry_out([suite("golden")], tmp_path / "here", seeds=1, only=["stanley"], workers=1, quiet=True)
    compared = compare(here, results, rel=0.0, absolute=0.0)
    assert compared.compared >= 4 * 20
    assert compared.changes == ()
