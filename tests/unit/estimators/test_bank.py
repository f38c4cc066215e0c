"""The bank's regressions are those of batch least squares, and its lowest point that of a parabola."""

import numpy as np
import pytest

from steerkit.estimators.bank import MOMENTS, Sums, fitted, lowest, rls_update
from steerkit.estimators.steering_delay import WheelDelay


def test_recursive_moments_with_forgetting_are_the_weighted_ones() -> None:
    rng = np.random.default_rng(1)
    x, y, weight = rng.normal(size=(50, 3)) + 3.0, rng.normal(size=50) - 2.0, rng.uniform(0.5, 2.0, 50)
    precision, prior, keep = (0.3, 0.7, 2.0), (1.0, 0.0, -0.5), 0.95
    moments: tuple[float, ...] = (0.0,) * MOMENTS
    total, mean = 0.0, 0.0
    for row, value, w in zip(x.tolist(), y.tolist(), weight.tolist()):
        total = keep * total + w
        gain = w / total
        moments = rls_update(moments, row, value - mean, keep, gain, w)
        mean += gain * (value - mean)
    fit = fitted(moments, precision, prior)

    w = weight * keep ** np.arange(49, -1, -1)
    xc, yc = x - np.average(x, axis=0, weights=w), y - np.average(y, weights=w)
    normal = (xc * w[:, None]).T @ xc + np.diag(precision)
    theta = np.linalg.solve(normal, (xc * w[:, None]).T @ yc + np.multiply(precision, prior))
    left = np.sum(w * (yc - xc @ theta) ** 2) + np.sum(precision * (theta - prior) ** 2)
    np.testing.assert_allclose(fit.coefficients, theta, rtol=1e-9)
    assert np.sum(w * yc**2) - fit.saved == pytest.approx(left)
    assert fit.last_variance == pytest.approx(np.linalg.inv(normal)[2, 2])


@pytest.mark.parametrize("place", [0.0, 0.4, 2.5, 3.3, 4.7, 5.0])
def test_the_lowest_point_of_a_parabola_is_found_exactly(place: float) -> None:
    found, variance, _ = lowest([1.0 + 3.0 * (i - place) ** 2 for i in range(6)], 1e-9)
    assert found == pytest.approx(place)
    assert variance == pytest.approx(1.0 / 3.0)  # exp(-cost/2) is normal with this variance


def test_the_lowest_of_several_valleys_is_taken_and_nothing_outside_the_bank() -> None:
    assert lowest([5.0, 1.0, 5.0, 5.0, 0.5, 5.0], 0.1)[2] == 4.0
    assert lowest([3.0, 2.0, 1.0, 0.0], 0.1)[0] == 3.0
    assert lowest([0.0, 1.0, 2.0, 3.0], 0.1)[0] == 0.0
    assert lowest([1.0, 1.0, 1.0], 0.5)[1] == pytest.approx(4.0)


def test_sums_are_weighted_and_forget_and_samples_that_are_not_used_change_nothing() -> None:
    block = WheelDelay(longest=0.1, prior_delay=0.1, memory=2.0)
    rng = np.random.default_rng(2)
    sums, moments = Sums(0.0, 0.0, 0.0, 0.0), [0.0] * (3 * MOMENTS)
    ys, keep, share = rng.normal(size=30), np.exp(-0.05 / 2.0), 0.05 / 0.15
    for y in ys.tolist():
        rows = rng.normal(size=(3, 3)).tolist()
        sums, moments = block._summed(sums, moments, rows, (y, 1.3), True)
        assert block._summed(sums, moments, rows, (float("nan"), 1.3), False) == (sums, moments)
    weights = keep ** np.arange(29, -1, -1)
    assert sums.total == pytest.approx(1.3 * share * weights.sum())
    assert sums.count == pytest.approx(share * weights.sum())
    assert sums.mean == pytest.approx(np.average(ys, weights=weights))
    assert sums.power == pytest.approx(1.3 * share * np.sum(weights * (ys - sums.mean) ** 2))
