"""A bank of candidates: recursive least squares for each of them, and the one between them that fits best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.maths import Scalar

_EXPLAINED = 0.5
"""Share of the response's variance that has to be explained."""
_FEWEST = 10.0
"""Samples of their own from which on what is left over tells of the noise."""


class Weighed(NamedTuple):
    """What is summed over all samples that taught, with forgetting."""

    total: Scalar
    """Weights."""
    count: Scalar
    """Samples that tell something of their own."""
    mean: Scalar
    """Of the response."""
    power: Scalar
    """Weighted squares of the response about its mean."""


class Fit(NamedTuple):
    """What one candidate's regression says."""

    coefficients: Sequence[Scalar]
    saved: Scalar
    """By how much it lowers the weighted sum of squares."""
    last_variance: Scalar
    """Variance of its last coefficient."""


class Best(NamedTuple):
    """The lowest point of a parabola through the lowest candidate and its neighbours."""

    place: Scalar
    """Number of the candidate, with a fraction."""
    variance: Scalar
    """Of the place, in candidates squared: 2 over the curvature."""
    cost: Scalar
    number: Scalar
    """Number of the lowest candidate itself, not at either end of the bank."""


def size(regressors: int) -> int:
    """Moments that are kept of a candidate: means, covariances, covariances with the response."""
    return 2 * regressors + regressors * (regressors + 1) // 2


def rls_update(moments: State, x: Sequence[Scalar], dy: Scalar, keep: Scalar, gain: Scalar, weight: Scalar) -> State:
    """A candidate's moments after one more sample.

    m' = m + gain (x - m),  C' = keep C + weight (1 - gain) (x - m)(x - m)^T,  the same with y:

    exact exponential forgetting of weighted means and centred sums of products, so that an unknown constant costs
    nothing. x: regressors; dy: the response less its mean before; gain: weight over the sum of all weights.
    Source: West 1979 (updating weighted means and covariances).
    """
    p, own = len(x), weight * (1.0 - gain)
    d = [value - mean for value, mean in zip(x, moments)]
    after = [mean + gain * value for mean, value in zip(moments, d)]
    place = p
    for i, aside in enumerate((*d, dy)):
        added = own * aside
        for other in d[: i + 1]:
            after.append(keep * moments[place] + added * other)
            place += 1
    return tuple(after)


def learned(
    sums: Weighed,
    moments: State,
    rows: Sequence[Sequence[Scalar]],
    response: Scalar,
    *,
    weight: Scalar,
    share: float,
    keep: float,
    teaches: Scalar,
) -> tuple[Weighed, list[Scalar]]:
    """Sums, and the moments of all candidates, after a sample; as they were where it teaches nothing.

    rows: the regressors of each candidate. weight: one over the variance of the response's noise. share: how much of a
    sample of its own this is. keep: what is left of what came before.
    """
    keeps = m.where(teaches, keep, 1.0)
    weight = m.where(teaches, weight * share, 0.0)
    total = keeps * sums.total + weight
    gain = weight / m.maximum(total, 1e-12)
    dy = m.where(teaches, response, 0.0) - sums.mean
    after: list[Scalar] = []
    if _plain(moments[0], rows[0][0], dy, weight):
        regressors: Any = np.array(rows).T
        table = rls_update(_columns(moments, size(len(rows[0]))), regressors, dy, keeps, gain, weight)
        after = np.array(table).T.ravel().tolist()
    else:
        for candidate, row in zip(_split(moments, len(rows[0])), rows):
            after += rls_update(candidate, row, dy, keeps, gain, weight)
    count = keeps * sums.count + m.where(teaches, share, 0.0)
    power = keeps * sums.power + weight * (1.0 - gain) * dy * dy
    return Weighed(total, count, sums.mean + gain * dy, power), after


def _split(moments: State, regressors: int) -> list[State]:
    """The moments of each candidate."""
    n = size(regressors)
    return [moments[i : i + n] for i in range(0, len(moments), n)]


def _plain(*values: Scalar) -> bool:
    """Is this one car, in floats? Then its candidates are reckoned as a batch is: much sooner, with the same result."""
    return all(isinstance(value, float) for value in values)


def _columns(moments: State, n: int) -> Any:
    """The moments of one car's candidates, each moment an array over them: (n, candidates)."""
    return np.array(moments).reshape(-1, n).T


def fits(moments: State, precision: Sequence[float], prior: Sequence[float]) -> list[Fit]:
    """What the regression of each candidate says; see `fitted`."""
    if _plain(moments[0], moments[-1]):
        table = fitted(_columns(moments, size(len(precision))), precision, prior)
        coefficients = np.array(table.coefficients).T.tolist()
        return list(map(Fit, coefficients, table.saved.tolist(), table.last_variance.tolist()))
    return [fitted(candidate, precision, prior) for candidate in _split(moments, len(precision))]


def fitted(moments: State, precision: Sequence[float], prior: Sequence[float]) -> Fit:
    """The coefficients theta that lower (y - theta x)^2, summed, plus precision (theta - prior)^2, most.

    By Cholesky's decomposition without roots. Precisions are one over the priors' variances; the weights of `taught`
    are one over that of the response's noise.
    """
    p = len(precision)
    place, cross = p, p + p * (p + 1) // 2
    lower: list[list[Scalar]] = []
    pivots: list[Scalar] = []
    halves: list[Scalar] = []
    parts: list[Scalar] = []
    saved: Scalar = 0.0
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
        lower.append(row)
        pivots.append(pivot)
        halves.append(half)
        parts.append(part)
        place += i + 1
    for i in range(p - 1, 0, -1):
        for j in range(i):
            parts[j] = parts[j] - lower[i][j] * parts[i]
    return Fit(tuple(parts), saved, 1.0 / pivots[-1])


def lowest(costs: Sequence[Scalar], least_curvature: float) -> Best:
    """Where between the candidates the cost is lowest; it never leaves the bank.

    costs: three or more, -2 log likelihood. least_curvature: that of the prior, which a valley cannot be wider than.
    """
    cost, number, before, after = costs[1], 1.0 + 0.0 * costs[1], costs[0], costs[2]
    for i in range(2, len(costs) - 1):
        lower = costs[i] < cost
        before, after = m.where(lower, costs[i - 1], before), m.where(lower, costs[i + 1], after)
        cost, number = m.where(lower, costs[i], cost), m.where(lower, float(i), number)
    curvature = m.maximum(before - 2.0 * cost + after, least_curvature)
    aside = m.clip(0.5 * (before - after) / curvature, -1.0, 1.0)
    bottom = cost - 0.5 * curvature * aside * aside
    return Best(number + aside, 2.0 / curvature, bottom, number)


class Valley(NamedTuple):
    """Where the candidates fit best, and how well."""

    best: Best
    excess: Scalar
    """How many times more is left over than the noise explains, 1 at least."""
    explained: Scalar
    """Does the best one explain half of the response's variance? 0 or 1."""


def valley(sums: Weighed, saved: Sequence[Scalar], step: float, prior: float, deviation: float) -> Valley:
    """Of candidates 0, step, 2 step, ... that lower the sum of squares by `saved`; theirs is prior +- deviation."""
    costs = [sums.power - fit + ((i * step - prior) / deviation) ** 2 for i, fit in enumerate(saved)]
    best = lowest(costs, 2.0 * (step / deviation) ** 2)
    left = sums.power - at(best.number, saved)
    return Valley(best, m.maximum(left / m.maximum(sums.count, _FEWEST), 1.0), left < (1.0 - _EXPLAINED) * sums.power)


def at(number: Scalar, values: Sequence[Scalar]) -> Scalar:
    """The value of the candidate of that number."""
    if _plain(number) and number == number:  # a NaN is looked up as the others do it
        return values[math.ceil(m.clip(number, 0.0, len(values) - 1.0) + 0.5) - 1]
    picked = values[0]
    for i in range(1, len(values)):
        picked = m.where(number > i - 0.5, values[i], picked)
    return picked
