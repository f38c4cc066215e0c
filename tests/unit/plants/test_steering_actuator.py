"""The steering actuator: lag, delay, rate limit and stops are exact."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.units import radians_of
from tests.support.stepped import run


def test_first_order_lag_is_exact():
    actuator = SteeringActuator(lag=0.13, rate_limit=200.0)
    ys, _ = run(actuator, [(1.0,)] * 60)
    exact = 1.0 - np.exp(-np.arange(60) * actuator.dt / 0.13)
    assert [y.delta_sw for y in ys] == pytest.approx(exact, abs=1e-14)
    assert ys[-1].rate == pytest.approx((exact[-1] - exact[-2]) / actuator.dt, rel=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.13])
def test_delay_is_exact(delay):
    commands = np.random.default_rng(0).normal(0.0, 0.3, 50).tolist()
    ys, x = run(SteeringActuator(lag=0.0, delay=delay, rate_limit=200.0), [(c,) for c in commands])
    n = round(delay / 0.01) + 1  # one sample more: a command acts from its sample to the next
    assert [y.delta_sw for y in ys] == pytest.approx([0.0] * n + commands[: 50 - n], abs=1e-12)
    assert len(x) == 2 + n - 1


def test_rate_limit_and_stops_are_exact():
    actuator = SteeringActuator(lag=0.0)
    ys, _ = run(actuator, [(99.0,)] * 120)
    ramp = np.minimum(radians_of(550.0) * 0.01 * np.arange(120), radians_of(520.0))
    assert [y.delta_sw for y in ys] == pytest.approx(ramp, rel=1e-12)
    assert max(y.rate for y in ys) == pytest.approx(radians_of(550.0), rel=1e-12)


@given(commands=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60), lag=st.floats(0.0, 1.0))
def test_limits_hold_whatever_is_commanded(commands, lag):
    ys, _ = run(SteeringActuator(lag=lag, delay=0.02, gain=1.2, offset=-0.3), [(c,) for c in commands])
    assert all(abs(y.delta_sw) <= radians_of(520.0) * (1.0 + 1e-12) for y in ys)
    assert all(abs(y.rate) <= radians_of(550.0) * (1.0 + 1e-12) for y in ys)


def test_ratio_error():
    ys, _ = run(SteeringActuator(gain=1.1, offset=0.2), [(1.0,)] * 300)
    assert ys[-1].delta_sw == pytest.approx(1.3, rel=1e-9)


def test_nan_command_arrives_and_stays():
    ys, _ = run(SteeringActuator(delay=0.02), [(0.0,), (math.nan,), (0.0,), (0.0,), (0.0,), (0.0,)])
    assert [math.isnan(y.delta_sw) for y in ys] == [False] * 4 + [True] * 2


def test_batch_of_different_actuators():
    batch = SteeringActuator(lag=np.array([0.0, 0.1]), offset=np.array([0.0, 0.05]), delay=0.01)
    y = run(batch, [(np.array([1.0, 1.0]),)] * 20, batch.init((2,)))[0][-1]
    alone = [SteeringActuator(lag=lag, offset=offset, delay=0.01) for lag, offset in ((0.0, 0.0), (0.1, 0.05))]
    expected = [run(a, [(1.0,)] * 20)[0][-1].delta_sw for a in alone]
    assert y.delta_sw == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            dict(delay=0.025),
            r"delay = 0.025 \[s\], expected a multiple of dt = 0.01 s; valid: 0.02 or 0.03, or a finer",
        ),
        (dict(delay=-0.01), r"delay = -0.01 \[s\]"),
        (dict(delay=np.array([0.01, 0.02])), "delay .* expected one number for all cars"),
        (dict(limit=520.0), r"limit = 520.0 \[rad\].*radians_of\(520\)"),
        (dict(rate_limit=550.0), r"rate_limit = 550.0 \[rad/s\].*radians_of\(550\)"),
        (dict(lag=-0.1), r"lag = -0.1 \[s\]"),
        (dict(gain=0.0), "gain = 0.0"),
    ],
)
def test_teaching_errors_of_actuator(change, message):
    with pytest.raises(ValueError, match=f"SteeringActuator: {message}"):
        SteeringActuator(**change)
