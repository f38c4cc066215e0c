"""A learner of a study: when it was good, over whom, and how rows are summed up."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.foreign_cars import HOME, scene, told
from benchmarks.run import learners
from benchmarks.run.learners import (
    Job,
    Learner,
    best_told,
    eased,
    first_good,
    good,
    median,
    one_learner,
    over,
    share,
    spread,
    values,
    worst,
)
from benchmarks.run.trials import TrialDrive, drive_each
from steerkit.controllers.stanley import Stanley
from steerkit.metrics import GOOD, Criterion, of_log
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate
from tests.support.short_run import SHORT


def test_nets_are_driven_with_another_seed_and_judged_by_the_criterion() -> None:
    learner = Learner(replace(SHORT, minutes=0.15), Criterion(rms_e=0.0))
    net, experiment = learner.trained.nets[-1], learner.experiment
    (alone,) = drive_each(experiment.scenario, experiment.setting, [net.policy], seed=experiment.seed + 1000)
    assert learner.final is learner.drive(net)
    assert (learner.final.summary, learner.final.held) == (alone.summary, alone.held)
    assert not learner.final.good, "no RMS e is below 0"
    figures = learner.figures()
    assert (figures["good"], figures["nets"]) == (None, len(learner.trained.nets))
    assert (figures["held"], figures["final_rms_e"]) == (alone.held, alone.summary.rms_e if alone.summary else None)


def test_a_ratio_of_a_drive_that_was_not_held_is_infinite() -> None:
    summary = of_log(evaluate.drive(Scenario(course="circle"), Stanley.of(Scenario().nominal), rounds=1.0))
    half = replace(summary, rms_e=0.5 * summary.rms_e)
    assert over(TrialDrive(rounds=1.0, held=True, summary=half), "rms_e", summary) == pytest.approx(0.5)
    assert over(TrialDrive(rounds=1.0, held=False, summary=half), "rms_e", summary) == math.inf
    assert over(None, "rms_e", summary) == math.inf


def test_the_first_good_net_counts_from_when_it_took_the_wheel() -> None:
    nets: Any = [SimpleNamespace(t=float(t), policy=t) for t in range(20)]

    def judged(good: set[int]) -> Any:
        return lambda net: SimpleNamespace(good=net.policy in good)

    assert first_good(nets, judged({7, 3})) == 3.0
    assert first_good(nets, judged({13, 16})) == 16.0  # after the first dozen every fourth is judged
    assert first_good(nets, judged(set())) is None


def test_the_best_that_is_told_is_told_the_truth() -> None:
    untold = told(scene(HOME, 7.0, 7.0, 0).with_(course={"rounds": 0.3}), 0.0)
    assert (untold.believed_dead_time, told(untold, 1.5).believed_dead_time) == (0.0, pytest.approx(0.3))
    name, best = best_told(untold, ("lqr", "stanley"), seed=3)
    truth = untold.with_(knowledge={"delay": None})
    assert name == "lqr", "Stanley makes no use of a dead time"
    assert best == of_log(evaluate.drive(truth, evaluate.controller("lqr", truth), seed=3))


def test_what_never_happened_counts_as_infinite() -> None:
    rows: list[Any] = [{"good": 10.0, "x": 1.0}, {"good": 30.0, "x": math.nan}, {"good": None, "x": 2.0}]
    assert values(rows, "x").tolist() == [1.0, math.inf, 2.0]
    assert (median(rows, "good"), worst(rows, "good"), share(rows, "good")) == (30.0, math.inf, pytest.approx(2 / 3))
    assert good(rows[:2]) == {"good_share": 1.0, "good_median_s": 20.0, "good_worst_s": 30.0}
    assert share([{"held": True}, {"held": False}], "held") == 0.5


def test_the_spread_is_the_factor_of_the_one_that_is_furthest_off() -> None:
    assert spread([10.0, 11.0, 12.0]) == pytest.approx(1.1)
    assert spread([10.0, 11.0, 15.4]) == pytest.approx(1.4)
    assert spread([10.0, math.inf]) == math.inf
    assert math.isnan(spread([]))


def test_a_learner_that_had_no_time_to_learn_has_infinite_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    summary: Any = SimpleNamespace(rms_e=0.1, max_e=0.3, max_jerk=4.0, rms_wheel_rate_deg=20.0)
    monkeypatch.setattr(learners, "best_told", lambda *_: ("lqr", summary))
    made = one_learner(Job("torque", 8.0, 12.0, 0, 0.02, "hard", 2))
    assert (made["good"], made["nets"], made["held"]) == (None, 0, False)
    assert made["rms_x"] == made["rms_x_1"] == math.inf
    assert math.isnan(made["final_rms_e"])
    assert (made["best"], made["best_rms_e"], made["best_wheel_deg"], made["best_good"]) == ("lqr", 0.1, 20.0, False)


def test_what_the_best_that_is_told_cannot_keep_to_is_asked_of_no_net() -> None:
    figures: Any = SimpleNamespace(max_e=0.1, rms_e=0.02, max_jerk=2.0)
    assert eased(figures) == GOOD
    criterion = eased(SimpleNamespace(max_e=0.3, rms_e=0.08, max_jerk=5.2))  # type: ignore[arg-type]
    assert (criterion.max_e, criterion.rms_e, criterion.max_jerk) == pytest.approx((0.33, GOOD.rms_e, 5.72))
    assert eased(SimpleNamespace(max_e=math.nan, rms_e=math.inf, max_jerk=math.nan)) == GOOD  # type: ignore[arg-type]
