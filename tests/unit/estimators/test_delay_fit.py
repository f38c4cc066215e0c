"""Dead time from records: the least squares of each, and dead time and lag of a motor from a log of its wheel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.estimators.delay_fit import fit_delay_lag, fits_by_delay
from steerkit.plants.steering_actuator import SteeringActuator


@settings(max_examples=25)
@given(delay=st.integers(0, 30), lag=st.floats(0.03, 0.3), gain=st.floats(0.8, 1.2), offset=st.floats(-0.1, 0.1))
def test_delay_and_lag_are_read_from_a_log(delay: int, lag: float, gain: float, offset: float) -> None:
    """Any delay, also between samples, whatever ratio and offset the wheel has: exact without noise."""
    motor = SteeringActuator(delay=0.01 * delay, lag=lag, gain=gain, offset=offset, rate_limit=100.0)
    rng, x = np.random.default_rng(0), motor.init()
    commands, wheel = [], []
    for k in range(1500):
        if k % 5 == 0:
            commands.append(float(rng.normal()) * 0.3)
            wheel.append(x[0])
        x = motor.update(0.0, x, motor.U(commands[-1]), None)
    found = fit_delay_lag(0.05 * np.arange(len(commands)), np.array(commands), np.array(wheel))
    assert found.delay == pytest.approx(0.01 * delay, abs=1e-6)
    assert found.lag == pytest.approx(lag, abs=1e-6)
    noisy = fit_delay_lag(
        0.05 * np.arange(len(commands)), np.array(commands), np.array(wheel) + rng.normal(0.0, 0.003, len(wheel))
    )
    assert noisy.delay == pytest.approx(0.01 * delay, abs=0.02)
    assert noisy.lag == pytest.approx(lag, abs=0.05)


def test_each_delay_is_fitted_on_the_same_rows_and_the_right_one_explains_all() -> None:
    rng, response = np.random.default_rng(1), np.zeros(200)
    command = rng.normal(size=200)
    for k in range(6, 199):
        response[k + 1] = 0.8 * response[k] + 0.3 * command[k - 4] + 0.1 * command[k - 5] - 0.02 * command[k - 6] + 0.05
    fits = fits_by_delay(response, command, np.arange(12, 199), range(9), taps=3)
    assert int(np.argmin([fit.rms for fit in fits])) == 4
    assert fits[4].rms < 1e-12
    assert (fits[4].keep, *fits[4].gains) == pytest.approx((0.8, 0.3, 0.1, -0.02))
    assert min(fit.rms for fit in fits if fit is not fits[4]) > 0.01


T = 0.05 * np.arange(200)


@pytest.mark.parametrize(
    ("t", "command", "wheel", "message"),
    [
        (T, 0.0 * T, 0.0 * T, "was not moved"),
        (T**2, np.sin(T), np.sin(T), "even steps"),
        (T, np.sin(T), np.sin(T) * np.nan, "NaN"),
        (T[:20], np.sin(T)[:20], np.sin(T)[:20], "expected more than"),
        (T, np.sin(T), -np.sin(T), "no delay up to 0.5 s explains the wheel"),
        (T, np.sin(T)[:-1], np.sin(T), "different shapes"),
    ],
)
def test_a_log_that_does_not_determine_them_is_refused(
    t: np.ndarray, command: np.ndarray, wheel: np.ndarray, message: str
) -> None:
    with pytest.raises(ValueError, match=f"fit_delay_lag: .*{message}"):
        fit_delay_lag(t, command, wheel)
