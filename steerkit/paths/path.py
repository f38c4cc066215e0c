"""Paths: smooth plane curves by arc length, from waypoints, files or GPS, looked up at the cost of one table row."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path as File
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from steerkit._support.errors import require
from steerkit._support.files import write_text
from steerkit.diagram import maths as m
from steerkit.diagram.maths import Array, Scalar, Table
from steerkit.paths.waypoints import checked, placed, ring, travelled

_DEGREE = 5  # curvature and its first two derivatives are continuous
_FEWEST_SEGMENTS = 12  # a periodic quintic needs some
_OFF = 0.01  # largest distance between the waypoints' spline and the path, in segments
_FINER = "give a smaller spacing, or smoothing > 0 for noisy points"
_UNEVEN = 1e-3  # largest | |c'| - 1 | that still deserves the name arc length


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Path:
    """A plane curve c(s) = (x(s), y(s)) by arc length s, with continuous curvature; immutable.

    On each of n segments of equal length h = length/n, x and y are quintics about the segment's middle:
    x(s) = sum_k a_k w^k, w = s - (i + 1/2) h, i = floor(s/h). The quintics join with four continuous derivatives and
    |c'(s)| = 1 (to better than 1e-6 on the built-in courses), so that with t = c'

        psi = atan2(y', x') [rad],  kappa = x' y'' - y' x'' [1/m], + = left.

    Make one by `from_waypoints`, `from_gps` or `steerkit.paths.importers.read_course`, not by the constructor.

    table: n rows of a_0..a_5 of x, then of y. length [m]. closed: s wraps at `length`; an open path ends at 0 and at
    `length`. name: for messages and plots. Source: de Boor 1978, ch. IX and XIII (spline interpolation by knots).
    """

    table: Table
    length: float
    closed: bool
    name: str = "path"
    origin_deg: tuple[float, float] | None = None
    """Latitude and longitude of x = y = 0 [degrees], of a path from GPS."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "h", self.length / len(self.table))
        object.__setattr__(self, "_per_metre", len(self.table) / self.length)
        object.__setattr__(self, "_last", float(len(self.table) - 1))

    h: float = dataclasses.field(init=False, repr=False)
    _per_metre: float = dataclasses.field(init=False, repr=False)
    _last: float = dataclasses.field(init=False, repr=False)

    # -- making one ---------------------------------------------------------------------------------------------

    @classmethod
    def from_waypoints(
        cls, xy: ArrayLike, *, closed: bool, smoothing: float = 0.0, spacing: float = 1.0, name: str = "path"
    ) -> Self:
        """The smooth path through (or, with `smoothing`, near) waypoints in their order.

        A quintic spline over the chord length, interpolating or with sum |c(u_i) - p_i|^2 <= n*smoothing^2
        (Dierckx 1982, periodic if closed), is sampled evenly in arc length and interpolated there.

        xy: (n, 2) [m], n >= 2 open, n >= 6 closed; the first point may be repeated at the end of a closed path.
        smoothing [m]: RMS distance that the path may keep from the waypoints; 0 for exact points, about the
        position noise for recorded ones. spacing [m]: longest segment; a few to the tightest radius is enough.
        Raises ValueError: wrong shape, too few, non-finite or repeated points, degrees instead of metres, ends that
        do not meet although closed, a curve that folds back, or detail too fine for `spacing`.
        """
        where = f"Path '{name}'"
        points = checked(np.asarray(xy, dtype=float), where)
        given = f"smoothing {smoothing} [m], spacing {spacing} [m]"
        fits = 0.0 <= smoothing < math.inf and 0.0 < spacing < math.inf
        require(fits, where, f"{given}, expected smoothing >= 0 and spacing > 0")
        if closed:
            points = ring(points, where)
        u = travelled(points)
        curve, end = _spline(u, points, min(_DEGREE, len(points) - 1), closed, smoothing), float(u[-1])
        for _ in range(4):  # until the parameter is the arc length
            curve, end, n = _even(curve, end, closed, spacing, where)
        h = end / n
        uneven = float(np.abs(np.hypot(*curve((np.arange(8 * n) + 0.5) * h / 8.0, 1).T) - 1.0).max())
        what = f"arc length is uneven by {uneven:.2g}, expected at most {_UNEVEN:g}: a bend is too tight for spacing"
        require(uneven <= _UNEVEN, where, f"{what} {h:.3g} [m]; {_FINER}")
        middle = (np.arange(n) + 0.5) * h
        rows = np.stack([curve(middle, k) / math.factorial(k) for k in range(_DEGREE + 1)])  # (k, n, xy)
        return cls(table=Table(rows.transpose(1, 2, 0).reshape(n, -1)), length=end, closed=closed, name=name)

    @classmethod
    def from_gps(
        cls,
        lat_deg: ArrayLike,
        lon_deg: ArrayLike,
        *,
        closed: bool,
        smoothing: float = 0.1,
        spacing: float = 1.0,
        name: str = "path",
    ) -> Self:
        """The path along WGS84 positions, in metres east (x) and north (y) of the first one.

        The local tangent plane (ENU) keeps distances to 1e-6 over a few kilometres, which UTM does not.

        lat_deg, lon_deg: (n,) [degrees]. The rest as `from_waypoints`, whose errors it raises, and ValueError for
        positions that are out of range, swapped or in radians.
        """
        columns = {"lat": np.asarray(lat_deg, dtype=float), "lon": np.asarray(lon_deg, dtype=float)}
        xy, origin = placed(columns, f"Path '{name}'")
        path = cls.from_waypoints(xy, closed=closed, smoothing=smoothing, spacing=spacing, name=name)
        return dataclasses.replace(path, origin_deg=origin)

    def reversed(self) -> "Path":
        """The same curve driven the other way; what was left is right."""
        flip = np.tile([1.0, -1.0], _DEGREE + 1)  # w -> -w
        return dataclasses.replace(self, table=Table(self.table.rows[::-1] * flip))

    # -- evaluating ---------------------------------------------------------------------------------------------

    def frame(self, s: Scalar) -> tuple[Scalar, ...]:
        """(x, y, x', y', x'', y'') at `s` within [0, length]: one table row and two polynomials; any backend."""
        i = m.minimum(m.floor(s * self._per_metre), self._last)  # at a knot either neighbour is as good
        row = self.table(i)
        w = s - (i + 0.5) * self.h
        (x, dx, ddx), (y, dy, ddy) = _quintic(w, *row[:6]), _quintic(w, *row[6:])
        return x, y, dx, dy, ddx, ddy

    def inside(self, s: Scalar) -> Scalar:
        """`s` [m] brought to the path: wrapped into [0, length] if closed, else clamped to it."""
        if self.closed:
            return s - self.length * m.floor(s / self.length)
        return m.clip(s, 0.0, self.length)

    def back(self, s: Scalar) -> Scalar:
        """The same for an `s` [m] at most one length outside, without a division."""
        if self.closed:
            s = m.where(s < 0.0, s + self.length, s)
            return m.where(s >= self.length, s - self.length, s)
        return m.clip(s, 0.0, self.length)

    def point(self, s: Any) -> Any:
        """Position [m] at s [m] (wrapped or clamped): (2,) for a float, (n, 2) for an array."""
        x, y, *_ = self.frame(self.inside(_number(s)))
        return np.stack((x, y), axis=-1)

    def psi(self, s: Any) -> Any:
        """Heading [rad] in [-pi, pi] at s [m] (wrapped or clamped)."""
        _, _, dx, dy, *_ = self.frame(self.inside(_number(s)))
        return m.atan2(dy, dx)

    def kappa(self, s: Any) -> Any:
        """Curvature [1/m], + = left, at s [m] (wrapped or clamped); floats, arrays or symbols."""
        _, _, dx, dy, ddx, ddy = self.frame(self.inside(_number(s)))
        return dx * ddy - dy * ddx

    # -- as arrays ----------------------------------------------------------------------------------------------

    @cached_property
    def samples(self) -> "Path.Samples":
        """The path at its knots: `s`, `xy`, `psi` (unwrapped), `kappa`, each with n + 1 entries, both ends in."""
        s = np.linspace(0.0, self.length, len(self.table) + 1)
        x, y, dx, dy, ddx, ddy = self.frame(s)
        psi = np.unwrap(np.arctan2(dy, dx))
        found = Path.Samples(s=s, xy=np.column_stack((x, y)), psi=psi, kappa=dx * ddy - dy * ddx)
        for array in found:
            array.flags.writeable = False
        return found

    class Samples(NamedTuple):
        """A path as arrays: s (n,) [m], xy (n, 2) [m], psi (n,) [rad], kappa (n,) [1/m]; read-only."""

        s: Array
        xy: Array
        psi: Array
        kappa: Array

    def to_csv(self, file: str | File) -> None:
        """Write s, x, y, psi, kappa at the knots; `read_course` reads the curve back, with a knot a metre."""
        write_text(file, self.csv_text())

    def csv_text(self, more: Mapping[str, Array] | None = None, units: str = "", comments: Sequence[str] = ()) -> str:
        """What `to_csv` writes, with `more` columns at the knots, their `units`, and `comments` after the first."""
        k = self.samples
        columns = {"s": k.s, "x": k.xy[:, 0], "y": k.xy[:, 1], "psi": k.psi, "kappa": k.kappa, **(more or {})}
        rows = np.column_stack([*columns.values()])[: -1 if self.closed else None]
        head = f"{self.name}: {'closed' if self.closed else 'open'} path, {self.length:.9g} m; m, rad, 1/m{units}"
        lines = [f"# {text}" for text in (head, *comments)] + [",".join(columns)]
        return "\n".join([*lines, *(",".join(f"{value:.9f}" for value in row) for row in rows), ""])

    def __repr__(self) -> str:
        at = ", at {:.5f}, {:.5f} deg".format(*self.origin_deg) if self.origin_deg else ""
        return f"Path('{self.name}', {'closed' if self.closed else 'open'}, {self.length:.1f} m{at})"


def _quintic(w: Scalar, a0: Scalar, a1: Scalar, a2: Scalar, a3: Scalar, a4: Scalar, a5: Scalar) -> tuple[Scalar, ...]:
    """A polynomial's value, slope and second derivative at w, by Horner's scheme for all of them at once."""
    p = a5 * w + a4
    q = a5 * w + p
    r = a5 * w + q
    p = p * w + a3
    q = q * w + p
    r = r * w + q
    p = p * w + a2
    q = q * w + p
    second = 2.0 * (r * w + q)
    p = p * w + a1
    return p * w + a0, q * w + p, second


def _number(s: Any) -> Any:
    """Lists as arrays and whole numbers as floats; floats, arrays and symbols as they are."""
    if isinstance(s, int | np.number):
        return float(s)
    return np.asarray(s, dtype=float) if isinstance(s, list | tuple) else s


def _spline(u: Array, points: Array, degree: int, closed: bool, smoothing: float = 0.0) -> Any:
    """Spline c(u) of odd degree (or one polynomial), through the points or near them."""
    from scipy import interpolate

    if smoothing > 0.0 and len(points) > 3:
        odd = degree - 1 + degree % 2
        (t, c, k), _ = interpolate.splprep(points.T, u=u, s=len(points) * smoothing**2, k=odd, per=closed)
        return interpolate.BSpline(t, np.asarray(c).T, k)
    return interpolate.make_interp_spline(u, points, k=degree, bc_type="periodic" if closed else None)


def _even(curve: Any, end: float, closed: bool, spacing: float, where: str) -> tuple[Any, float, int]:
    """The curve interpolated at n + 1 points even in its arc length, which becomes its parameter; its length; n."""
    from scipy.interpolate import CubicHermiteSpline

    cells = max(8 * _FEWEST_SEGMENTS, math.ceil(8.0 * end / spacing))
    u, cell = np.linspace(0.0, end, cells + 1, retstep=True)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    inner = u[:-1, None] + 0.5 * cell * (1.0 + nodes)
    speed = np.hypot(*np.moveaxis(curve(inner, 1), -1, 0))
    if float(speed.min()) < 1e-2:
        x, y = curve(inner.flat[int(speed.argmin())])
        raise ValueError(f"{where}: folds back on itself near ({x:.2f}, {y:.2f}) [m]; check the order of the waypoints")
    s = np.concatenate(([0.0], np.cumsum(0.5 * cell * speed @ weights)))
    length = float(s[-1])
    n = max(_FEWEST_SEGMENTS, math.ceil(length / spacing - 1e-9))
    knots = np.linspace(0.0, length, n + 1)
    points = curve(np.clip(CubicHermiteSpline(s, u, 1.0 / np.hypot(*curve(u, 1).T))(knots), 0.0, end))
    if closed:
        points[-1] = points[0]
    even = _spline(knots, points, _DEGREE, closed)
    off = np.hypot(*(even(s) - curve(u)).T)
    if float(off.max()) > _OFF * length / n:
        x, y = curve(u[off.argmax()])
        what = f"too fine for spacing {length / n:.3g} [m] ({off.max():.2g} m are lost)"
        raise ValueError(f"{where}: has detail near ({x:.2f}, {y:.2f}) [m] {what}; {_FINER}")
    return even, length, n
