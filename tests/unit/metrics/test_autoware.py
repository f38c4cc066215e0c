"""Autoware's figures of a known drive."""

from __future__ import annotations

import math

import numpy as np
import pytest

from steerkit import metrics
from steerkit.metrics.autoware import LEFT_OUT


def test_autowares_figures_of_a_known_drive() -> None:
    t = np.arange(201) * 0.05
    found = metrics.control_evaluator(
        t, e=0.1 - 0.02 * t, psi_e=np.full(201, -0.03), delta=0.05 * t**2, a_y=-0.2 * t, v=4.0 + 0.3 * t
    )
    assert found["lateral_deviation"].max == pytest.approx(0.1)
    assert found["lateral_deviation"].min == pytest.approx(-0.1)
    assert found["lateral_deviation_abs"].mean == pytest.approx(0.05, abs=1e-3)
    assert found["lateral_deviation"].count == 101  # 10 s, every 100 ms
    assert found["yaw_deviation"].mean == pytest.approx(-0.03)
    assert found["yaw_deviation_abs"].mean == pytest.approx(0.03)
    assert found["steering_rate"].max == pytest.approx(0.1 * 9.95)  # mean rate of the last 100 ms
    assert found["steering_acceleration"].mean == pytest.approx(0.1)
    assert found["lateral_acceleration"].max == pytest.approx(2.0)
    assert found["acceleration"].mean == pytest.approx(0.3)
    assert found["jerk"].max == pytest.approx(0.0, abs=1e-9)
    assert found["velocity"].max == pytest.approx(7.0)
    assert not set(found) & set(LEFT_OUT)


def test_the_goal_is_missed_ahead_to_the_left_and_turned() -> None:
    """Goal at (10, 5) heading north; the car 2 m further north and 1 m east of it: ahead, to the right."""
    found = metrics.goal_deviation((11.0, 7.0, math.pi / 2.0 + 0.1 - 4.0 * math.pi), (10.0, 5.0, math.pi / 2.0))
    assert found["goal_longitudinal_deviation"] == pytest.approx(2.0)
    assert found["goal_lateral_deviation"] == pytest.approx(-1.0)
    assert found["goal_lateral_deviation_abs"] == pytest.approx(1.0)
    assert found["goal_yaw_deviation"] == pytest.approx(0.1)


@pytest.mark.parametrize(("dt", "looks"), [(0.02, 51), (0.05, 51), (0.1, 51), (0.2, 26), (0.25, 21)])
def test_rates_are_per_second_however_often_the_record_looks(dt: float, looks: int) -> None:
    """Every 100 ms, or as often as the record is sampled, if that is less."""
    t = np.arange(round(5.0 / dt) + 1) * dt
    found = metrics.control_evaluator(
        t, e=0.0 * t, psi_e=0.0 * t, delta=0.3 * t, a_y=-2.0 + 0.0 * t, v=1.0 + 0.5 * t - 0.04 * t**2
    )
    assert found["steering_rate"].mean == pytest.approx(0.3)
    assert found["acceleration"].mean == pytest.approx(0.3)  # 0.5 - 0.08 t, over 5 s
    assert found["jerk"].mean == pytest.approx(-0.08)
    assert found["lateral_acceleration"].min == pytest.approx(2.0)
    assert found["velocity"].count == looks
