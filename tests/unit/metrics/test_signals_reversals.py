"""What the wheel does: reversals are counted as ISO's procedure says."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit import metrics
from steerkit.diagram.units import radians_of
from tests.support.sines import T, sine


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
