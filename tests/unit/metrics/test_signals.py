"""Every metric on a signal whose metric is known: sines, ramps, steps, and the standards' own tables."""

from __future__ import annotations

import math

import numpy as np
import pytest

from steerkit import metrics
from tests.support.sines import T, sine


def test_the_magnitude_of_95_percent() -> None:
    assert metrics.magnitude_at(np.arange(-100, 1), 0.95) == pytest.approx(95.0)
    assert metrics.magnitude_at([1.0, -3.0], 0.5) == pytest.approx(2.0)
    # a sine is below sin(90 deg * 0.95) for 95 % of the time
    assert metrics.magnitude_at(sine(0.2)[:-1]) == pytest.approx(math.sin(math.pi / 2.0 * 0.95), abs=2e-3)
    assert math.isnan(metrics.magnitude_at([0.0, math.nan]))
    with pytest.raises(ValueError, match=r"share 95 \[1\], expected 0 to 1"):
        metrics.magnitude_at([1.0], 95)


def test_the_time_over_a_bound_counts_a_nan_as_over() -> None:
    t = np.arange(5) * 0.1
    assert metrics.time_over(t, [0.5, -0.51, 0.6, math.nan, 0.0], 0.5) == pytest.approx(0.3)
    # a sine is above half its amplitude, either way, for two thirds of the time
    assert metrics.time_over(T[:-1], sine(0.2)[:-1], 0.5) == pytest.approx(100.0 * 2.0 / 3.0, abs=1.0)


def test_the_acceleration_of_a_parabola() -> None:
    np.testing.assert_allclose(metrics.accelerations(T, 1.5 * T**2 - 4.0 * T), 3.0, rtol=1e-6)
    with pytest.raises(ValueError, match="2 samples, expected at least 3"):
        metrics.accelerations([0.0, 0.1], [1.0, 2.0])


def test_step_times_are_quantiles_and_no_missing_measurement() -> None:
    assert metrics.step_times(np.arange(101) * 1e-6) == {
        "step_p50_us": pytest.approx(50.0),
        "step_p99_us": pytest.approx(99.0),
    }
    for bad in ([], [1e-6, math.nan], [-1e-6]):
        with pytest.raises(ValueError, match="of finite seconds >= 0"):
            metrics.step_times(bad)
