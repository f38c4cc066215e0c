"""The learning experiment: it counts, it resumes with the same numbers, and it refuses what is not its own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.policy import DOE
from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.scenario import Scenario
from tests.support.short_run import SHORT


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


def test_a_car_that_is_nowhere_is_an_error_and_no_silence() -> None:
    run = LearningRun(Experiment(minutes=0.1))
    for _ in range(5):
        run.drive()
    car = run.loop.names.index("car")
    run.x[car] = type(run.x[car])(*[float("nan")] * len(run.x[car]))
    with pytest.raises(ValueError, match=r"at 0\.25 s the learner's state is e = nan, .*expected finite numbers"):
        run.drive()


def test_the_jump_back_to_the_start_of_an_open_course_is_no_transition() -> None:
    """A wheel left alone on a straight: carried back again and again, never caught."""
    scenario = Scenario(course="straight", driver={"v_min": 4.0, "v_max": 7.5})
    run = LearningRun(Experiment(setting=replace(SHORT.setting, retrain_every_m=0.0), scenario=scenario, minutes=0.5))
    nets = tuple(tuple(np.zeros_like(part) for part in net) for net in run.learner_state.policy.nets)
    run.learner_state.policy = replace(
        run.learner_state.policy, nets=nets
    )  # all actions are worth the same: the gentlest wins
    run.steer()
    run._put_back(run.path.length - 60.0)
    for _ in range(100):
        run.drive()
    run._put_back(run.path.length - 40.0)
    while run._value("path.s") > 100.0:
        run.drive()
    for _ in range(20):
        run.drive()
    log, record = run.recorder.log(), run.transitions
    assert (log["supervisor.learning"] > 0.5).all()
    jumps = np.flatnonzero(np.abs(np.diff(log["path.s"])) > 10.0)
    assert len(jumps) >= 2
    assert len(record) == len(log.t) - 1 - len(jumps)
    follows = record.episode[1:] == record.episode[:-1]
    np.testing.assert_array_equal(record.s[1:][follows], record.s_next[:-1][follows])
    assert (~follows).sum() == len(jumps)
    assert run.counts.failures == 0


def test_each_sample_is_told_as_it_is_recorded() -> None:
    told: list[tuple[float, float]] = []
    run = learn(replace(SHORT, minutes=0.05), each=lambda sample: told.append((sample.t, sample["path.e"])))
    log = run.recorder.log()
    assert told == list(zip(log.t.tolist(), log["path.e"].tolist(), strict=True))
    assert len(told) == 60


def safely(seconds: float, **changes: Any) -> LearningRun:
    setting = replace(SHORT.setting, safe=True, **changes)
    return learn(Experiment(setting=setting, scenario=Scenario.under("hard"), minutes=seconds / 60.0, seed=0))


@pytest.mark.parametrize("doe", ["integrator", "low-pass", "plain"])
def test_a_learner_with_a_filter_is_corrected_and_taken_from_the_wheel_within_the_bound(doe: str) -> None:
    run = safely(5.0, doe=doe)
    log = run.recorder.log()
    assert np.abs(log["path.e"]).max() < 0.5
    corrected = (log["safety.share"] > 0.0) & (log["supervisor.learning"] > 0.5)
    first = run.counts.episodes[0]
    assert first.failed
    assert corrected[log.t < first.ended].sum() == 10
    assert np.abs(log["path.e"][log.t < first.ended]).max() < 0.45
    free = learn(
        Experiment(setting=replace(run.experiment.setting, safe=False), scenario=Scenario.under("hard"), minutes=0.1)
    )
    assert np.abs(free.recorder.log()["path.e"]).max() > 0.5


def test_a_filter_that_finds_its_doubts_too_small_says_so_once() -> None:
    scenario, told = Scenario.under("hard", steering={"delay": 0.3}, knowledge={"delay": 0.1}), list[tuple[str, str]]()
    experiment = Experiment(setting=replace(SHORT.setting, safe=True), scenario=scenario, minutes=0.1, seed=0)
    run = learn(experiment, watch=lambda what, run: told.append((what, run.doubted)))
    assert [words[:31] for what, words in told if what == "doubted"] == ["commands arrive 0.20 s later th"]
    late = run.recorder.log()["safety.late"]
    assert late[0] == 0.0 < late[-1]


def test_what_a_corrected_sample_teaches_is_what_was_done() -> None:
    """The integrator's angle afterwards is that before and the action, of each transition there is."""
    run = safely(3.0)
    rows = run.transitions
    assert (run.recorder.log()["safety.correction"] != 0.0).any()
    assert np.abs(rows.s_next[:, DOE] - rows.s[:, DOE] - rows.a).max() < 1e-9


def test_the_next_policy_begins_uncorrected() -> None:
    setting = replace(SHORT.setting, safe=True)
    run = LearningRun(Experiment(setting=setting, scenario=Scenario.under("hard"), minutes=1.0, seed=0))
    while run.learner_state.net == 0:
        before = run.counts.corrected
        run.drive()
    assert (before, run.counts.corrected) == (10, 0)


def test_a_plant_that_turns_the_other_way_ends_the_run() -> None:
    """At once, whoever steers."""
    scenario = Scenario(course="genesis", vehicle={"plant": "tests.support.wrong_signs:TurnsRight"})
    e: list[float] = []
    with pytest.raises(ValueError, match=r"steered the wrong way round.*the car turns against its wheel"):
        learn(Experiment(scenario=scenario, minutes=1.0), each=lambda sample: e.append(abs(sample["path.e"])))
    assert max(e) < 1.0
