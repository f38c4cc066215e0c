"""The calmest curve within the noise of its points: a penalised spline whose residual is the noise that was stated."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.paths.waypoints import travelled

Array = NDArray[np.float64]

_DEGREE = 5
_SPAN = (0.5, 2.5)
"""Distance of the spline's knots [m]: the points', within these, and not below four times the noise."""
_MOST = 40_000
"""Knots at most; they lie further apart along a course that is longer."""
_STIFFEST, _SOFTEST = 1e11, 1e-9
"""Largest and least weight of the penalty, over the points': beyond, rounding would be seen."""


def smoothed(points: Array, noise: float, *, closed: bool) -> tuple[Any, float, Array, float]:
    """The curve c(u) near points, its end [m], where on it they lie (n,) [m], and the noise that they show [m].

        minimise  sum_i |c(u_i) - p_i|^2 + lambda integral |c'''(u)|^2 du,

    of all curves within the noise the one that asks least speed of the steering wheel; lambda the largest with
    sum d_i^2 <= sigma^2 (n - f) (1 + 2 sqrt(2/n)), what noise stays below in 39 of 40 cases: d_i how far p_i lies
    beside the curve, sigma = `noise`, and f = L/(3 mu^(1/6)), mu = lambda L/n, the degrees of freedom that the curve
    takes. c is a quintic B-spline, the penalty that of its coefficients' third differences, u the arc length, found by
    repetition from the points of the curve next to p_i: noise along the way goes into u.

    points: (n, 2) [m], distinct neighbours; closed: without the first one again. noise [m]: standard deviation across
    the way, > 0. Source: Eilers, Marx 1996 (the spline); Wahba 1983 (the degrees of freedom).
    """
    from scipy.interpolate import BSpline
    from scipy.sparse import csr_matrix, diags_array

    require(noise > 0.0, "smoothed", f"noise = {noise} [m], expected > 0")
    n = len(points)
    ring = np.vstack((points, points[:1])) if closed else points
    u = travelled(ring)
    along = np.gradient(ring, u, axis=0)[:n]
    for _ in range(3):
        end = float(u.max())
        span = float(np.clip(max(np.median(np.diff(u)), 4.0 * noise), *_SPAN))
        cells = int(np.clip(math.ceil(end / span), 2 * _DEGREE, _MOST))
        h = end / cells
        knots = h * np.arange(-_DEGREE, cells + _DEGREE + 1)
        basis = BSpline.design_matrix(np.clip(u[:n], 0.0, end * (1.0 - 1e-12)), knots, _DEGREE)
        wide = cells + _DEGREE
        third = diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(wide - 3, wide)) / h**2.5
        if closed:  # the last five coefficients are the first five again
            wrap = csr_matrix((np.ones(wide), (np.arange(wide), np.arange(wide) % cells)), shape=(wide, cells))
            basis, third = basis @ wrap, (third @ wrap)[:cells]
        beside = np.column_stack((-along[:, 1], along[:, 0])) / np.hypot(*along.T)[:, None]
        c, shown = _weighed(basis, third, points, beside, noise, end)
        curve = BSpline(knots, np.vstack((c, c[:_DEGREE])) if closed else c, _DEGREE)
        fine = np.linspace(0.0, end, 20 * cells + 1)
        arc = travelled(curve(fine))
        at = np.clip(u[:n], 0.0, end)
        along = curve(at, 1)
        foot = np.clip(at + ((points - curve(at)) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, end)
        before, u = foot, np.interp(foot, fine, arc)
        u = np.append(u - u[0], arc[-1]) if closed else u - u.min()
        if closed:
            u[:n] %= arc[-1]
    begin, last = (0.0, end) if closed else (float(before.min()), float(before.max()))
    return lambda z, order=0: curve(begin + z, order), last - begin, np.maximum.accumulate(before - begin), shown


def _weighed(basis: Any, third: Any, points: Array, beside: Array, noise: float, end: float) -> tuple[Array, float]:
    """The coefficients for the largest weight of the penalty that keeps to the noise; and the noise that they show.

    third: gives the third derivatives, whose squares are the penalty. beside: the direction across the way at each
    point (n, 2).
    """
    from scipy.sparse.linalg import splu

    n, normal, penalty = len(points), basis.T @ basis, third.T @ third
    centre = points.mean(axis=0)
    near = points - centre

    def solved(log_weight: float) -> tuple[Array, float, float]:
        """Coefficients, by how much their residual is more than the noise's, and the noise that they show."""
        weight = math.exp(log_weight)
        factors = splu((normal + weight * penalty).tocsc())
        c = factors.solve(basis.T @ near)
        for _ in range(2):  # what rounding has left of a stiff curve's equations
            c += factors.solve(basis.T @ (near - basis @ c) - weight * (third.T @ (third @ c)))
        residual = float(((beside * (basis @ c - near)).sum(axis=1) ** 2).sum())
        free = end / (3.0 * (weight * end / n) ** (1.0 / 6.0))
        left = max(n - free, 0.1 * n)
        return c, residual - noise**2 * left * (1.0 + 2.0 * math.sqrt(2.0 / n)), math.sqrt(residual / left)

    ratio = float(normal.diagonal().mean() / penalty.diagonal().mean())
    high, least = math.log(_STIFFEST * ratio), math.log(_SOFTEST * ratio)
    while high > least and solved(high - 1.0)[1] > 0.0:
        high -= 1.0
    low = high - 1.0
    for _ in range(10):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if solved(middle)[1] > 0.0 else (middle, high)
    c, _, shown = solved(low)
    return c + centre, shown
