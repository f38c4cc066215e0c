"""Sensors: latency, bias, noise and drift have the stated sizes."""

import math

import numpy as np
import pytest

from steerkit.plants.sensors import Sensors
from steerkit.plants.speed_driver import SpeedDriver
from tests.support.stepped import run

TRUTH = (10.0, -3.0, 0.4, 6.0, 0.02, 0.3)


def test_sensors_are_transparent_by_default():
    ys, _ = run(Sensors(), [TRUTH, TRUTH[::-1]])
    assert [tuple(y) for y in ys] == [(*TRUTH, 0.0), (*TRUTH[::-1], 0.0)]


@pytest.mark.parametrize("latency", [0.05, 0.15])
def test_latency_is_exact_and_starts_with_the_first_sample(latency):
    samples = [tuple(row) for row in np.random.default_rng(1).normal(size=(12, 6)).tolist()]
    ys, _ = run(Sensors(latency=latency), samples)
    n = round(latency / 0.05)
    assert [tuple(y)[:6] for y in ys] == [samples[0]] * n + samples[: 12 - n]
    assert {y.age for y in ys} == {latency}


def test_bias():
    y = run(Sensors(x_bias=0.1, y_bias=-0.2, psi_bias=0.01, v_bias=0.3, beta_bias=-0.01, r_bias=0.02), [TRUTH])[0][0]
    assert np.subtract(y[:6], TRUTH) == pytest.approx([0.1, -0.2, 0.01, 0.3, -0.01, 0.02], abs=1e-12)


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


def test_sensors_of_a_batch_are_the_single_ones():
    batch = Sensors.hard(3)
    ys, _ = run(batch, [tuple(np.full(2, value) for value in TRUTH)] * 20, batch.init((2,)))
    for i in range(2):
        alone = run(Sensors.hard(3 + i), [TRUTH] * 20)[0][-1]
        assert [y[i] for y in ys[-1][:6]] == pytest.approx(alone[:6], rel=1e-12)
        assert all(value.__class__ is float for value in alone)


def test_sensors_and_human_of_one_seed_are_unrelated():
    assert Sensors.hard(1).init()[9:15] != SpeedDriver(seed=1).init()[2:]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(latency=0.03), r"latency = 0.03 \[s\], expected a multiple of dt = 0.05 s; valid: 0.05 or 0, or a finer"),
        (dict(r_noise=-0.1), r"r_noise = -0.1 \[rad/s\].*a standard deviation"),
        (dict(psi_drift=5.7), r"psi_drift = 5.7 \[rad\]"),
        (dict(drift_time=0.0), r"drift_time = 0.0 \[s\], expected .*at least dt"),
        (dict(x_bias=math.nan), r"x_bias = nan \[m\]"),
        (dict(seed=0.5), "seed = 0.5"),
    ],
)
def test_teaching_errors_of_sensors(change, message):
    with pytest.raises(ValueError, match=message):
        Sensors(**change)
