"""Lag, scale and offset between two sensors of one motion."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.logs.reading import agreement


def motion(t: np.ndarray) -> np.ndarray:
    return np.sin(0.7 * t) + 0.5 * np.sin(2.3 * t + 1.0) + 0.2 * np.sin(5.1 * t)


@pytest.mark.parametrize("lag", [-0.31, -0.028, 0.0, 0.1234, 0.45])
def test_a_late_sensor_of_another_size_rate_and_zero_is_found_out(lag: float) -> None:
    rng = np.random.default_rng(0)
    t, other = np.arange(0.0, 60.0, 0.0112), np.sort(rng.uniform(-1.0, 61.0, 6000))
    late = -0.9 * motion(other - lag) + 0.05
    found = agreement(t, motion(t) + 0.02 * rng.normal(size=len(t)), other, late + 0.02 * rng.normal(size=len(other)))
    assert found.lag == pytest.approx(lag, abs=0.004)
    assert found.scale == pytest.approx(-0.9, abs=0.01)
    assert found.offset == pytest.approx(0.05, abs=0.01)
    assert found.correlation < -0.99
    assert lag == 0.0 or ("late" if lag > 0.0 else "early") in str(found)


def test_what_has_nothing_to_do_with_it_is_said_so_and_too_little_teaches() -> None:
    t = np.arange(0.0, 60.0, 0.01)
    other = np.random.default_rng(1).normal(size=len(t))
    assert abs(agreement(t, motion(t), t, other).correlation) < 0.3
    assert agreement(t, motion(t), t, np.zeros(len(t))).scale == 0.0
    with pytest.raises(ValueError, match=r"0\.0 s in common, expected 5 or more"):
        agreement(t, motion(t), t + 100.0, motion(t))
