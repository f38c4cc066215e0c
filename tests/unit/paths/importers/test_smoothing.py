"""The calmest curve within the noise."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.paths.importers.smoothing import smoothed


def ring(radius: float, step: float, noise: float, seed: int) -> np.ndarray:
    angle = np.arange(0.0, 2.0 * np.pi, step / radius)
    xy = radius * np.column_stack((np.cos(angle), np.sin(angle))) + 1e4
    return xy + noise * np.random.default_rng(seed).normal(size=xy.shape)


@pytest.mark.parametrize("noise", [0.05, 0.3, 1.0])
def test_a_noisy_circle_is_one_again(noise: float) -> None:
    """Within the noise of a few points' mean, and with the noise that was stated left over."""
    points = ring(60.0, 1.0, noise, 3)
    curve, end, u, shown = smoothed(points, noise, closed=True)
    there = curve(np.linspace(0.0, end, 400))
    radii = np.hypot(*(there - 1e4).T)
    assert np.sqrt(np.mean((radii - 60.0) ** 2)) < 0.5 * noise
    assert shown == pytest.approx(noise * (1.0 + 2.0 * (2.0 / len(points)) ** 0.5) ** 0.5, rel=0.01)
    beside = np.hypot(*(points - 1e4).T) - np.hypot(*(curve(u) - 1e4).T)
    assert np.sqrt(np.mean(beside**2)) == pytest.approx(shown, rel=0.05), "less by what the curve takes"


def test_an_exact_straight_stays_one_however_stiff_the_curve() -> None:
    x = np.linspace(0.0, 2000.0, 4001)
    points = np.column_stack((x, 0.3 * x + 1000.0))
    curve, end, _, shown = smoothed(points, 1.0, closed=False)
    there = curve(np.linspace(0.0, end, 500))
    assert np.abs(there[:, 1] - 0.3 * there[:, 0] - 1000.0).max() < 1e-6
    assert shown < 1e-6


def test_more_noise_is_a_calmer_curve() -> None:
    points = ring(40.0, 2.0, 0.3, 5)
    rates = []
    for noise in (0.05, 0.15, 0.3):
        curve, end, _, _ = smoothed(points, noise, closed=True)
        rates.append(float(np.mean(curve(np.linspace(0.0, end, 500), 3) ** 2)))
    assert rates[0] > 3.0 * rates[1] > 3.0 * rates[2]


def test_a_closed_curve_closes_with_its_derivatives() -> None:
    curve, end, _, _ = smoothed(ring(30.0, 3.0, 0.2, 1), 0.2, closed=True)
    for order in range(4):
        assert curve(0.0, order) == pytest.approx(curve(end * (1.0 - 1e-13), order), abs=1e-6)


def test_noise_has_to_be_stated() -> None:
    with pytest.raises(ValueError, match=r"noise = 0.0 \[m\], expected > 0"):
        smoothed(ring(30.0, 3.0, 0.0, 1), 0.0, closed=True)
