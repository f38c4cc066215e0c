"""The human sets the speed: statistics, seeds, recorded speeds, profiles over the path."""

import math
from dataclasses import replace

import casadi
import numpy as np
import pytest

from steerkit.diagram.maths import Table
from steerkit.plants.speed_driver import ConstantSpeed, RecordedSpeed, SpeedDriver, SpeedProfile
from tests.support.stepped import run


def speeds(driver, steps, batch=()):
    x, v = driver.init(batch), []
    for k in range(steps):
        y = driver.output(k * driver.dt, x, driver.D())
        x = driver.update(k * driver.dt, x, driver.U(), y)
        v.append(y.v)
    return np.array(v)


def test_human_wanders_smoothly_over_the_whole_range():
    driver = SpeedDriver(seed=1)
    v = speeds(driver, 1200, (64,))
    assert 4.0 < v.min() < 4.2
    assert 7.3 < v.max() < 7.5
    assert v.mean() == pytest.approx(5.75, abs=0.1)
    pace = np.diff(v, axis=0) / driver.dt
    assert 0.1 < pace.std() < 0.4
    assert np.abs(pace).max() < 2.5
    assert np.abs(np.diff(pace, axis=0)).max() < 0.5  # the pace itself does not jump


def test_human_is_stationary_from_the_start():
    x = SpeedDriver(seed=9).init((20_000,))
    z, g = np.array(x[:2])
    moments = [np.cov(z, g)]
    driver = SpeedDriver(seed=9)
    for _ in range(100):
        x = driver.update(0.0, x, None, None)
    moments.append(np.cov(np.array(x[:2])))
    assert moments[0] == pytest.approx(moments[1], abs=0.04)
    assert moments[0][0, 0] == pytest.approx(1.0, abs=0.03)


def test_human_of_a_batch_is_the_single_ones():
    batch = speeds(SpeedDriver(seed=5), 100, (3,))
    for i in range(3):
        assert batch[:, i] == pytest.approx(speeds(SpeedDriver(seed=5 + i), 100), rel=1e-12)
    assert not np.allclose(batch[:, 0], batch[:, 1])


def test_constant_speed():
    assert speeds(ConstantSpeed(speed=6.5), 3).tolist() == [6.5] * 3
    assert speeds(ConstantSpeed(speed=np.array([4.0, 5.0])), 2, (2,)).tolist() == [[4.0, 5.0]] * 2


def test_recorded_human():
    driver = RecordedSpeed(speeds=(4.0, 6.0, 5.0), spacing=0.1)
    assert speeds(driver, 7) == pytest.approx([4.0, 5.0, 6.0, 5.5, 5.0, 5.0, 5.0])
    again = replace(driver, repeat=True, start=0.1)
    assert speeds(again, 4) == pytest.approx([6.0, 5.5, 4.0, 5.0])
    assert speeds(replace(driver, start=np.array([-1.0, 0.05])), 2, (2,)) == pytest.approx(np.array([[4, 5], [4, 6]]))


def test_speed_profile_over_progress():
    profile = SpeedProfile.from_samples([10.0, 20.0, 50.0], [4.0, 5.0, 8.0], spacing=5.0)
    assert profile.speeds == pytest.approx((4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 7.5, 8.0))
    ask = [(-5.0,), (0.0,), (7.5,), (40.0,), (99.0,), (math.nan,)]
    found = [y.v for y in run(profile, ask)[0]]
    assert found == pytest.approx([4.0, 4.0, 4.75, 8.0, 8.0, math.nan], nan_ok=True)
    rounds = SpeedProfile(speeds=(4.0, 6.0, 4.0), spacing=10.0, repeat=True)
    assert rounds.output(0.0, (), rounds.D(np.array([45.0, -5.0]))).v == pytest.approx([5.0, 5.0])


def test_speed_profile_is_traced_through_a_table(monkeypatch):
    profile = SpeedProfile(speeds=(4.0, 6.0, 5.0), spacing=10.0)
    monkeypatch.setattr(
        Table,
        "tracer",
        lambda table, i: casadi.vertsplit(casadi.SX(table.rows[0]) * (i < 1) + table.rows[1] * (i >= 1)),
    )
    p = casadi.SX.sym("p")
    traced = casadi.Function("v", [p], [profile.output(0.0, (), profile.D(p)).v])
    for at in (-3.0, 2.0, 10.0, 19.0, 30.0):
        assert float(traced(at)) == pytest.approx(profile.output(0.0, (), profile.D(at)).v, rel=1e-14)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: SpeedDriver(v_min=8.0, v_max=7.0),
            r"SpeedDriver: v_max = 7.0 \[m/s\], expected 8 to 60; at least v_min",
        ),
        (lambda: SpeedDriver(foot_time=0.01), r"foot_time = 0.01 \[s\]"),
        (lambda: SpeedDriver(seed=-1), "seed = -1, expected a whole number"),
        (lambda: ConstantSpeed(speed=-5.0), r"speed = -5.0 \[m/s\]"),
        (lambda: RecordedSpeed(speeds=(4.0,), spacing=1.0), "two numbers or more"),
        (lambda: RecordedSpeed(speeds=(4.0, math.nan), spacing=1.0), r"speeds = .* \[m/s\]"),
        (lambda: SpeedProfile(speeds=(4.0, 5.0), spacing=0.0), "SpeedProfile: spacing = 0.0"),
        (lambda: SpeedProfile.from_samples([0.0, 0.0], [4.0, 5.0]), "at rising strictly"),
    ],
)
def test_teaching_errors_of_humans(make, message):
    with pytest.raises(ValueError, match=message):
        make()
