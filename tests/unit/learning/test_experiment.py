"""The learning experiment: it counts, it resumes with the same numbers, and it refuses what is not its own."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import DEFAULT, PAPER, SETTINGS, changed, setting
from steerkit.scenario.world import World

SHORT = Experiment(
    setting=replace(DEFAULT, fit=FitSetting(epochs=20, mirror=True, n_step=3, nets=2)), minutes=0.8, seed=3
)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("runs") / "run"
    learn(SHORT, place)
    return place


def test_a_failure_ends_the_episode_and_a_net_takes_over_after_the_charged_time(kept: Path) -> None:
    run = rundir.load(kept)
    log = rundir.drive_log(kept)
    learning = log["supervisor.learning"] > 0.5
    first = run.counts.episodes[0]
    assert first.ended is not None
    after = learning & (log.t >= first.ended)
    assert abs(log["path.e"][log.t < first.ended]).max() <= 0.5
    assert log.t[after][0] >= first.ended + SHORT.setting.fit_seconds
    assert abs(log["path.e"][after][0]) < 0.1


def test_no_transition_is_recorded_under_recovery(kept: Path) -> None:
    run = rundir.load(kept)
    learning = rundir.drive_log(kept)["supervisor.learning"] > 0.5
    tripped = run.counts.failures
    held = int(learning.sum())
    still_driving = int(bool(learning[-1]))
    assert len(run.transitions) == held - still_driving
    failures = np.abs(run.transitions.s_next[:, 0]) > 0.5
    assert failures.sum() == tripped


def test_an_interrupted_run_goes_on_with_the_same_numbers(kept: Path, tmp_path: Path) -> None:
    class Killed(Exception):
        pass

    def kill(what: str, run: LearningRun) -> None:
        if run.counts.updates == 3:
            raise Killed

    with pytest.raises(Killed):
        learn(SHORT, tmp_path / "again", watch=kill)
    resumed = learn(SHORT, tmp_path / "again")
    whole = rundir.load(kept)
    assert np.array_equal(resumed.transitions.s, whole.transitions.s)
    assert resumed.counts.episodes == whole.counts.episodes
    a, b = rundir.drive_log(tmp_path / "again"), rundir.drive_log(kept)
    assert all(np.array_equal(a[name], b[name]) for name in a)


def test_the_same_seed_gives_the_same_run_and_another_seed_another(kept: Path) -> None:
    assert np.array_equal(
        learn(replace(SHORT, minutes=0.3)).transitions.s, learn(replace(SHORT, minutes=0.3)).transitions.s
    )
    a, b = learn(replace(SHORT, minutes=0.3)), learn(replace(SHORT, minutes=0.3, seed=4))
    assert not np.array_equal(a.transitions.a[:20], b.transitions.a[:20])


def test_broken_and_foreign_directories_are_named(kept: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no run\.json"):
        rundir.load(tmp_path)
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(ValueError, match="not empty and holds no run"):
        learn(SHORT, tmp_path)
    with pytest.raises(ValueError, match="another experiment"):
        learn(replace(SHORT, seed=9), kept)
    (tmp_path / "run.json").write_text((kept / "run.json").read_text()[:100])
    with pytest.raises(ValueError, match="truncated"):
        rundir.load(tmp_path)
    (tmp_path / "run.json").write_text(json.dumps({"format": "other"}))
    with pytest.raises(ValueError, match="format 'other'"):
        rundir.load(tmp_path)
    (tmp_path / "run.json").write_text((kept / "run.json").read_text())
    with pytest.raises(ValueError, match="not whole"):
        rundir.load(tmp_path)


@pytest.mark.parametrize("name", SETTINGS)
def test_an_experiment_survives_its_plain_form(name: str) -> None:
    experiment = Experiment(setting=setting(name), world=World.under("hard"), seed=5)
    data = json.loads(json.dumps(rundir.plain(experiment)))
    assert rundir.from_plain(data, "test") == experiment


def test_configuration_errors_name_the_valid_choices() -> None:
    with pytest.raises(ValueError, match="valid: default, paper"):
        setting("defualt")
    with pytest.raises(ValueError, match="no field 'minuts'; valid: setting, world, minutes"):
        rundir.from_plain({"minuts": 3.0}, "my.toml", Experiment)
    with pytest.raises(ValueError, match="valid: clean, hard"):
        World.under("harder")
    with pytest.raises(ValueError, match="plant 'bicycle'"):
        World(plant="bicycle")


def test_a_sparse_configuration_takes_the_defaults() -> None:
    sparse = {"minutes": 3.0, "setting": {"fit": {"nets": 1}, "cost": {"kind": "IdoeCost"}}}
    experiment = rundir.from_plain(sparse, "my.toml", Experiment)
    assert experiment.minutes == 3.0
    assert experiment.setting.cost == PAPER.cost
    assert experiment.setting.fit.nets == 1
    assert experiment.world == World()


def test_a_reset_puts_the_car_back_and_costs_its_time(tmp_path: Path) -> None:
    setting_ = replace(SHORT.setting, after_failure="reset", reset_seconds=20.0)
    failed: list[float] = []

    def watch(what: str, run: LearningRun) -> None:
        if what == "failed":
            failed.append(run.t)

    run = learn(replace(SHORT, setting=setting_, minutes=0.7), tmp_path / "run", watch=watch)
    log = rundir.drive_log(tmp_path / "run")
    after = log.t > failed[0] + 0.01
    assert log.t[after][0] >= failed[0] + 20.0
    assert abs(log["path.e"][after][0]) < 1e-6
    assert run.counts.episodes[1].began >= failed[0] + 20.0


def test_with_a_shift_the_target_comes_to_the_car_and_the_learner_drives_on(tmp_path: Path) -> None:
    setting_ = replace(SHORT.setting, after_failure="shift")
    run = learn(replace(SHORT, setting=setting_, minutes=0.3), tmp_path / "run")
    log = rundir.drive_log(tmp_path / "run")
    learning = log["supervisor.learning"] > 0.5
    first = run.counts.episodes[0]
    assert first.ended is not None
    assert run.counts.episodes[1].began == pytest.approx(first.ended + 0.05)  # one sample, not until the net is ready
    beyond = np.flatnonzero(np.abs(log["path.e"]) > 0.5)
    assert learning[beyond].any()
    assert run.counts.failures == (np.abs(run.transitions.s_next[:, 0]) > 0.5).sum()


def test_exploration_takes_the_share_of_other_actions_that_was_asked_for() -> None:
    none = learn(replace(SHORT, minutes=0.2))
    some = learn(replace(SHORT, setting=replace(SHORT.setting, exploration=0.5), minutes=0.2))
    policy = nfq.fresh_nets(SHORT.setting.fit, seed=SHORT.seed)
    for run, least, most in ((none, 0.0, 0.0), (some, 0.25, 0.75)):
        before_training = run.transitions.episode == run.transitions.episode[0]
        s, a = run.transitions.s[before_training], run.transitions.a[before_training]
        actions = sorted(SHORT.setting.actions, key=abs)
        q = nfq.action_values(policy, s, actions, run.description)
        others = np.mean(np.array(actions)[q.argmin(axis=0)] != a)
        assert least <= others <= most  # six of seven random actions are other ones


def test_settings_are_changed_by_name() -> None:
    new = changed(DEFAULT, ["fit.nets=2", "after_failure=shift", "cost.goal=0.1", "calm=1", "actions_deg=[-9,0,9]"])
    assert (new.fit.nets, new.after_failure, new.cost.goal, new.calm) == (2, "shift", 0.1, 1)
    assert new.actions_deg == (-9, 0, 9)
    assert replace(DEFAULT.fit, nets=2) == new.fit


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("nets=2", "no 'nets' there; valid: name, actions_deg"),
        ("fit.nets", "expected name=value"),
        ("fit=2", "expected FitSetting, or its parts by their names"),
        ("fit.nets=two", "expected int"),
        ("fit.nets.x=2", "'nets' has no parts"),
        ("fit.nets=0", "expected >= 1"),
        ("after_failure=cry", "valid: recovery, reset, shift"),
        ("exploration=2", "expected 0 <= exploration <= 1"),
    ],
)
def test_wrong_changes_are_told(change: str, told: str) -> None:
    with pytest.raises(ValueError, match=re.escape(told)):
        changed(DEFAULT, [change])
