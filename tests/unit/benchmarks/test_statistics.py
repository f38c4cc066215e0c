"""Intervals and paired tests on samples whose answers are known."""

import math

import numpy as np
import pytest

from benchmarks.statistics import interval, paired, share

NEVER = math.inf


def test_the_interval_of_the_mean_is_that_of_the_normal_distribution_for_many() -> None:
    values = np.random.default_rng(0).normal(3.0, 2.0, size=400)
    found = interval(values)
    half = 1.96 * values.std() / math.sqrt(400)
    assert found.value == pytest.approx(values.mean())
    assert (found.low, found.high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.02)
    assert found.n == 400
    assert interval(values) == found, "the resampling is seeded"


def test_never_is_kept_and_an_interval_may_reach_it() -> None:
    found = interval([1.0, 2.0, 3.0, 4.0, NEVER], np.median)
    assert found.value == 3.0
    assert 1.0 <= found.low < 3.0
    assert found.high == NEVER
    assert interval([NEVER, NEVER, 1.0], np.median).value == NEVER
    assert interval([NEVER] * 4, np.median).low == NEVER


def test_one_value_or_equal_values_have_an_interval_of_no_width() -> None:
    assert interval([2.5]).low == interval([2.5]).high == 2.5
    assert interval([2.0] * 5, np.median).high == 2.0


def test_the_share_of_all_is_no_certainty() -> None:
    """Wilson: 10 of 10 is at least 10/(10 + 1.96^2)."""
    found = share([True] * 10)
    assert (found.value, found.high) == (1.0, 1.0)
    assert found.low == pytest.approx(10.0 / (10.0 + 1.959964**2), abs=1e-6)
    assert share([True, False]).value == 0.5


def test_a_constant_difference_is_as_significant_as_its_number_of_seeds() -> None:
    """All n differences of one sign: 2 of the 2^n sign flips are as extreme."""
    b = np.random.default_rng(2).normal(size=8)
    found = paired(b - 0.5, b)
    assert found.difference.value == pytest.approx(-0.5)
    assert found.p == pytest.approx(2.0 / 2**8)
    assert paired(b, b).p == 1.0


@pytest.mark.parametrize(("a", "b"), [([1.0], [1.0]), ([1.0, 2.0], [1.0]), ([1.0, NEVER], [1.0, 2.0])])
def test_what_cannot_be_paired_is_refused(a: list[float], b: list[float]) -> None:
    with pytest.raises(ValueError, match=r"paired: shapes .* all finite: leave out seeds"):
        paired(a, b)


def test_no_seeds_or_a_nan_are_refused() -> None:
    with pytest.raises(ValueError, match="one a seed, none NaN"):
        interval([])
    with pytest.raises(ValueError, match="one a seed, none NaN"):
        interval([1.0, math.nan])
    with pytest.raises(ValueError, match=r"share: successes of shape \(0,\)"):
        share([])
