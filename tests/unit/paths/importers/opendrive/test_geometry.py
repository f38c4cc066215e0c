"""Each shape of a reference line against its closed form, or an integral to twenty digits."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.special import fresnel

from steerkit.paths.importers.opendrive.geometry import Line, ParamPoly3, Poly3, Shape, Spiral

PLACE: dict[str, Any] = dict(s=0.0, x0=0.0, y0=0.0, psi0=0.0)
EXACT = 1e-9


def test_a_straight_in_the_maps_frame() -> None:
    line = Line(s=7.0, x0=3.0, y0=-2.0, psi0=0.5, length=40.0)
    x, y, psi = line.at(np.array([0.0, 40.0]))
    assert np.allclose(x, [3.0, 3.0 + 40.0 * math.cos(0.5)], atol=EXACT, rtol=0.0)
    assert np.allclose(y, [-2.0, -2.0 + 40.0 * math.sin(0.5)], atol=EXACT, rtol=0.0)
    assert np.allclose(psi, 0.5)


@pytest.mark.parametrize("k", [0.1, -0.02, 1e-7, 0.0])
def test_an_arc_is_a_part_of_a_circle(k: float) -> None:
    d = np.linspace(0.0, 90.0, 37)
    u, v, heading = Spiral(**PLACE, length=90.0, k0=k, k1=k).local(d)
    assert np.allclose(heading, k * d, atol=1e-12)
    exact_u = np.sin(k * d) / k if k else d
    exact_v = 2.0 * np.sin(0.5 * k * d) ** 2 / k if k else 0.0 * d
    assert np.abs(u - exact_u).max() < EXACT
    assert np.abs(v - exact_v).max() < EXACT


@pytest.mark.parametrize(("k1", "length"), [(0.2, 100.0), (-0.05, 300.0), (1.0, 20.0)])
def test_a_spiral_from_a_straight_is_fresnels_integral(k1: float, length: float) -> None:
    d = np.linspace(0.0, length, 41)
    u, v, _ = Spiral(**PLACE, length=length, k0=0.0, k1=k1).local(d)
    scale = math.sqrt(math.pi * length / abs(k1))
    s, c = fresnel(d / scale)
    assert np.abs(u - scale * c).max() < EXACT
    assert np.abs(v - math.copysign(1.0, k1) * scale * s).max() < EXACT


@pytest.mark.parametrize(("k0", "k1"), [(0.1, -0.1), (0.05, 0.05 + 1e-9), (-0.02, 0.3), (1e-9, -1e-9)])
def test_a_spiral_between_any_curvatures(k0: float, k1: float) -> None:
    """Also where curvature hardly changes, and Fresnel integrals would lose all digits."""
    length = 80.0
    u, v, _ = Spiral(**PLACE, length=length, k0=k0, k1=k1).local(np.array([length]))
    with mpmath.workdps(25):
        integral = mpmath.quad(lambda t: mpmath.expj(k0 * t + (k1 - k0) * t * t / (2 * length)), [0, 20, 40, 60, 80])
    assert abs(u[0] - float(integral.real)) < EXACT
    assert abs(v[0] - float(integral.imag)) < EXACT


@pytest.mark.parametrize("c", [0.01, -0.002])
def test_a_parabola_at_its_arc_length(c: float) -> None:
    end = 30.0
    z = 2.0 * c * end
    length = (z * math.hypot(1.0, z) + math.asinh(z)) / (4.0 * c)
    u, v, heading = Poly3(**PLACE, length=length, v=(0.0, 0.0, c, 0.0)).local(np.array([0.0, length]))
    assert np.allclose(u, [0.0, end], atol=EXACT, rtol=0.0)
    assert np.allclose(v, [0.0, c * end**2], atol=EXACT, rtol=0.0)
    assert heading[1] == pytest.approx(math.atan(z), abs=1e-12)


def test_a_cubics_distance_is_its_arc_length() -> None:
    cubic = Poly3(**PLACE, length=50.0, v=(0.0, 0.1, -0.02, 4e-4))
    for d in (5.0, 31.7, 50.0):
        (u,), _, _ = cubic.local(np.array([d]))
        with mpmath.workdps(20):
            along = mpmath.quad(lambda p: mpmath.sqrt(1 + (0.1 - 0.04 * p + 1.2e-3 * p * p) ** 2), [0, u / 2, u])
        assert float(along) == pytest.approx(d, abs=EXACT)


def test_two_cubics_of_a_parameter_in_both_ranges() -> None:
    length, d = 40.0, np.linspace(0.0, 40.0, 11)
    u, v = (0.0, 1.0, 0.0, -1e-5), (0.0, 0.0, 5e-3, -1e-4)
    by_length = ParamPoly3(**PLACE, length=length, u=u, v=v, normalised=False).local(d)
    scaled = [tuple(a * length**k for k, a in enumerate(c)) for c in (u, v)]
    by_share = ParamPoly3(**PLACE, length=length, u=scaled[0], v=scaled[1], normalised=True).local(d)  # type: ignore[arg-type]
    assert np.abs(by_length[0] - (d - 1e-5 * d**3)).max() < EXACT
    assert np.abs(by_length[1] - (5e-3 * d**2 - 1e-4 * d**3)).max() < EXACT
    slopes = np.arctan2(1e-2 * d - 3e-4 * d**2, 1.0 - 3e-5 * d**2)
    assert np.abs(by_length[2] - slopes).max() < EXACT
    for one, other in zip(by_length, by_share):
        assert np.abs(one - other).max() < EXACT


@pytest.mark.parametrize(
    "shape",
    [
        Spiral(**PLACE, length=60.0, k0=-0.03, k1=0.08),
        Poly3(**PLACE, length=60.0, v=(0.0, 0.0, 0.01, -1e-4)),
        ParamPoly3(**PLACE, length=60.0, u=(0.0, 1.0, 0.0, 0.0), v=(0.0, 0.0, 1e-3, 1e-5), normalised=False),
    ],
)
def test_the_heading_is_that_of_the_line(shape: Shape) -> None:
    d = np.linspace(1.0, 59.0, 59)
    (u0, v0, _), (u1, v1, _) = shape.local(d - 1e-4), shape.local(d + 1e-4)
    _, _, heading = shape.local(d)
    assert np.abs(np.arctan2(v1 - v0, u1 - u0) - heading).max() < 1e-7


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (Line, dict(length=-1.0), "is -1.0 m long"),
        (Line, dict(length=math.nan), "is nan m long"),
        (Spiral, dict(length=10.0, k0=math.inf, k1=0.0), "expected numbers"),
        (Spiral, dict(length=1e5, k0=0.0, k1=1e6), "which no road does"),
        (Poly3, dict(length=10.0, v=(0.0, math.nan, 0.0, 0.0)), "expected numbers"),
    ],
)
def test_what_is_no_shape_is_refused(kind: type[Shape], values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kind(**PLACE, **values)
