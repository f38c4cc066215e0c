"""The runner: the same numbers whatever carries them out, and no finished case is lost."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from benchmarks.__main__ import app, main
from benchmarks.run import golden, runner
from benchmarks.run.compare import compare
from benchmarks.run.results import Results, load_results
from benchmarks.run.runner import WorkersDiedError, carry_out, run
from benchmarks.scenarios import Scenario
from benchmarks.suites import SUITES, Suite, jobs
from tests.support.places import ROOT

TINY = Suite(
    name="golden",  # a name that --help and the table know; fewer cases
    about="tests",
    scenarios=(Scenario(name="slalom", course="slalom", v_max=9.0),),
    controllers=("stanley", "stanley-textbook"),
    seeds=3,
)


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """All cases, one after the other in this process."""
    return run([TINY], tmp_path_factory.mktemp("bench") / "here", workers=1, quiet=True)


def same(results: Results, reference: Results) -> None:
    found = compare(reference, results, rel=0.0, absolute=0.0)
    assert found.same, found
    assert found.compared >= 6 * 20
    for case in results.cases:
        one, two = results.trajectory(case), reference.trajectory(case)
        assert one is not None
        assert two is not None
        assert all((one[name] == two[name]).all() for name in one)


def test_golden_numbers() -> None:
    found = golden.difference(golden.numbers(golden.measured()), *golden.kept())
    assert not found, [f"{c.case} {c.metric}: {c.before} -> {c.after}" for c in found[:10]]


def test_golden_differences_are_seen() -> None:
    old, tolerances = golden.kept()
    name = next(iter(old))
    new = {**old, name: {**old[name], "rms_e": old[name]["rms_e"] * (1.0 + 1e-5), "new": 1.0}}
    found = golden.difference(new, old, tolerances)
    assert [(c.case, c.metric) for c in found] == [(name, "rms_e"), (name, "new")]
    del new[name]["max_e"]
    assert {c.metric for c in golden.difference(new, old, tolerances)} == {"rms_e", "max_e", "new"}


def test_processes_give_the_same_numbers_and_finished_cases_are_not_run_again(
    reference: Results, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "two"
    results = run([TINY], place, workers=2)
    assert "6 of 6 cases" in capfd.readouterr().err
    same(results, reference)
    kept = {file.name: file.stat().st_mtime_ns for file in (place / "cases").glob("*.json")}
    more = run([TINY], place, workers=1, seeds=4, quiet=True)  # one more seed: only that is driven
    assert len(more.cases) == 8
    assert {n: (place / "cases" / n).stat().st_mtime_ns for n in kept} == kept
    assert (place / "cases.parquet").exists()


def test_a_killed_run_goes_on_and_loses_no_finished_case(reference: Results, tmp_path: Path) -> None:
    place = tmp_path / "killed"
    program = f"""
import sys, time
sys.path[:0] = [{str(ROOT)!r}]
from benchmarks.run import runner
from tests.unit.benchmarks.run.test_runner import TINY
whole = runner.carry_out
def slow(work):
    done = whole(work)
    time.sleep(0.3)
    return done
runner.carry_out = slow
runner.run([TINY], {str(place)!r}, workers=1, quiet=True)
"""
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        until = time.monotonic() + 120.0
        while len(list(place.glob("cases/*.json"))) < 2 and process.poll() is None:
            assert time.monotonic() < until
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    left = load_results(place)
    assert 2 <= len(left.cases) < 6
    assert left.missing
    kept = {case.id: (place / "cases" / f"{case.id}.json").stat().st_mtime_ns for case in left.cases}
    same(run([TINY], place, workers=1, quiet=True), reference)
    assert {n: (place / "cases" / f"{n}.json").stat().st_mtime_ns for n in kept} == kept


class Bomb:
    """Kills the worker process that is handed it: once for each file that is not there yet."""

    def __init__(self, *fuses: Path):
        self.fuses = fuses

    def __reduce__(self) -> Any:
        for fuse in self.fuses:
            if not fuse.exists():
                return eval, (f"(open({str(fuse)!r}, 'w').close(), __import__('os')._exit(1))",)
        return int, ()


def test_a_killed_worker_costs_nothing_but_time(
    reference: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fuse, place, whole = tmp_path / "fuse", tmp_path / "worker", runner._work

    def armed(job: Any, *rest: Any) -> Any:
        work = whole(job, *rest)
        return replace(work, policy=Bomb(fuse)) if job.seed == 1 and job.controller == "stanley" else work

    monkeypatch.setattr(runner, "_work", armed)
    results = run([TINY], place, workers=2, quiet=True)
    assert fuse.exists()
    named = [case for case in results.cases if case.status != "done"]
    assert [case.error for case in named] == ["AttributeError: 'int' object has no attribute 'block'"]
    monkeypatch.setattr(runner, "_work", whole)
    same(run([TINY], place, workers=1, quiet=True), reference)  # the case that went wrong is tried again


def test_workers_that_always_die_end_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fuses = [tmp_path / f"fuse{n}" for n in range(9)]
    whole = runner._work
    monkeypatch.setattr(runner, "_work", lambda *all_: replace(whole(*all_), policy=Bomb(*fuses)))
    monkeypatch.setattr(runner, "_PATIENCE", 2)
    with pytest.raises(WorkersDiedError, match=r"workers died 2 times .* goes on; left: golden--slalom"):
        run([TINY], tmp_path / "dead", workers=2, quiet=True)


def test_a_dask_cluster_gives_the_same_numbers(reference: Results, tmp_path: Path) -> None:
    """A real scheduler and two worker processes, over loopback."""
    pytest.importorskip("distributed")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "3"}
    contact = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli"]
    options = ["--scheduler-file", str(contact), "--no-dashboard"]
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *options],
            env=environment,
            cwd=tmp_path,
            stderr=subprocess.DEVNULL,
        )
    ]
    try:
        until = time.monotonic() + 60.0
        while not contact.exists():
            assert started[0].poll() is None, dask
            assert time.monotonic() < until
            time.sleep(0.1)
        started += [
            subprocess.Popen(
                [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", *options],
                env=environment,
                cwd=tmp_path,
                stderr=subprocess.DEVNULL,
            )
            for _ in range(2)
        ]
        address = json.loads(contact.read_text())["address"]
        same(run([TINY], tmp_path / "dask", backend="dask", address=address, quiet=True), reference)
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"backend": "slurm"}, "valid: loky, dask"),
        ({"backend": "dask"}, "needs --address"),
        ({"address": "tcp://127.0.0.1:1"}, "needs --address"),
        ({"workers": 0}, "--jobs 0"),
    ],
)
def test_bad_options(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        run([TINY], tmp_path / "x", **options)


def test_a_scheduler_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(runner, "_CONTACT", 0.5)
    with pytest.raises(ValueError, match="no Dask scheduler answers there"):
        run([TINY], tmp_path / "x", backend="dask", address="tcp://127.0.0.1:9")


def test_what_goes_wrong_in_a_case_is_its_result(tmp_path: Path) -> None:
    job = jobs([TINY])[0]
    work = runner._work(job, {}, {}, runner.Store(tmp_path), None)
    lost = carry_out(work)
    assert (lost.case.status, lost.case.error.split(":")[0]) == ("error", "AssertionError")
    other = carry_out(replace(work, source="0" * 16))
    assert "are not the run's (0000000000000000)" in other.case.error
    learner = replace(job, controller="nfq-idoe")
    scenario = {TINY.scenarios[0].name: TINY.scenarios[0]}
    untaught = carry_out(runner._work(learner, scenario, {}, runner.Store(tmp_path), None))
    assert untaught.case.error == "RuntimeError: its training training--train-clean--nfq-idoe--s0 did not finish"


def test_a_learner_is_taught_once_and_its_net_drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.run import trainings

    short = replace(trainings.TRAININGS["clean"], minutes=0.4)
    monkeypatch.setitem(trainings.TRAININGS, "clean", short)
    one = replace(TINY, controllers=("stanley", "nfq-paper-idoe"), seeds=1)
    two = replace(one, name="tracking", scenarios=(replace(TINY.scenarios[0], name="slow", v_max=5.0),))
    monkeypatch.setitem(trainings.TRAININGS, "published", short)
    results = run([one, two], tmp_path / "learn", workers=1, quiet=True)
    assert [case.kind for case in results.cases] == ["learn", "drive", "drive", "drive", "drive"]
    taught = results.cases[0]
    assert taught.status == "done", taught.error
    assert taught.metrics["transitions"] > 50
    assert taught.metrics["round_minutes"] == math.inf
    curve = results.curve(taught)
    assert curve is not None
    assert len(curve["t"]) == taught.metrics["trainings"]
    assert (curve["t"][:-1] <= curve["t"][1:]).all()
    again = run([replace(one, name="paper")], tmp_path / "again", workers=1, quiet=True)
    assert again.cases[0].metrics == taught.metrics
    assert compare(results, again, rel=0.0, absolute=0.0).changes == ()
    driven = [case for case in results.cases if case.controller == "nfq-paper-idoe" and case.kind == "drive"]
    assert all(0.0 < case.metrics["rounds"] <= 1.0 for case in driven)


# ---- command line


def test_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reference: Results) -> None:
    monkeypatch.setitem(SUITES, "golden", TINY)
    monkeypatch.chdir(tmp_path)
    say = CliRunner().invoke
    listed = say(app, ["list", "--scenarios"]).output
    assert "robustness" in listed
    assert "nonlinear-mpc" in listed
    ran = say(app, ["run", "golden", "--jobs", "1", "--quiet", "--json", "--only", "textbook"])
    assert ran.exit_code == 0, ran.output
    told = json.loads(ran.output.splitlines()[-1])
    assert (told["out"], told["done"], told["errors"]) == ("runs/benchmarks/golden", 3, 0)
    compared = say(app, ["compare", str(reference.place), "runs/benchmarks/golden", "--json", "--strict"])
    assert compared.exit_code == 1
    assert json.loads(compared.output.splitlines()[-1]) == {
        "same": False,
        "compared": 72,
        "changed": 0,
        "only_a": 3,
        "only_b": 0,
    }
    assert "Nothing to compare" in say(app, ["verdict", str(reference.place)]).output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "papr"], "did you mean 'paper'"),
        (["report", "nowhere"], "there are no such results"),
        (["compare", "a", "b"], "there are no such results"),
        (["run", "golden", "--only", "xyz"], "--only xyz: no scenario or controller"),
    ],
)
def test_mistakes_are_one_line(words, message, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["benchmarks", *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    told = capsys.readouterr().err.strip()
    assert message in told
    assert "\n" not in told
