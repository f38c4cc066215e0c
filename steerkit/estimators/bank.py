"""A bank of candidates, one of which is the right one: recursive least squares for each, and the best between them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from steerkit._support.errors import require, require_within, whole_samples
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, State
from steerkit.diagram.maths import Scalar
from steerkit.estimators.steering_response import at

_EXPLAINED = 0.5
"""Share of the response's variance that has to be explained."""
_FEWEST = 10.0
"""Independent samples from which on the residual shows the noise."""
_CORRELATED = 0.15
"""For how long the errors of the response hang together [s]: what free play and roads add to noise."""
REGRESSORS = 3
MOMENTS = 2 * REGRESSORS + REGRESSORS * (REGRESSORS + 1) // 2
"""What is kept of a candidate: means, covariances, covariances with the response."""


class Sums(NamedTuple):
    """What is summed over all used samples, with forgetting: weights (total), independent samples (count), the mean of
    the response, and the weighted squares about it (power)."""

    total: Scalar
    count: Scalar
    mean: Scalar
    power: Scalar


class Fit(NamedTuple):
    """The regression of one candidate: its coefficients, by how much (saved) it lowers the weighted sum of squares, and
    the variance of its last coefficient."""

    coefficients: Sequence[Scalar]
    saved: Scalar
    last_variance: Scalar


class Valley(NamedTuple):
    """Where the candidates fit best, and how well: the lowest point of a parabola through the best and neighbours.

    place: number of the candidate, with a fraction, and its variance, 2 over the curvature. number: the best candidate
    itself, not at either end of the bank. excess: how many times the noise the residual is, 1 at least. explained: does
    the best one explain half of the response's variance? 0 or 1.
    """

    place: Scalar
    variance: Scalar
    number: Scalar
    excess: Scalar
    explained: Scalar


def rls_update(moments: State, x: Sequence[Scalar], dy: Scalar, keep: Scalar, gain: Scalar, weight: Scalar) -> State:
    """A candidate's moments after one more sample.

    m' = m + gain (x - m),  C' = keep C + weight (1 - gain) (x - m)(x - m)^T,  the same with y:

    exact exponential forgetting of weighted means and centred sums of products, so that an unknown constant costs
    nothing. x: three regressors; dy: the response less its mean before; gain: weight over the sum of all weights.
    Source: West 1979 (updating weighted means and covariances).
    """
    own, (a, b, c) = weight * (1.0 - gain), [value - mean for value, mean in zip(x, moments)]
    own_b, own_c, own_y = own * b, own * c, own * dy
    more = own * a * a, own_b * a, own_b * b, own_c * a, own_c * b, own_c * c, own_y * a, own_y * b, own_y * c
    means = [mean + gain * off for mean, off in zip(moments, (a, b, c))]
    return (*means, *[keep * old + new for old, new in zip(moments[REGRESSORS:], more)])


def fitted(moments: State, precision: Sequence[float], prior: Sequence[float]) -> Fit:
    """The coefficients theta that lower (y - theta x)^2, summed, plus precision (theta - prior)^2, most.

    By Cholesky's decomposition without roots. Precisions are one over the priors' variances; the weights of
    `rls_update` are one over that of the response's noise.
    """
    p = len(precision)
    place, cross, saved = p, p + p * (p + 1) // 2, 0.0
    lower, pivots, halves, parts = list[Any](), list[Any](), list[Any](), list[Any]()
    for i, (q, mean) in enumerate(zip(precision, prior)):
        row: list[Scalar] = []
        pivot, half = moments[place + i] + q, moments[cross + i] + q * mean
        for j in range(i):
            entry = moments[place + j]
            for k in range(j):
                entry = entry - row[k] * pivots[k] * lower[j][k]
            share = entry / pivots[j]
            pivot, half = pivot - share * entry, half - share * halves[j]
            row.append(share)
        part = half / pivot
        saved = saved + half * part - q * mean * mean
        for values, value in ((lower, row), (pivots, pivot), (halves, half), (parts, part)):
            values.append(value)
        place += i + 1
    for i in range(p - 1, 0, -1):
        for j in range(i):
            parts[j] = parts[j] - lower[i][j] * parts[i]
    return Fit(tuple(parts), saved, 1.0 / pivots[-1])


def lowest(costs: Sequence[Scalar], least_curvature: float) -> tuple[Scalar, Scalar, Scalar]:
    """Place, variance and number as in `Valley`: where between the candidates the cost is lowest, within the bank.

    costs: three or more, -2 log likelihood. least_curvature: that of the prior, which a valley cannot be wider than.
    """
    cost, number, before, after = costs[1], 1.0 + 0.0 * costs[1], costs[0], costs[2]
    for i in range(2, len(costs) - 1):
        lower = costs[i] < cost
        before, after = m.where(lower, costs[i - 1], before), m.where(lower, costs[i + 1], after)
        cost, number = m.where(lower, costs[i], cost), m.where(lower, float(i), number)
    curvature = m.maximum(before - 2.0 * cost + after, least_curvature)
    aside = m.clip(0.5 * (before - after) / curvature, -1.0, 1.0)
    return number + aside, 2.0 / curvature, number


@dataclass(frozen=True, eq=False, kw_only=True)
class Bank(Block):
    """Least squares of a measured response for a bank of candidates; abstract.

    With candidates 0, step, 2 step, ..., a regression's cost is the weighted sum of squares left over and the priors'.
    """

    memory: float
    """Seconds of driving that were used, after which their weight has fallen to 1/e."""
    longest: float
    """Longest delay [s], a multiple of dt."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where = type(self).__name__
        require_within(where, "dt", self.dt, "s", 1e-3, _CORRELATED)
        longest = whole_samples(where, "longest", self.longest, self.dt)
        require(2 <= longest <= 100, where, f"longest = {self.longest} [s], expected 2 to 100 samples of {self.dt:g} s")

    @cached_property
    def _line(self) -> int:
        """Samples of a delay line."""
        return round(self.longest / self.dt) + 1

    def _summed(
        self, sums: Sums, moments: State, rows: Sequence[Sequence[Scalar]], measured: Sequence[Scalar], used: Scalar
    ) -> tuple[Sums, list[Scalar]]:
        """Sums, and the moments of all candidates, after a sample; as they were where it is not `used`.

        rows: the regressors of each candidate. measured: response [rad] and weight [1/rad^2].
        """
        if used is False:  # one car
            return sums, list(moments)
        response, weight = measured
        share = self.dt / _CORRELATED  # of an independent sample
        keep = m.where(used, math.exp(-self.dt / self.memory), 1.0)
        weight = m.where(used, weight * share, 0.0)
        total = keep * sums.total + weight
        gain = weight / m.maximum(total, 1e-12)
        dy = m.where(used, response, 0.0) - sums.mean
        after: list[Scalar] = []
        for i, row in enumerate(rows):
            after += rls_update(moments[MOMENTS * i : MOMENTS * (i + 1)], row, dy, keep, gain, weight)
        count = keep * sums.count + m.where(used, share, 0.0)
        power = keep * sums.power + weight * (1.0 - gain) * dy * dy
        return Sums(total, count, sums.mean + gain * dy, power), after

    def _best(
        self,
        sums: Sums,
        moments: State,
        precision: Sequence[float],
        prior: Sequence[float],
        place: tuple[float, float, float],
    ) -> tuple[Valley, list[Fit]]:
        """Where the candidates fit best, and all regressions; place: the candidates' step, prior and its deviation."""
        step, expected, deviation = place
        bank = [fitted(moments[i : i + MOMENTS], precision, prior) for i in range(0, len(moments), MOMENTS)]
        costs = [sums.power - fit.saved + ((i * step - expected) / deviation) ** 2 for i, fit in enumerate(bank)]
        where, variance, number = lowest(costs, 2.0 * (step / deviation) ** 2)
        left = sums.power - at(number, [fit.saved for fit in bank])
        excess = m.maximum(left / m.maximum(sums.count, _FEWEST), 1.0)
        return Valley(where, variance, number, excess, left < (1.0 - _EXPLAINED) * sums.power), bank
