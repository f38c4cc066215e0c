"""A careful human keeps both accelerations."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.paths.courses import circle, course
from steerkit.paths.path import Path
from steerkit.plants.curve_speed_driver import CurveSpeedDriver
from steerkit.plants.speed_driver import SpeedDriver


def test_a_careful_human_keeps_both_accelerations() -> None:
    path = course("paper")
    driver = CurveSpeedDriver(path=path, driver=SpeedDriver(v_min=7.5, v_max=7.5))
    s = np.linspace(0.0, path.length, 8000)
    v = driver.output(0.0, driver.init((len(s),)), driver.D(s)).v
    assert (v**2 * np.abs(path.kappa(s))).max() < 3.1
    assert np.abs(np.diff(v**2) / (2.0 * np.diff(s))).max() < 1.6
    assert v.max() > 6.9
    assert v.min() == pytest.approx(np.sqrt(3.0 / np.abs(path.samples.kappa).max()), rel=0.02)


def test_a_careful_human_on_an_open_course_does_not_brake_for_its_own_start() -> None:
    path = course("genesis-rfs")
    driver = CurveSpeedDriver(path=path, driver=SpeedDriver(v_min=7.0, v_max=7.5), a_y_max=3.0)
    bend = float(path.samples.s[np.abs(path.samples.kappa).argmax()])
    fast, slow = (driver.output(0.0, driver.init(), driver.D(s)).v for s in (path.length, bend))
    assert fast > 7.0 > 6.95
    assert slow < 7.5
    with pytest.raises(ValueError, match="a_y_max"):
        CurveSpeedDriver(path=path, driver=SpeedDriver(), a_y_max=0.0)


def speeds(path: Path, s: np.ndarray, fastest: float = 30.0) -> np.ndarray:
    driver = CurveSpeedDriver(path=path, driver=SpeedDriver(v_min=fastest, v_max=fastest))
    return driver.output(0.0, driver.init((len(s),)), driver.D(s)).v


def test_a_circle_is_driven_at_the_comfortable_acceleration() -> None:
    assert speeds(circle(20.0), np.array([0.0, 33.0, 100.0])) == pytest.approx(np.sqrt(3.0 * 20.0), rel=1e-3)


def test_braking_and_speeding_up_take_all_of_what_they_may() -> None:
    """Straights that are long enough for both: on the way there v^2 changes by 2*1.5 m/s^2 a metre, and not more."""
    path = course("paper")
    s = np.linspace(0.0, path.length, 8001)
    slope = np.diff(speeds(path, s) ** 2) / np.diff(s)
    for steepest in (slope.max(), -slope.min()):  # v is linear between the metres, so v^2 nearly is
        assert steepest == pytest.approx(2.0 * 1.5, rel=0.03)


@pytest.mark.parametrize("start", [50.0, 190.0, 333.0, 610.0])
def test_where_a_closed_course_begins_does_not_matter(start: float) -> None:
    path = course("paper")
    s = np.linspace(0.0, path.length, 400, endpoint=False)
    np.testing.assert_allclose(speeds(path.started_at(start), (s - start) % path.length), speeds(path, s), atol=0.15)
