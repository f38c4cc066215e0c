"""Prediction and correction of a mean and its covariance: a Kalman filter in plain arithmetic."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

from steerkit.diagram import maths as m
from steerkit.diagram.maths import Scalar

Covariance = list[list[Scalar]]
"""The upper triangle of a symmetric (n, n) matrix P by its rows: entry [i][j - i] is P_ij, j >= i."""
Row = Mapping[int, Scalar]
"""A sparse row: the entries that are not zero, by their column."""


def unpacked(entries: Sequence[Scalar], n: int) -> Covariance:
    """The covariance (n, n) whose upper triangle is `entries`, row by row."""
    starts = [i * n - i * (i - 1) // 2 for i in range(n + 1)]
    return [list(entries[a:b]) for a, b in pairwise(starts)]


def packed(p: Covariance) -> tuple[Scalar, ...]:
    """Its upper triangle, row by row: n (n + 1)/2 scalars."""
    return tuple([entry for row in p for entry in row])


def line(p: Covariance, i: int) -> list[Scalar]:
    """A whole row of P."""
    return [*[p[k][i - k] for k in range(i)], *p[i]]


def covariance(p: Covariance, one: Sequence[int], other: Sequence[int]) -> Scalar:
    """That of two sums of states, each given by its states' numbers."""
    return sum([p[min(i, j)][abs(i - j)] for i in one for j in other])


def predict_covariance(p: Covariance, rows: Sequence[Row], kept: Sequence[Scalar], noise: Row) -> Covariance:
    """F P F' + Q, with F made of `rows`, and below them of a diagonal, `kept`; Q is diagonal, its entries `noise`.

    rows, kept: together n. source: Gelb 1974, table 4.2-1.
    """
    moving, after = len(rows), []
    lines = {j: line(p, j) for row in rows for j in row}
    for i, row in enumerate(rows):
        half = [0.0] * len(p)  # row i of F P
        for j, f in row.items():
            half = [a + f * b for a, b in zip(half, lines[j])]
        fast = [sum([f * half[c] for c, f in other.items()]) for other in rows[i:]]
        after.append([*fast, *[a * f for a, f in zip(half[moving:], kept)]])
    for i, a in enumerate(kept):
        after.append([a * f * b for f, b in zip(kept[i:], p[moving + i])])
    for i, q in noise.items():
        after[i][0] = after[i][0] + q
    return after


def widened(p: Covariance, more: Row) -> Covariance:
    """P with more variance on its diagonal."""
    return [[row[0] + more[i], *row[1:]] if i in more else row for i, row in enumerate(p)]


def corrected(
    mean: Sequence[Scalar], p: Covariance, states: Sequence[int], missed: Scalar, noise: Scalar, used: Scalar
) -> tuple[list[Scalar], Covariance]:
    """Mean and covariance after the sum of some states was measured, or as they were where `used` does not hold.

    states: the numbers of those states, h. missed: z - h x, the innovation. noise: variance of the measurement.
    source: Gelb 1974, table 4.2-1.
    """
    share = [sum(entries) for entries in zip(*[line(p, j) for j in states])]  # P h'
    gain = m.where(used, 1.0 / (sum([share[j] for j in states]) + noise), 0.0)
    return drawn(mean, p, share, gain, m.where(used, missed, 0.0))


def drawn(
    mean: Sequence[Scalar], p: Covariance, share: Sequence[Scalar], gain: Scalar, missed: Scalar
) -> tuple[list[Scalar], Covariance]:
    """Mean and covariance after a measurement of any sum h x, given what they come from.

    share: P h'. gain: one over the innovation's variance, 0 where nothing was measured. missed: the innovation.
    """
    step = gain * missed
    after = []
    for i, (row, mine) in enumerate(zip(p, share)):
        part = gain * mine
        after.append([entry - part * other for entry, other in zip(row, share[i:])])
    return [value + step * mine for value, mine in zip(mean, share)], after
