"""The calmest curve within the noise of its points: a penalised spline whose residual is the noise that was stated."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit.errors import require

Array = NDArray[np.float64]

_DEGREE = 5
_SPAN = (0.5, 2.5)
"""Distance of the spline's knots [m]: the points', within these."""
_MOST = 40_000
"""Knots at most; they lie further apart along a course that is longer."""
_FAR, _NEAR = 45.0, -5.0
"""Largest and least logarithm of the weight of the penalty that are tried."""


def smoothed(points: Array, noise: float, *, closed: bool) -> tuple[Any, float, Array, float]:
    """The curve c(u) near points, its end [m], where on it they lie (n,) [m], and the noise that they show [m].

        minimise  sum_i |c(u_i) - p_i|^2 + lambda integral |c'''(u)|^2 du,

    of all curves within the noise the one that asks least speed of the steering wheel; lambda the largest with
    sum |c(u_i) - p_i|^2 = 2 sigma^2 (n - f), sigma = `noise`. f = L/(3 mu^(1/6)), mu = lambda L/n, are the degrees of
    freedom that the curve itself takes. c is a quintic B-spline, the penalty that of its coefficients' third
    differences, u the arc length, found by repetition.

    points: (n, 2) [m], distinct neighbours; closed: without the first one again. noise [m]: standard deviation in x and
    in y, > 0. Source: Eilers, Marx 1996 (the spline); Wahba 1983 (the degrees of freedom).
    """
    from scipy.interpolate import BSpline
    from scipy.sparse import csr_matrix, diags_array

    require(noise > 0.0, "smoothed", f"noise = {noise} [m], expected > 0")
    n = len(points)
    ring = np.vstack((points, points[:1])) if closed else points
    u = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))))
    for _ in range(3):
        end = float(u[-1])
        span = float(np.clip(np.median(np.diff(u)), *_SPAN))
        cells = int(np.clip(math.ceil(end / span), 2 * _DEGREE, _MOST))
        h = end / cells
        knots = h * np.arange(-_DEGREE, cells + _DEGREE + 1)
        basis = BSpline.design_matrix(np.clip(u[:n], 0.0, end * (1.0 - 1e-12)), knots, _DEGREE)
        wide = cells + _DEGREE
        third = diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(wide - 3, wide)) / h**3
        if closed:  # the last five coefficients are the first five again
            wrap = csr_matrix((np.ones(wide), (np.arange(wide), np.arange(wide) % cells)), shape=(wide, cells))
            basis, third = basis @ wrap, (third @ wrap)[:cells]
        c, left = _weighed(basis, h * (third.T @ third), points, noise, end)
        curve = BSpline(knots, np.vstack((c, c[:_DEGREE])) if closed else c, _DEGREE)
        fine = np.linspace(0.0, end, 20 * cells + 1)
        arc = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(curve(fine), axis=0).T))))
        before, u = u, np.interp(u, fine, arc)
    return curve, end, before[:n], left


def _weighed(basis: Any, penalty: Any, points: Array, noise: float, end: float) -> tuple[Array, float]:
    """The coefficients for the largest weight of the penalty that keeps to the noise; and the noise that they show."""
    from scipy.sparse.linalg import splu

    n, normal, right = len(points), basis.T @ basis, basis.T @ points

    def solved(log_weight: float) -> tuple[Array, float, float]:
        """Coefficients, by how much their residual is more than the noise's, and the noise that they show."""
        weight = math.exp(log_weight)
        c = splu((normal + weight * penalty).tocsc()).solve(right)
        residual = float(((basis @ c - points) ** 2).sum())
        free = end / (3.0 * (weight * end / n) ** (1.0 / 6.0))
        left = max(n - free, 0.1 * n)
        return c, residual - 2.0 * noise**2 * left, math.sqrt(residual / (2.0 * left))

    high = _FAR
    while high > _NEAR and solved(high - 1.0)[1] > 0.0:
        high -= 1.0
    low = high - 1.0
    for _ in range(10):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if solved(middle)[1] > 0.0 else (middle, high)
    c, _, shown = solved(low)
    return c, shown
