"""Learners on foreign cars: how their figures come from drives."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.foreign_cars import CARS, foreign_scenarios
from benchmarks.run import foreign_learning
from benchmarks.run.foreign_learning import Job, eased, one_learner, spread
from steerkit.metrics import GOOD


def test_the_spread_is_the_factor_of_the_one_that_is_furthest_off() -> None:
    assert spread([10.0, 11.0, 12.0]) == pytest.approx(1.1)
    assert spread([10.0, 11.0, 15.4]) == pytest.approx(1.4)
    assert spread([10.0, math.inf]) == math.inf
    assert math.isnan(spread([]))


def test_a_learner_that_had_no_time_to_learn_has_infinite_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    summary: Any = SimpleNamespace(rms_e=0.1, max_e=0.3, max_jerk=4.0, rms_wheel_rate_deg=20.0)
    monkeypatch.setattr(foreign_learning, "best_told", lambda *_: ("lqr", summary))
    made = one_learner(Job("torque", 8.0, 12.0, 0, 0.02, "hard", 2))
    assert (made.good, made.nets, made.held, made.rms_x, made.rms_x_1) == (None, 0, False, math.inf, math.inf)
    assert math.isnan(made.final_rms_e)
    assert (made.best, made.best_rms_e, made.best_wheel_deg) == ("lqr", 0.1, 20.0)
    assert not made.best_good


def test_what_the_best_that_is_told_cannot_keep_to_is_asked_of_no_net() -> None:
    told: Any = SimpleNamespace(max_e=0.1, rms_e=0.02, max_jerk=2.0)
    assert eased(told) == GOOD
    told = SimpleNamespace(max_e=0.3, rms_e=0.08, max_jerk=5.2)
    criterion = eased(told)
    assert (criterion.max_e, criterion.rms_e, criterion.max_jerk) == pytest.approx((0.33, GOOD.rms_e, 5.72))
    lost: Any = SimpleNamespace(max_e=math.nan, rms_e=math.inf, max_jerk=math.nan)
    assert eased(lost) == GOOD


def test_the_suite_has_every_car_in_both_ranges_and_tells_nothing() -> None:
    scenarios = foreign_scenarios()
    assert len({scenario.name for scenario in scenarios}) == len(scenarios) == 2 * len(CARS)
    assert {scenario.believed_dead_time for scenario in scenarios} == {0.0}
