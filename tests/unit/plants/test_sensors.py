"""Sensors: latency, bias, noise and drift have the stated sizes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.plants.sensors import Sensors
from steerkit.plants.speed_driver import SpeedDriver
from steerkit.vehicles import VW_PASSAT
from tests.support.stepped import run, run_fast

TRUTH = (10.0, -3.0, 0.4, 6.0, 0.02, 0.3)


@pytest.mark.parametrize("latency", [0.05, 0.15])
def test_latency_is_exact_and_starts_with_the_first_sample(latency):
    samples = [tuple(row) for row in np.random.default_rng(1).normal(size=(12, 6)).tolist()]
    ys, _ = run(Sensors(latency=latency), samples)
    n = round(latency / 0.05)
    assert [tuple(y)[:6] for y in ys] == [samples[0]] * n + samples[: 12 - n]
    assert {y.age for y in ys} == {latency}


def test_noise_and_drift_have_the_stated_statistics():
    n, steps = 4000, 41
    sensors = Sensors(
        position_noise=0.02,
        psi_noise=0.003,
        v_noise=0.05,
        beta_noise=0.004,
        r_noise=0.01,
        position_drift=0.03,
        psi_drift=0.002,
        drift_time=1.0,
        seed=11,
    )
    ys, _ = run(sensors, [tuple(np.full(n, value) for value in TRUTH)] * steps, sensors.init((n,)))
    errors = np.array([np.array(y[:6]) - np.array(TRUTH)[:, None] for y in ys])  # (steps, channel, car)
    drift = np.array([0.03, 0.03, 0.002, 0.0, 0.0, 0.0])
    spread = np.hypot(drift, [0.02, 0.02, 0.003, 0.05, 0.004, 0.01])
    for k in (0, 20, 40):  # stationary from the first sample on
        assert errors[k].std(axis=1) == pytest.approx(spread, rel=0.05)
        assert np.abs(errors[k].mean(axis=1) / spread).max() < 4.5 / math.sqrt(n)
    together = (errors[0] * errors[20]).mean(axis=1) / spread**2  # 1 s apart: the drift alone, by exp(-1)
    assert together == pytest.approx((drift / spread) ** 2 * math.exp(-1.0), abs=0.06)
    across = np.corrcoef(errors[40]) - np.eye(6)
    assert np.abs(across).max() < 0.08


def test_sensors_and_driver_of_one_seed_are_unrelated():
    assert Sensors.hard(1).init()[9:15] != SpeedDriver(seed=1).init()[2:]


MANY = 20_000


def seen(sensors: Sensors, truth: np.ndarray) -> np.ndarray:
    """What is seen of x, y, psi, v, beta, r; a row a sample."""
    return stamped(sensors, truth)[:, :6]


def stamped(sensors: Sensors, truth: np.ndarray) -> np.ndarray:
    """The same with the age that its stamp says."""
    if len(truth) > 1000:
        return run_fast(sensors, truth)[0]
    return np.array(run(sensors, [tuple(row) for row in truth.tolist()])[0])


def standing(samples: int) -> np.ndarray:
    return np.tile([1.0, 2.0, 0.3, 5.0, 0.01, 0.2], (samples, 1))


def moving(samples: int, sensors: Sensors) -> np.ndarray:
    truth = standing(samples)
    truth[:, 0] = 10.0 * sensors.dt * np.arange(samples)
    return truth


def test_what_goes_wrong_leaves_the_noise_as_it_is() -> None:
    """It has random numbers of its own."""
    hard, truth = Sensors.hard(seed=4), np.random.default_rng(0).normal(size=(50, 6))
    plain, worse = stamped(hard, truth), stamped(replace(hard, jump=0.1, jump_time=0.1), truth)
    assert (worse[:, 2:] == plain[:, 2:]).all()
    assert (worse[:, :2] != plain[:, :2]).any(axis=1).all()


def test_age_is_uniform_up_to_the_jitter() -> None:
    sensors = Sensors(seed=4, age_jitter=0.03)
    truth = moving(MANY, sensors)
    age = (truth[:, 0] - seen(sensors, truth)[:, 0])[1:] / 10.0
    assert age.min() >= -1e-9
    assert age.max() <= 0.03 + 1e-9
    assert age.mean() == pytest.approx(0.015, rel=0.02)
    assert age.std() == pytest.approx(0.03 / np.sqrt(12.0), rel=0.02)
    assert abs(np.corrcoef(age[1:], age[:-1])[0, 1]) < 4.0 / np.sqrt(MANY)


def test_the_stamp_tells_the_age_of_what_is_seen() -> None:
    """Also of a sample that is held, as the next were lost, and of the latency."""
    sensors = Sensors(seed=4, latency=0.1, age_jitter=0.03, lost=0.3)
    truth = moving(2000, sensors)
    found = stamped(sensors, truth)[20:]
    assert found[:, 6] == pytest.approx((truth[20:, 0] - found[:, 0]) / 10.0, abs=1e-9)
    assert found[:, 6].max() > 0.2


def test_a_lost_sample_is_the_one_before_and_as_many_are_lost_as_said() -> None:
    sensors = Sensors(seed=4, lost=0.2)
    truth = np.cumsum(np.ones((MANY, 6)), axis=0)
    found = seen(sensors, truth)
    held = (found[1:] == found[:-1]).all(axis=1)
    assert held.mean() == pytest.approx(0.2, abs=4.0 * np.sqrt(0.16 / MANY))
    assert (found[1:][~held] == truth[1:][~held]).all()


def test_a_position_jumps_as_often_and_as_far_as_said() -> None:
    sensors = Sensors(seed=4, jump=0.1, jump_time=0.5)
    error = seen(sensors, standing(MANY))[:, :2] - (1.0, 2.0)
    jumps = np.diff(error[:, 0]) != 0.0
    assert (jumps == (np.diff(error[:, 1]) != 0.0)).all()
    assert jumps.mean() == pytest.approx(sensors.dt / 0.5, rel=0.1)
    offsets = error[1:][jumps]
    assert offsets.std(axis=0) == pytest.approx([0.1, 0.1], rel=0.1)
    assert abs(np.corrcoef(offsets.T)[0, 1]) < 0.1


def test_the_heading_wanders_slowly() -> None:
    sensors = Sensors(seed=4, heading_drift=radians_of(0.2), heading_time=2.0)
    error = seen(sensors, standing(2 * MANY))[:, 2] - 0.3
    assert error.std() == pytest.approx(radians_of(0.2), rel=0.1)
    lag = round(2.0 / sensors.dt)
    assert np.corrcoef(error[lag:], error[:-lag])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.08)
    others = seen(sensors, standing(100)) - standing(100)
    assert (others[:, [0, 1, 3, 4, 5]] == 0.0).all()


def test_sideslip_is_that_of_a_rear_axle_that_does_not_slide() -> None:
    """On a steady circle a car's own is less by the rear slip angle, m l_f v r/(c_r L)."""
    p, v, kappa = VW_PASSAT, 7.0, 0.05
    r = v * kappa
    slip = p.m * p.l_f * v * r / (p.c_r * p.wheelbase)
    truth = np.tile([0.0, 0.0, 0.0, v, p.l_r * kappa - slip, r], (3, 1))
    found = seen(Sensors(rear=p.l_r), truth)[:, 4]
    assert found - truth[:, 4] == pytest.approx([slip] * 3, rel=1e-12)
    assert slip > radians_of(0.4)  # worth knowing
    assert seen(Sensors(rear=p.l_r), truth * 0.0)[:, 4] == pytest.approx([0.0] * 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(latency=0.03), r"latency = 0.03 \[s\], expected a multiple of dt = 0.05 s; valid: 0.05 or 0, or a finer"),
        (dict(seed=0.5), "seed = 0.5"),
        (dict(age_jitter=0.06), "at most dt"),
    ],
)
def test_teaching_errors(change, message):
    with pytest.raises(ValueError, match=message):
        Sensors(**change)
