"""The runner: the same numbers whatever carries them out, and no finished case is lost."""

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.entries import controller
from benchmarks.run import runner, spread
from benchmarks.run.drives import shape
from benchmarks.run.results import Results, load_results
from benchmarks.run.runner import carry_out, run
from benchmarks.run.spread import WorkersDiedError
from benchmarks.run.trainings import TRAININGS
from benchmarks.suites import jobs, suite
from tests.support import programs
from tests.support.tiny_suite import TINY, same


@pytest.fixture(autouse=True)
def forks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers begin as forks: what they import takes longer than what they do."""
    programs.forking(monkeypatch.setattr)


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
    fuse, place, whole = tmp_path / "fuse", tmp_path / "worker", runner.work_of

    def armed(job: Any, *rest: Any) -> Any:
        work = whole(job, *rest)
        return replace(work, policy=Bomb(fuse)) if job.seed == 1 and job.controller == "stanley" else work

    monkeypatch.setattr(runner, "work_of", armed)
    results = run([TINY], place, workers=2, quiet=True)
    assert fuse.exists()
    named = [case for case in results.cases if case.status != "done"]
    assert [case.error for case in named] == ["AttributeError: 'int' object has no attribute 'block'"]
    monkeypatch.setattr(runner, "work_of", whole)
    same(run([TINY], place, workers=1, quiet=True), reference)  # the case that went wrong is tried again


def test_workers_that_always_die_end_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fuses = [tmp_path / f"fuse{n}" for n in range(9)]
    whole = runner.work_of
    monkeypatch.setattr(runner, "work_of", lambda *all_: replace(whole(*all_), policy=Bomb(*fuses)))
    monkeypatch.setattr(spread, "_PATIENCE", 2)
    with pytest.raises(WorkersDiedError, match=r"workers died 2 times with nothing finished .*; 6 of 6 are left"):
        run([TINY], tmp_path / "dead", workers=2, quiet=True)


def test_what_goes_wrong_in_a_case_is_its_result(tmp_path: Path) -> None:
    job = jobs([TINY])[0]
    work = runner.work_of(job, {}, {}, runner.Store(tmp_path), None)
    lost = carry_out(work)
    assert (lost.case.status, lost.case.error.split(":")[0]) == ("error", "AssertionError")
    learner = replace(job, controller="nfq-idoe")
    scenario = {TINY.scenarios[0].name: TINY.scenarios[0]}
    untaught = carry_out(runner.work_of(learner, scenario, {}, runner.Store(tmp_path), None))
    assert untaught.case.error == "RuntimeError: its training training--train-clean--nfq-idoe--s0 did not finish"


def test_a_learner_is_taught_once_and_its_net_drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("clean", "published"):
        monkeypatch.setitem(TRAININGS, name, replace(TRAININGS["clean"], minutes=0.2))
    one = replace(TINY, controllers=("stanley", "nfq-paper-idoe"), seeds=1)
    two = replace(one, name="tracking", scenarios=(TINY.scenarios[0].with_(name="slow", driver={"v_max": 5.0}),))
    results = run([one, two], tmp_path / "learn", workers=1, quiet=True)
    assert [case.kind for case in results.cases] == ["learn", "drive", "drive", "drive", "drive"]
    taught = results.cases[0]
    assert taught.status == "done", taught.error
    assert taught.metrics["transitions"] > 50
    assert taught.metrics["round_minutes"] == math.inf
    curve = results.curve(taught)
    assert curve is not None
    assert len(curve["t"]) == taught.metrics["trainings"]
    again = run([replace(one, name="paper")], tmp_path / "again", workers=1, quiet=True)
    assert again.cases[0].metrics == taught.metrics
    driven = [case for case in results.cases if case.controller == "nfq-paper-idoe" and case.kind == "drive"]
    assert all(0.0 < case.metrics["rounds"] <= 1.0 for case in driven)


def test_files_that_workers_hand_back_are_written_by_whoever_asked(reference: Results, tmp_path: Path) -> None:
    """The same files as a worker of this machine writes."""
    store = runner.Store(tmp_path / "results")
    store.open(reference.provenance)
    scenario = {one.name: one for one in TINY.scenarios}
    done = carry_out(runner.work_of(jobs([TINY])[0], scenario, {}, store, None))
    case = done.case
    assert set(done.files or ()) == {f"trajectories/{case.id}.npz", f"cases/{case.id}.json"}
    assert list(done.files or ())[-1] == f"cases/{case.id}.json", "last: then it has finished"
    assert not store.has(case.id)
    kept = list(runner.kept(iter([done, runner.Done(replace(case, seed=7))]), store))
    assert [(one.case.seed, one.files) for one in kept] == [(case.seed, None), (7, None)]
    (mine,) = load_results(store.place).cases
    (theirs,) = [one for one in reference.cases if one.id == case.id]
    assert mine.metrics == theirs.metrics
    one, other = (results.trajectory(theirs) for results in (reference, load_results(store.place)))
    np.testing.assert_equal(one, other)


def test_one_case_that_cannot_be_written_is_told_while_others_can(
    reference: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, case = runner.Store(tmp_path), reference.cases[0]
    monkeypatch.setattr(store, "write", lambda files: tmp_path.write_bytes(b"a folder"))
    done = [runner.Done(case, {"cases/one.json": b""}), *[runner.Done(case)] * 3]
    with pytest.raises(IsADirectoryError):
        list(runner.kept((time.sleep(0.05) or one for one in done), store))  # type: ignore[func-returns-value]


def test_drives_that_are_compiled_alike_are_handed_out_together(tmp_path: Path) -> None:
    """Few workers: up to eight cases of a form at once, and each case once; many: each case alone."""
    one = suite("robustness")
    scenes = {scene.name: scene for scene in one.scenarios}
    planned = jobs([one], 1, ["lqr"])
    work = [runner.work_of(job, scenes, {}, runner.Store(tmp_path), None) for job in planned]
    batches = runner.together(work, 1)
    assert sorted(piece.job.id for batch in batches for piece in batch) == sorted(job.id for job in planned)
    seen = [{shape(controller("lqr").as_believed(piece.scenario)) for piece in batch} for batch in batches]  # type: ignore[arg-type]
    assert {len(forms) for forms in seen} == {1}
    assert max(map(len, batches)) == 8
    forms = set.union(*seen)
    assert len(forms) <= len(batches) <= len(forms) + len(work) // 8
    assert [len(batch) for batch in runner.together(work, 1000)] == [1] * len(work)
    taught = [replace(piece, job=replace(piece.job, kind="learn")) for piece in work]
    assert [len(batch) for batch in runner.together(taught, 1)] == [1] * len(work)
