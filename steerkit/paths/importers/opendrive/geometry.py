"""The five shapes of an OpenDRIVE reference line, each by its closed form or to rounding."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require

Array = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_TURN = 1.0
"""A spiral's panels turn by no more than this [rad]: sixteen nodes integrate them to rounding."""
_MOST_PANELS = 20_000


@dataclass(frozen=True, kw_only=True)
class Shape(ABC):
    """A piece of reference line in its own frame: it begins at the origin along +x; abstract.

    `local(d)` gives u, v [m] and heading [rad] at the distances d (n,) [m] from its beginning; `at(d)` the same in
    the map's frame:

        x = x0 + u cos(psi0) - v sin(psi0),  y = y0 + u sin(psi0) + v cos(psi0).

    Source: ASAM OpenDRIVE 1.7, section 7.
    """

    s: float
    """Where on the road it begins [m]."""
    x0: float
    y0: float
    psi0: float
    """Heading at its beginning [rad]."""
    length: float
    """Along the line [m]."""

    def __post_init__(self) -> None:
        known = all(map(math.isfinite, (self.s, self.x0, self.y0, self.psi0, self.length)))
        require(known and 0.0 <= self.length <= 1e6, "geometry", f"at s = {self.s} is {self.length} m long")

    @abstractmethod
    def local(self, d: Array) -> tuple[Array, Array, Array]:
        """u, v [m] and heading [rad] at the distances d (n,) [m]."""

    def at(self, d: Array) -> tuple[Array, Array, Array]:
        """x, y [m] and heading [rad] in the map at the distances d (n,) [m]."""
        u, v, heading = self.local(np.asarray(d, dtype=float))
        c, s = math.cos(self.psi0), math.sin(self.psi0)
        return self.x0 + u * c - v * s, self.y0 + u * s + v * c, self.psi0 + heading


@dataclass(frozen=True, kw_only=True)
class Line(Shape):
    """A straight: u = d, v = 0."""

    def local(self, d: Array) -> tuple[Array, Array, Array]:
        """u, v [m] and heading [rad] at the distances d (n,) [m]."""
        return d, np.zeros_like(d), np.zeros_like(d)


@dataclass(frozen=True, kw_only=True)
class Spiral(Shape):
    """A clothoid, whose curvature changes evenly; with equal curvatures an arc.

        heading = k0 d + (k1 - k0) d^2/(2 length),  u = integral cos(heading),  v = integral sin(heading),

    by Gauss and Legendre's rule with 16 nodes on panels that turn by a radian at most: to rounding, also for curvature
    that hardly changes, where Fresnel integrals cancel.
    """

    k0: float
    """Curvature at its beginning [1/m]."""
    k1: float
    """Curvature at its end [1/m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        known = math.isfinite(self.k0) and math.isfinite(self.k1)
        require(known, "geometry", f"curvature {self.k0} to {self.k1} [1/m] at s = {self.s}, expected numbers")
        turns = max(abs(self.k0), abs(self.k1)) * self.length
        require(
            turns <= _TURN * _MOST_PANELS, "geometry", f"turns by {turns:.3g} rad at s = {self.s}, which no road does"
        )

    def local(self, d: Array) -> tuple[Array, Array, Array]:
        """u, v [m] and heading [rad] at the distances d (n,) [m]."""
        rate = (self.k1 - self.k0) / self.length if self.length > 0.0 else 0.0

        def heading(at: Array) -> Array:
            return at * (self.k0 + 0.5 * rate * at)

        panels = max(1, math.ceil(max(abs(self.k0), abs(self.k1)) * self.length / _TURN))
        edges = np.linspace(0.0, self.length, panels + 1)
        inner = heading(edges[:-1, None] + 0.5 * np.diff(edges)[:, None] * (1.0 + _NODES))
        whole = 0.5 * np.diff(edges) * (np.exp(1j * inner) @ _WEIGHTS)
        before = np.concatenate(([0.0], np.cumsum(whole)))
        panel = np.clip(np.searchsorted(edges, d, side="right") - 1, 0, panels - 1)
        rest = d - edges[panel]
        part = np.exp(1j * heading(edges[panel][:, None] + 0.5 * rest[:, None] * (1.0 + _NODES))) @ _WEIGHTS
        z = before[panel] + 0.5 * rest * part
        return z.real, z.imag, heading(d)


@dataclass(frozen=True, kw_only=True)
class ParamPoly3(Shape):
    """Two cubics of a parameter: u(p) = a_u + b_u p + c_u p^2 + d_u p^3, v(p) alike.

    p = d, or p = d/length where `normalised` (pRange): the curve is exact, the distance along it as even as the map's
    author made it, as the standard has it.
    """

    u: tuple[float, float, float, float]
    v: tuple[float, float, float, float]
    normalised: bool

    def __post_init__(self) -> None:
        super().__post_init__()
        known = all(map(math.isfinite, (*self.u, *self.v)))
        require(known, "geometry", f"coefficients {self.u}, {self.v} at s = {self.s}, expected numbers")

    def local(self, d: Array) -> tuple[Array, Array, Array]:
        """u, v [m] and heading [rad] at the distances d (n,) [m]."""
        p = d / self.length if self.normalised and self.length > 0.0 else d
        return cubic(self.u, p), cubic(self.v, p), np.arctan2(slope(self.v, p), slope(self.u, p))


@dataclass(frozen=True, kw_only=True)
class Poly3(Shape):
    """A cubic over its chord: v(u) = a + b u + c u^2 + d u^3, u from the distance: d = integral sqrt(1 + v'^2) du.

    The integral by Gauss and Legendre's rule on panels, inverted by Newton's method.
    """

    v: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        super().__post_init__()
        require(all(map(math.isfinite, self.v)), "geometry", f"coefficients {self.v} at s = {self.s}, expected numbers")

    def local(self, d: Array) -> tuple[Array, Array, Array]:
        """u, v [m] and heading [rad] at the distances d (n,) [m]."""
        edges = np.linspace(0.0, self.length, 65)  # u never goes further than the distance
        width = edges[1]
        speed = np.hypot(1.0, slope(self.v, edges[:-1, None] + 0.5 * width * (1.0 + _NODES)))
        before = np.concatenate(([0.0], np.cumsum(0.5 * width * (speed @ _WEIGHTS))))
        u = np.interp(d, before, edges)
        for _ in range(8):
            panel = np.clip(np.searchsorted(edges, u, side="right") - 1, 0, 63)
            rest = u - edges[panel]
            speed = np.hypot(1.0, slope(self.v, edges[panel][:, None] + 0.5 * rest[:, None] * (1.0 + _NODES)))
            u = u - (before[panel] + 0.5 * rest * (speed @ _WEIGHTS) - d) / np.hypot(1.0, slope(self.v, u))
        return u, cubic(self.v, u), np.arctan(slope(self.v, u))


def cubic(a: tuple[float, float, float, float], p: Array) -> Array:
    """a_0 + a_1 p + a_2 p^2 + a_3 p^3."""
    return a[0] + p * (a[1] + p * (a[2] + p * a[3]))


def slope(a: tuple[float, float, float, float], p: Array) -> Array:
    """Its derivative by p."""
    return a[1] + p * (2.0 * a[2] + p * 3.0 * a[3])
