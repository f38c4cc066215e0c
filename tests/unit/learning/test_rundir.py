"""Run directories: going on, broken and foreign ones, an experiment's plain form."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import PAPER, SETTINGS, setting
from steerkit.scenario import Scenario
from tests.support.short_run import SHORT
from tests.support.stores import ARRAYS
from tests.support.yard import yard


def test_broken_and_foreign_directories_are_named(kept: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no run\.json"):
        rundir.load(tmp_path)
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(ValueError, match="not empty and holds no run"):
        learn(SHORT, tmp_path)
    with pytest.raises(ValueError, match="another experiment"):
        learn(replace(SHORT, seed=9), kept)
    whole = (kept / "run.json").read_text()
    for text, why in (
        (whole[:100], "truncated"),
        (json.dumps({"format": "other"}), "format 'other'"),
        (whole.replace('"pending"', '"pendimg"'), r"run\.json: damaged, without pending"),
        (whole.replace('"ended"', '"en$ed"'), r"run\.json: damaged counts \(.*'en\$ed'"),
        (whole, "not whole"),
    ):
        (tmp_path / "run.json").write_text(text)
        with pytest.raises(ValueError, match=why):
            rundir.load(tmp_path)


@pytest.mark.parametrize("name", SETTINGS)
def test_an_experiment_survives_its_plain_form(name: str) -> None:
    experiment = Experiment(setting=setting(name), scenario=Scenario.under("hard"), seed=5)
    data = json.loads(json.dumps(rundir.plain(experiment)))
    assert rundir.from_plain(data, "test") == experiment


def test_a_sparse_configuration_takes_the_defaults() -> None:
    sparse = {"minutes": 3.0, "setting": {"fit": {"nets": 1}, "cost": {"kind": "IdoeCost"}}}
    experiment = rundir.from_plain(sparse, "my.toml", Experiment)
    assert experiment.minutes == 3.0
    assert experiment.setting.cost == PAPER.cost
    assert experiment.setting.fit.nets == 1
    assert experiment.scenario == Scenario()


CURT = replace(SHORT.setting, fit=FitSetting(epochs=3, mirror=True, nets=1), fit_seconds=0.5)
RUNS = {
    "carried back": Experiment(setting=replace(CURT, after_failure="reset", reset_seconds=5.0), minutes=0.5, seed=3),
    "corrected": Experiment(
        setting=replace(CURT, retrain_every_m=2.0, safe=True, corrected_seconds=1.0),
        scenario=Scenario.under("hard"),
        minutes=0.1,
        seed=3,
    ),
    "an open course": Experiment(
        setting=replace(CURT, retrain_every_m=4.0), scenario=Scenario(course="slalom"), minutes=0.15, seed=5
    ),
}


@pytest.mark.parametrize(
    ("name", "trusted"), [("carried back", {False}), ("corrected", {True}), ("an open course", {False, True})]
)
def test_a_run_resumed_at_any_checkpoint_is_the_run_that_went_on(name: str, trusted: set[bool], tmp_path: Path) -> None:
    """Checkpoints, each with a training under way, after a failure (nobody is trusted) and in the middle of driving."""
    experiment, place, copies = RUNS[name], tmp_path / "run", list[Path]()
    seen: set[tuple[bool, bool]] = set()
    run = LearningRun(experiment)
    place.mkdir()
    rundir.keep_in(run, place)
    write = run.keep
    assert write is not None

    def keep(run: LearningRun) -> None:
        write(run)
        what = (run.learner_state.before is not None, run.learner_state.trusted)
        if what not in seen:
            assert run.trainer.pending is not None
            seen.add(what)
            copies.append(Path(shutil.copytree(place, tmp_path / f"copy{len(copies)}")))

    run.keep = keep
    while not run.done():
        run.drive()
    assert any(before for before, _ in seen) is (experiment.setting.after_failure != "reset")  # half a transition
    assert {steers for _, steers in seen} == trusted
    for copy in copies:
        again = learn(experiment, copy)
        for rows in ARRAYS:
            np.testing.assert_array_equal(getattr(again.transitions, rows), getattr(run.transitions, rows))
        assert replace(again.counts, train_seconds=0.0) == replace(run.counts, train_seconds=0.0)
        assert again.x == run.x


def test_a_run_on_files_is_carried_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = yard(tmp_path)
    experiment = Experiment(scenario=Scenario(course=str(file)), minutes=0.05, seed=1)
    learn(experiment, tmp_path / "here" / "run")
    file.unlink()
    (tmp_path / "here").rename(tmp_path / "there")
    monkeypatch.chdir("/")
    run = rundir.load(tmp_path / "there" / "run")
    assert run.experiment == experiment
    assert run.path.length == experiment.scenario.path().length
    yard(tmp_path, radius=30.0)
    other = Experiment(scenario=Scenario(course=str(file)), minutes=0.05, seed=1)
    with pytest.raises(ValueError, match="a run of another experiment"):
        learn(other, tmp_path / "there" / "run")
