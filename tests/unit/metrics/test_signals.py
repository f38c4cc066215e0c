"""Every metric on a signal whose metric is known: sines, ramps, steps, and the standards' own tables."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit import metrics
from steerkit.diagram.units import radians_of
from tests.support.sines import T, sine


def test_the_magnitude_of_95_percent() -> None:
    assert metrics.magnitude_at(np.arange(-100, 1), 0.95) == pytest.approx(95.0)
    assert metrics.magnitude_at([1.0, -3.0], 0.5) == pytest.approx(2.0)
    # a sine is below sin(90 deg * 0.95) for 95 % of the time
    assert metrics.magnitude_at(sine(0.2)[:-1]) == pytest.approx(math.sin(math.pi / 2.0 * 0.95), abs=2e-3)
    assert math.isnan(metrics.magnitude_at([0.0, math.nan]))
    assert [metrics.magnitude_at([1.0, -3.0, 2.0], share) for share in (0.0, 1.0)] == [1.0, 3.0]
    for share in (-0.01, 1.01):
        with pytest.raises(ValueError, match=rf"share {share:g} \[1\], expected 0 to 1"):
            metrics.magnitude_at([1.0], share)


def test_the_cost_of_a_target_of_lateral_acceleration() -> None:
    """A sine against a share of itself; a ramp against zero, whose jerk is its slope; nothing for the target itself."""
    wave = sine(0.2)[:-1]
    cost = metrics.lateral_cost(T[:-1], wave, 0.4 * wave)
    assert cost["lataccel_cost"] == pytest.approx(100.0 * 0.36 / 2.0, rel=1e-6)
    assert cost["jerk_cost"] == pytest.approx(100.0 * (0.4 * math.pi) ** 2 / 2.0, rel=1e-2)
    assert cost["total_cost"] == pytest.approx(50.0 * cost["lataccel_cost"] + cost["jerk_cost"])
    assert metrics.lateral_cost([0.0, 0.1, 0.2], [0.0, 0.3, 0.6], [0.0] * 3) == pytest.approx(
        {"lataccel_cost": 15.0, "jerk_cost": 900.0, "total_cost": 1650.0}
    )
    assert metrics.lateral_cost([0.0, 0.1], [0.7, 0.7], [0.7, 0.7])["total_cost"] == 0.0
    assert math.isnan(metrics.lateral_cost([0.0, 0.1], [0.7, math.nan], [0.7, 0.7])["total_cost"])
    with pytest.raises(ValueError, match="lateral_cost: signal of shape"):
        metrics.lateral_cost([0.0, 0.1], 0.7, [0.7, 0.7])


def test_the_time_over_a_bound_counts_a_nan_as_over() -> None:
    t = np.arange(5) * 0.1
    assert metrics.time_over(t, [0.5, -0.51, 0.6, math.nan, 0.0], 0.5) == pytest.approx(0.3)
    # a sine is above half its amplitude, either way, for two thirds of the time
    assert metrics.time_over(T[:-1], sine(0.2)[:-1], 0.5) == pytest.approx(100.0 * 2.0 / 3.0, abs=1.0)


def test_the_acceleration_of_a_parabola() -> None:
    np.testing.assert_allclose(metrics.accelerations(T, 1.5 * T**2 - 4.0 * T), 3.0, rtol=1e-6)
    with pytest.raises(ValueError, match="2 samples, expected at least 3"):
        metrics.accelerations([0.0, 0.1], [1.0, 2.0])


def test_share_within_counts_samples_inside_and_not_on_the_bound() -> None:
    assert metrics.share_within([0.0, 0.049, -0.049, 0.05, -0.2, math.nan, 1.0, 0.01], 0.05) == 0.5
    # a sine is within half its amplitude for a third of the time
    assert metrics.share_within(0.1 * sine(0.2)[:-1], 0.05) == pytest.approx(1.0 / 3.0, abs=0.01)


@pytest.mark.parametrize("dt", [0.05, 0.01, 0.25])
def test_jerk_is_the_moving_average_of_the_derivative(dt: float) -> None:
    t = np.arange(round(20.0 / dt)) * dt
    a_y = np.sin(1.3 * t) + 0.3 * np.cos(4.0 * t)
    n = round(0.5 / dt)
    expected = np.convolve(np.diff(a_y) / dt, np.full(n, 1.0 / n), mode="valid")
    np.testing.assert_allclose(metrics.lateral_jerk(t, a_y), expected, atol=1e-12)


@pytest.mark.parametrize("frequency", [0.1, 0.2, 0.3])
def test_a_sine_reverses_twice_a_period(frequency: float) -> None:
    """12 a minute at 0.1 Hz; the low-pass at 0.6 Hz, passed twice, leaves 1/(1 + (f/0.6)^4) of the amplitude."""
    for amplitude, counted in ((1.49, False), (1.51, True)):
        gain = 1.0 / (1.0 + (math.tan(math.pi * frequency * 0.05) / math.tan(math.pi * 0.6 * 0.05)) ** 4)
        angle = radians_of(sine(frequency, amplitude=amplitude / gain))
        rate = metrics.reversal_rate(T, angle)
        assert rate == pytest.approx(120.0 * frequency if counted else 0.0, abs=1.3)


def test_reversals_are_counted_at_the_gap_and_not_below() -> None:
    """A slow wave of 4 deg, 3 a minute, with a wiggle of 0.8 deg, 24 a minute: which of them counts is the gap's."""
    angle = 2.0 * np.cos(2.0 * np.pi * 0.05 * T) + 0.4 * np.sin(2.0 * np.pi * 0.4 * T)
    assert metrics.reversal_rate(T, radians_of(angle)) == pytest.approx(60.0 * 10.0 / 100.0, abs=0.7)
    assert metrics.reversal_rate(T, radians_of(angle), gap_deg=0.1, cutoff=2.0) == pytest.approx(48.0, abs=1.0)


def test_what_the_filter_removes_is_no_reversal_and_a_nan_is_no_number() -> None:
    assert metrics.reversal_rate(T, radians_of(sine(5.0, amplitude=20.0))) == 0.0
    assert metrics.reversal_rate(T, 0.2 * T) == metrics.reversal_rate(T[:11], T[:11]) == 0.0
    assert metrics.reversal_rate(T, np.full(2001, 0.3)) == 0.0
    assert math.isnan(metrics.reversal_rate(T, np.where(T > 99.0, math.nan, 0.0)))


@pytest.mark.parametrize(
    ("t", "options"), [(T[:10], {}), (T, {"cutoff": 10.0}), (T, {"cutoff": 0.0}), (T, {"gap_deg": 0.0})]
)
def test_reversals_refuse_what_they_cannot_count(t: Any, options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"reversal_rate: .* expected more than 10 samples, 0 < cutoff < 0.5/dt"):
        metrics.reversal_rate(t, np.zeros(len(t)), **options)


@pytest.mark.parametrize("times", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_wheel_that_jumps_there_and_back_is_counted_each_way(times: int, side: float) -> None:
    """Jumps of 20 degrees, 10 s apart, each the other way than the one before."""
    jumps = np.minimum(np.floor((T + 5.0) / 10.0), times)
    angle = radians_of(side * 20.0 * (jumps % 2))
    counted = metrics.reversal_rate(T, angle) * (T[-1] - T[0]) / 60.0
    assert counted == pytest.approx(times)
