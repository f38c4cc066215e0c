"""Learners on foreign cars: how their figures come from drives."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.foreign_cars import CARS, HOME, foreign_scenarios, scene, told
from benchmarks.run import foreign_learning
from benchmarks.run.foreign_learning import Job, best_told, one_learner, spread
from steerkit.metrics import of_log
from steerkit.scenario import drive


def test_the_spread_is_the_factor_of_the_one_that_is_furthest_off() -> None:
    assert spread([10.0, 11.0, 12.0]) == pytest.approx(1.1)
    assert spread([10.0, 11.0, 15.4]) == pytest.approx(1.4)
    assert spread([10.0, math.inf]) == math.inf
    assert math.isnan(spread([]))


def test_the_best_that_is_told_is_told_the_truth() -> None:
    untold = told(scene(HOME, 7.0, 7.0, 0), 0.0)
    assert (untold.believed_dead_time, told(untold, 1.5).believed_dead_time) == (0.0, pytest.approx(0.3))
    name, best = best_told(untold, ("lqr", "stanley"), seed=3)
    truth = untold.with_(knowledge={"delay": None})
    assert name == "lqr", "Stanley makes no use of a dead time"
    assert best == of_log(drive.drive(truth, drive.controller("lqr", truth), seed=3))


def test_a_learner_that_had_no_time_to_learn_has_infinite_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    summary: Any = SimpleNamespace(rms_e=0.1, rms_wheel_rate_deg=20.0)
    monkeypatch.setattr(foreign_learning, "best_told", lambda *_: ("lqr", summary))
    made = one_learner(Job("torque", 8.0, 12.0, 0, 0.02, "hard", 2))
    assert (made.good, made.nets, made.held, made.rms_x, made.rms_x_1) == (None, 0, False, math.inf, math.inf)
    assert math.isnan(made.rms_e)
    assert (made.best, made.best_rms_e, made.best_wheel_deg) == ("lqr", 0.1, 20.0)


def test_the_suite_has_every_car_in_both_ranges_and_tells_nothing() -> None:
    scenarios = foreign_scenarios()
    assert len({scenario.name for scenario in scenarios}) == len(scenarios) == 2 * len(CARS)
    assert {scenario.believed_dead_time for scenario in scenarios} == {0.0}
