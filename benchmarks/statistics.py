"""Figures over seeds: bootstrap intervals and paired tests between controllers that met the same seeds."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts load when they are first used
from numpy.typing import ArrayLike

from steerkit.diagram.maths import Array

RESAMPLES = 9999
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A figure over n seeds with its 95 % confidence interval, all in the figure's unit."""

    value: float
    low: float
    high: float
    n: int


def interval(values: ArrayLike, statistic: Callable[..., Any] = np.mean, *, seed: int = 0) -> Interval:
    """A statistic of values, one a seed, with its percentile bootstrap interval (9,999 resamples, 95 %).

    values (n,); an infinite one ("never") is kept, and an interval may reach it; of one value the interval is the
    value. statistic: `numpy.mean` or `numpy.median` (anything with `axis`). seed: of the resampling.
    Raises ValueError for no values or a NaN.
    Source: Efron 1979; for few seeds and means it is somewhat too narrow (Efron, Tibshirani 1993, chapter 13).
    """
    sample = _finite_or_never("interval", values)
    with np.errstate(invalid="ignore"):
        value = float(statistic(sample))
        if (sample == sample[0]).all():
            return Interval(value, value, value, len(sample))
        resampled = scipy.stats.bootstrap((sample,), statistic, method="percentile", **_resampling(seed))
    tail = 0.5 * (1.0 - CONFIDENCE)
    # from the distribution itself: between a number and "never" nothing can be interpolated
    low, high = np.quantile(resampled.bootstrap_distribution, [tail, 1.0 - tail], method="inverted_cdf")
    return Interval(value, float(low), float(high), len(sample))


def share(successes: ArrayLike) -> Interval:
    """The share of seeds that succeeded, with Wilson's 95 % interval, which stays honest for none and for all of them.

    successes (n,) of booleans; `interval` gives the bootstrap interval of the same share, which has no width if all
    seeds agree. Raises ValueError for no seeds. Source: Wilson 1927.
    """
    won = np.asarray(successes, dtype=bool)
    if won.ndim != 1 or not len(won):
        raise ValueError(f"share: successes of shape {won.shape}, expected (n,) with n >= 1")
    low, high = scipy.stats.binomtest(int(won.sum()), len(won)).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(float(won.mean()), float(low), float(high), len(won))


@dataclass(frozen=True, kw_only=True)
class Paired:
    """How much a exceeds b over the seeds that both met."""

    difference: Interval
    """Mean of a - b with its bootstrap interval, in the figure's unit."""
    p: float
    """Two-sided p value of the sign-flip permutation test of the mean difference, exact up to 13 seeds [1]."""


def paired(a: ArrayLike, b: ArrayLike, *, seed: int = 0) -> Paired:
    """Compare two controllers by one figure, seed for seed: mean difference a - b, its interval, and a test.

    a, b (n,): the same seeds in the same order, finite. With n seeds no p of the permutation test is below 2^(1 - n):
    five seeds cannot show 5 %. Testing many figures at once, some p will be small by chance.
    Raises ValueError for other lengths, fewer than two seeds, or a value that is not finite.
    Source: Fisher 1935.
    """
    first, second = _finite_or_never("paired", a), _finite_or_never("paired", b)
    if first.shape != second.shape or len(first) < 2 or not np.isfinite([first, second]).all():
        raise ValueError(
            f"paired: shapes {first.shape} and {second.shape}, expected two of the same (n,), n >= 2, all finite: "
            "leave out seeds that one of them did not finish, and say how many"
        )
    gap = first - second
    test = scipy.stats.permutation_test((gap,), np.mean, permutation_type="samples", **_resampling(seed))
    return Paired(difference=interval(gap, seed=seed), p=float(test.pvalue))


def _resampling(seed: int) -> dict[str, Any]:
    return {"n_resamples": RESAMPLES, "vectorized": True, "random_state": np.random.default_rng(seed)}


def _finite_or_never(where: str, values: ArrayLike) -> Array:
    sample = np.asarray(values, dtype=float)
    if sample.ndim != 1 or not len(sample) or np.isnan(sample).any():
        raise ValueError(f"{where}: values {sample.tolist()}, expected (n,) with n >= 1, one a seed, none NaN")
    return sample
