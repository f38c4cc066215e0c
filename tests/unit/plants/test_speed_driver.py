"""Drivers set the speed: statistics, seeds, records, profiles over the path, bends; a recorded drive comes back."""

import math

import numpy as np
import pytest

from steerkit.paths.courses import circle, course
from steerkit.paths.path import Path
from steerkit.plants.speed_driver import CurveSpeedDriver, Playback, SpeedDriver, SpeedProfile
from tests.support.stepped import run


def speeds(driver, steps, batch=()):
    x, v = driver.init(batch), []
    for k in range(steps):
        y = driver.output(k * driver.dt, x, driver.D())
        x = driver.update(k * driver.dt, x, driver.U(), y)
        v.append(y.v)
    return np.array(v)


def test_the_speed_wanders_smoothly_over_the_whole_range():
    driver = SpeedDriver(seed=1)
    v = speeds(driver, 1200, (64,))
    assert 4.0 < v.min() < 4.2
    assert 7.3 < v.max() < 7.5
    assert v.mean() == pytest.approx(5.75, abs=0.1)
    pace = np.diff(v, axis=0) / driver.dt
    assert 0.1 < pace.std() < 0.4
    assert np.abs(pace).max() < 2.5
    assert np.abs(np.diff(pace, axis=0)).max() < 0.5  # the pace itself does not jump


def test_it_is_stationary_from_the_start():
    x = SpeedDriver(seed=9).init((20_000,))
    z, g = np.array(x[:2])
    moments = [np.cov(z, g)]
    driver = SpeedDriver(seed=9)
    for _ in range(100):
        x = driver.update(0.0, x, None, None)
    moments.append(np.cov(np.array(x[:2])))
    assert moments[0] == pytest.approx(moments[1], abs=0.04)
    assert moments[0][0, 0] == pytest.approx(1.0, abs=0.03)


def test_speed_profile_over_progress():
    profile = SpeedProfile(speeds=(4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 7.5, 8.0), spacing=5.0)
    ask = [(-5.0,), (0.0,), (7.5,), (40.0,), (99.0,), (math.nan,)]
    found = [y.v for y in run(profile, ask)[0]]
    assert found == pytest.approx([4.0, 4.0, 4.75, 8.0, 8.0, math.nan], nan_ok=True)
    rounds = SpeedProfile(speeds=(4.0, 6.0, 4.0), spacing=10.0, repeat=True)
    assert rounds.output(0.0, (), rounds.D(np.array([45.0, -5.0]))).v == pytest.approx([5.0, 5.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SpeedDriver(v_min=8.0, v_max=7.0), r"v_max = 7.0 \[m/s\], expected 8 to 60; at least v_min"),
        (lambda: SpeedDriver(seed=-1), "seed = -1, expected a whole number"),
        (lambda: CurveSpeedDriver(path=circle(20.0), driver=SpeedDriver(dt=0.01)), "its driver has 0.01 s"),
        (lambda: Playback(angles=ANGLES, speeds=SPEEDS[:-1]), "5 angles, 4 speeds"),
        (lambda: SpeedProfile(speeds=(4.0,), spacing=1.0), "two numbers or more"),
        (lambda: SpeedProfile(speeds=(4.0, math.nan), spacing=1.0), r"speeds = .* \[m/s\]"),
    ],
)
def test_teaching_errors(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_careful_driver_on_an_open_course_does_not_brake_for_its_own_start() -> None:
    path = course("genesis-rfs")
    driver = CurveSpeedDriver(path=path, driver=SpeedDriver(v_min=7.0, v_max=7.5), a_y_max=3.0)
    bend = float(path.samples.s[np.abs(path.samples.kappa).argmax()])
    fast, slow = (driver.output(0.0, driver.init(), driver.D(s)).v for s in (path.length, bend))
    assert fast > 7.0 > 6.95
    assert slow < 7.5


def careful(path: Path, s: np.ndarray) -> np.ndarray:
    driver = CurveSpeedDriver(path=path, driver=SpeedDriver(v_min=30.0, v_max=30.0))
    return driver.output(0.0, driver.init((len(s),)), driver.D(s)).v


def test_a_circle_is_driven_at_the_comfortable_acceleration() -> None:
    assert careful(circle(20.0), np.array([0.0, 33.0, 100.0])) == pytest.approx(np.sqrt(3.0 * 20.0), rel=1e-3)


def test_braking_and_speeding_up_take_all_of_what_they_may() -> None:
    """Straights that are long enough for both: on the way there v^2 changes by 2*1.5 m/s^2 a metre, and not more."""
    path = course("paper")
    s = np.linspace(0.0, path.length, 8001)
    v = careful(path, s)
    assert (v**2 * np.abs(path.kappa(s))).max() < 3.1
    assert v.min() == pytest.approx(np.sqrt(3.0 / np.abs(path.samples.kappa).max()), rel=0.02)
    slope = np.diff(v**2) / np.diff(s)
    for steepest in (slope.max(), -slope.min()):  # v is linear between the metres, so v^2 nearly is
        assert steepest == pytest.approx(2.0 * 1.5, rel=0.03)


@pytest.mark.parametrize("start", [50.0, 190.0, 333.0, 610.0])
def test_where_a_closed_course_begins_does_not_matter(start: float) -> None:
    path = course("paper")
    s = np.linspace(0.0, path.length, 400, endpoint=False)
    turned = Path.from_waypoints(path.point(start + np.arange(0.0, path.length, 0.5)), closed=True, spacing=path.h)
    np.testing.assert_allclose(careful(turned, (s - start) % path.length), careful(path, s), atol=0.15)


ANGLES = (0.0, 0.1, 0.4, -0.2, -0.3)
SPEEDS = (4.0, 5.0, 5.5, 5.0, 6.0)


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.013, -0.007])
def test_it_is_the_record_between_its_samples_and_holds_its_ends(delay: float) -> None:
    drive = Playback(angles=ANGLES, speeds=SPEEDS, delay=delay, dt=0.01)
    at = 0.01 * np.arange(len(ANGLES))
    for t in np.arange(-3.0, 10.0, 0.25) * 0.01:
        y = drive.output(float(t), (), ())
        assert y.delta_sw == pytest.approx(np.interp(t - delay, at, ANGLES), abs=1e-6)
        assert y.v == pytest.approx(np.interp(t, at, SPEEDS), abs=1e-6)
