"""The bank's regressions are those of batch least squares, and its lowest point that of a parabola."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.estimators.bank import Weighed, at, fits, fitted, learned, lowest, rls_update, size


def test_recursive_moments_with_forgetting_are_the_weighted_ones() -> None:
    rng = np.random.default_rng(1)
    x, y, weight = rng.normal(size=(50, 3)) + 3.0, rng.normal(size=50) - 2.0, rng.uniform(0.5, 2.0, 50)
    precision, prior, keep = (0.3, 0.7, 2.0), (1.0, 0.0, -0.5), 0.95
    moments: tuple[float, ...] = (0.0,) * size(3)
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
    best = lowest([1.0 + 3.0 * (i - place) ** 2 for i in range(6)], 1e-9)
    assert best.place == pytest.approx(place)
    assert best.cost == pytest.approx(1.0)
    assert best.variance == pytest.approx(1.0 / 3.0)  # exp(-cost/2) is normal with this variance


def test_the_lowest_of_several_valleys_is_taken_and_nothing_outside_the_bank() -> None:
    assert lowest([5.0, 1.0, 5.0, 5.0, 0.5, 5.0], 0.1).number == 4.0
    assert lowest([3.0, 2.0, 1.0, 0.0], 0.1).place == 3.0
    assert lowest([0.0, 1.0, 2.0, 3.0], 0.1).place == 0.0
    assert lowest([1.0, 1.0, 1.0], 0.5).variance == pytest.approx(4.0)


def test_the_candidate_of_a_number() -> None:
    assert [at(float(i), [10.0, 20.0, 30.0]) for i in range(3)] == [10.0, 20.0, 30.0]


def test_one_cars_candidates_are_those_of_a_batch_of_one() -> None:
    """Floats take a shorter way."""
    for number in (-1.0, 0.5, 1.0, 1.5, 1.50001, 9.0, float("inf"), float("nan")):
        assert at(number, [10.0, 20.0, 30.0]) == at(np.array([number]), [10.0, 20.0, 30.0])
    rng = np.random.default_rng(2)
    one, many = [0.0] * (4 * size(3)), [np.zeros(1)] * (4 * size(3))
    sums, all_sums = Weighed(0.0, 0.0, 0.0, 0.0), Weighed(*[np.zeros(1)] * 4)
    for _ in range(20):
        rows, y, teaches = rng.normal(size=(4, 3)), float(rng.normal()), bool(rng.random() < 0.7)
        told = dict(weight=1.3, share=0.3, keep=0.9)
        sums, one = learned(sums, one, rows.tolist(), y, teaches=teaches, **told)
        given = [[np.array([value]) for value in row] for row in rows.tolist()]
        all_sums, many = learned(all_sums, many, given, np.array([y]), teaches=np.array([teaches]), **told)
    assert {*map(type, one)} == {float}
    assert one == [float(value[0]) for value in many]
    prior = (0.3, 0.7, 2.0), (1.0, 0.0, -0.5)
    for fit, other in zip(fits(one, *prior), fits(many, *prior), strict=True):
        assert list(fit.coefficients) == [float(value[0]) for value in other.coefficients]
        assert (fit.saved, fit.last_variance) == (float(other.saved[0]), float(other.last_variance[0]))
