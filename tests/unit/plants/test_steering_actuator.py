"""The steering actuator: lag, delay, rate limit and stops are exact."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.diagram.units import radians_of
from steerkit.plants.steering_actuator import SteeringActuator, steering_of
from steerkit.vehicles import VW_PASSAT
from steerkit.vehicles.file import vehicle_text
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


@pytest.mark.parametrize("offset", [-0.3, 0.0, 0.3])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_stop_is_where_it_is_whatever_the_motor_thinks(side: float, offset: float) -> None:
    motor = SteeringActuator(offset=offset, gain=1.2)
    x = motor.init()
    for k in range(300):
        x = motor.update(0.01 * k, x, motor.U(99.0 * side), ())
    assert motor.output(0.0, x, ()).delta_sw == pytest.approx(radians_of(520.0) * side, rel=1e-9)


@pytest.mark.parametrize(
    ("delay", "lag", "samples", "rest"),
    [(0.037, 0.08, 2, 0.087), (0.06, 0.1, 5, 0.1), (0.0, 0.1, 0, 0.09), (0.004, 0.1, 0, 0.094), (0.0, 0.005, 0, 0.0)],
)
def test_a_files_delay_and_lag_keep_their_sum_less_a_sample(
    delay: float, lag: float, samples: int, rest: float, tmp_path: Path
) -> None:
    """Holding the angle for dt delays by dt/2, in the motor and in the car: 10 ms less for the motor."""
    file = tmp_path / "car.toml"
    file.write_text(f"{vehicle_text(VW_PASSAT)}\n[steering]\ndelay = {delay}\nlag = {lag}\noffset = 0.02\n")
    motor = steering_of(file)
    assert motor.delay == pytest.approx(0.01 * samples)
    assert motor.lag == pytest.approx(rest)
    assert motor.offset == 0.02
