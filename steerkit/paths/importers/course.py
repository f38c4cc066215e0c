"""A course from a file: its path, the speeds that came with it, and what was done to get it."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit._support.files import write_text
from steerkit.diagram.maths import Array
from steerkit.paths.path import Path
from steerkit.paths.waypoints import (
    check_metres,
    check_stated,
    checked,
    distances,
    placed,
    read_columns,
    stated,
    travelled,
)

TIGHTEST = 4.1
"""Tightest radius that is driven [m], unless a car is named: the shipped Passat's, its wheel at the stop."""
SAME = 0.01
"""Neighbouring points closer than this are one [m]."""
DENSE = 1.0
"""What was drawn with straights between its points gets one so often [m]."""
SHORTEST, LONGEST = 10.0, 200_000.0
"""Least and greatest length of a course [m]."""
_SPIKE = 0.3
"""A point without which its neighbours turn by so much less [rad] may be a wrong one."""
SHARP = 2.0
"""What was drawn turns by no more than this at one point [rad]; beyond, it turns back."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Line:
    """Points along a road or track in the order that they are driven, before anything is smoothed."""

    xy: Array
    """(n, 2) [m]."""
    v: Array | None = None
    """Speed that was driven there (n,) [m/s]; None: unknown."""
    v_limit: Array | None = None
    """Speed that is allowed there (n,) [m/s], NaN where nothing is said."""

    def part(self, kept: NDArray[np.bool_] | slice) -> "Line":
        """Some of the points."""
        v, limit = (None if a is None else a[kept] for a in (self.v, self.v_limit))
        return Line(xy=self.xy[kept], v=v, v_limit=limit)

    def backwards(self) -> "Line":
        """The other way round; what was driven was not driven so."""
        limit = None if self.v_limit is None else self.v_limit[::-1]
        return Line(xy=self.xy[::-1], v_limit=limit)

    def dense(self, step: float = DENSE) -> "Line":
        """With points between the points, so that none is more than `step` [m] from the next."""
        steps, s = distances(self.xy), travelled(self.xy)
        counts = np.ceil(steps / step).astype(int)
        at = np.concatenate([*(a + b / k * np.arange(k) for a, b, k in zip(s, steps, counts)), s[-1:]])
        xy = np.column_stack([np.interp(at, s, column) for column in self.xy.T])
        nearest = np.minimum(np.searchsorted(s, at + 1e-9, side="right") - 1, len(s) - 1)
        v, limit = (None if a is None else a[nearest] for a in (self.v, self.v_limit))
        return Line(xy=xy, v=v, v_limit=limit)


@dataclass(frozen=True, eq=False, kw_only=True)
class Course:
    """A path with the speeds along it, as `read_course` makes it of a file.

    v and v_limit are at the path's knots (`path.samples.s`), None where the file has none; NaN in v_limit: not said.
    """

    path: Path
    v: Array | None
    """Speed that was driven (n,) [m/s]."""
    v_limit: Array | None
    """Speed that is allowed (n,) [m/s]."""
    notes: tuple[str, ...]
    """What was chosen, left out, assumed and smoothed, in words."""

    def text(self) -> str:
        """The course as the text of a CSV file: s, x, y, psi, kappa, and v, v_limit where there are any."""
        speeds = {name: a for name, a in (("v", self.v), ("v_limit", self.v_limit)) if a is not None}
        origin = self.path.origin_deg
        place = [] if origin is None else ["origin {:.9f}, {:.9f} deg".format(*origin)]
        return self.path.csv_text(speeds, ", m/s", [*place, *(" ".join(note.split()) for note in self.notes)])

    def to_csv(self, file: str) -> None:
        """Write it; `read_course` reads it back."""
        write_text(file, self.text())


def course_of(text: str, name: str, *, closed: bool | None = None) -> Path:
    """The course in the text of a CSV file whose header names x and y [m], or lat and lon [degrees], called `name`.

    `#` starts a comment. The path leads through points x, y, and near lat, lon, by 0.1 m RMS.
    closed: None means as the file says, if `Path.to_csv` wrote it; else closed if its ends are no farther apart than
    5 m or three of its steps. Raises ValueError for a broken file, naming it, and for one that is cut short.
    """
    return path_in(text, read_columns(text, name), name, closed)


def path_in(text: str, columns: Mapping[str, Array], name: str, closed: bool | None) -> Path:
    """The same, of a text whose columns have been read."""
    said = stated(text)
    xy, origin = placed(columns, name)
    if closed is None and not said:
        near = max(5.0, 3.0 * float(np.median(distances(xy)))) if len(xy) > 2 else 0.0
        closed = math.dist(xy[0], xy[-1]) <= near
    closed = said[0] if said and closed is None else bool(closed)
    if origin is None:
        check_metres(checked(xy, name), name)
    smoothing = 0.0 if origin is None else 0.1
    path = Path.from_waypoints(xy, closed=closed, smoothing=smoothing, name=name.removesuffix(".csv"))
    if said and closed == said[0]:
        check_stated(said[1], path.length, 0.05 + 1e-4 * path.length, name)
    place = re.search(r"^# origin (-?[\d.]+), (-?[\d.]+) deg$", text, re.MULTILINE)
    return replace(path, origin_deg=(float(place[1]), float(place[2])) if place else origin)


def laid(
    line: Line,
    *,
    name: str,
    noise: float,
    closed: bool,
    drawn: bool,
    tightest: float = TIGHTEST,
    notes: Sequence[str] = (),
    origin_deg: tuple[float, float] | None = None,
    hint: str = "",
) -> Course:
    """The course along a line, smoothed by its noise, or ValueError with the place and the reason why it has none.

    noise [m]: standard deviation of the points across the way; 0: exact. drawn: the line runs straight between its
    points; else they were recorded one after the other on a smooth way. tightest [m]: least radius of the car. hint:
    what else may help where it bends too much.
    """
    line = distinct(line, name)
    if closed and math.dist(line.xy[0], line.xy[-1]) < SAME:
        line = line.part(slice(0, -1))
    total = float(distances(line.xy).sum())
    require(SHORTEST <= total <= LONGEST, name, f"is {total:.1f} m long, expected {SHORTEST:g} to {LONGEST:g} m")
    if drawn:
        check_turns(line.xy, name)
    check_spikes(line.xy, noise, name, drawn=drawn)
    if drawn:
        line = line.dense() if noise > 0.0 else line
    remarks = list(notes)
    if noise > 0.0 and len(line.xy) > 8:
        curve, end, u, shown = smoothed(line.xy, noise, closed=closed)
        wound = f"smoothed by noise = {noise:g} m it is {end:.0f} m long, but from point to point {total:.0f} m"
        require(end <= 2.0 * total, name, f"{wound}: points out of order or wrong? Leave them out, or give more noise")
        count = max(12, round(end))
        fine = curve(np.linspace(0.0, end, count + 1)[: -1 if closed else None])
        beside = np.hypot(*(line.xy - curve(u[: len(line.xy)])).T)
        most, at = float(beside.max()), "({:.1f}, {:.1f})".format(*line.xy[beside.argmax()])
        beside_it = f"{shown:.2g} m beside the curve (RMS), {most:.2g} m at most, at {at} [m]"
        remarks.append(f"smoothed by noise = {noise:g} m: the points lie {beside_it}")
    else:
        fine, u = line.xy, travelled(line.xy)
        end = float(u[-1]) + (math.dist(line.xy[0], line.xy[-1]) if closed else 0.0)
    try:
        path = Path.from_waypoints(fine, closed=closed, name=name)
    except ValueError as error:
        what = str(error).split("; give")[0].removeprefix(f"Path '{name}': ")
        raise ValueError(f"{name}: cannot be driven as it is: {what}{_smoother(noise)}{hint}") from error
    check_bends(path, tightest, f"{_smoother(noise)}{hint}")
    path = replace(path, origin_deg=origin_deg)
    s = u * (path.length / end)
    v, limit = (along(path, s, a) for a in (line.v, line.v_limit))
    return Course(path=path, v=v, v_limit=limit, notes=tuple(remarks))


def distinct(line: Line, name: str) -> Line:
    """Without points that repeat the one before; raises ValueError for numbers that are none, and for less than two."""
    bad = np.flatnonzero(~(np.isfinite(line.xy).all(axis=1) & (np.abs(line.xy) < 1e8).all(axis=1)))
    if bad.size:
        at = tuple(line.xy[bad[0]].tolist())
        raise ValueError(f"{name}: point {bad[0]} is at {at} [m], expected numbers below 1e8")
    kept, last = np.ones(len(line.xy), dtype=bool), line.xy[:1]
    steps = distances(line.xy)
    if (steps < SAME).any():
        for k in range(1, len(line.xy)):
            kept[k] = math.dist(line.xy[k], last[0]) >= SAME
            last = line.xy[k : k + 1] if kept[k] else last
    require(kept.sum() >= 2, name, f"{int(kept.sum())} distinct points, expected 2 or more")
    return line.part(kept)


def check_turns(xy: Array, name: str) -> None:
    """ValueError where a line that was drawn turns back on itself."""
    steps = np.diff(xy, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    turn = np.abs((np.diff(heading) + math.pi) % (2.0 * math.pi) - math.pi)
    if turn.max(initial=0.0) > SHARP:
        x, y = xy[int(turn.argmax()) + 1]
        what = f"turns by {turn.max():.1f} rad at one point, ({x:.1f}, {y:.1f}) [m]: a kink that no car drives"
        raise ValueError(f"{name}: {what}; choose a part without it, or a route along lanes")


def check_spikes(xy: Array, noise: float, name: str, *, drawn: bool = False) -> None:
    """ValueError for a single point that lies beside a line that is smooth without it.

    What is drawn may go in a zigzag of few points: its neighbours swing too, or it still turns by 0.3 of what it did.
    """
    if len(xy) < 6:
        return

    def turns(points: Array) -> Array:
        heading = np.unwrap(np.arctan2(*np.diff(points, axis=1).transpose(2, 0, 1)[::-1]), axis=-1)
        return np.diff(heading, axis=1)

    five = np.stack([xy[k : len(xy) - 4 + k] for k in range(5)], axis=1)
    bends = turns(five)
    all_of_it, rest = (np.abs(some).sum(axis=1) for some in (bends, turns(five[:, [0, 1, 3, 4]])))
    to_and_fro = np.minimum(-bends[:, 0] * bends[:, 1], -bends[:, 1] * bends[:, 2])  # two corners of a street are not
    swing = np.pad(to_and_fro / np.maximum(bends[:, 1] ** 2, 1e-12), 1)
    zigzag = drawn & ((np.maximum(swing[:-2], swing[2:]) > 0.45) | (rest > 0.3 * all_of_it))
    less = np.where((swing[1:-1] < 0.04) | zigzag, 0.0, all_of_it - rest)
    a, p, b = five[:, 1], five[:, 2], five[:, 3]
    chord = b - a
    cross = chord[:, 0] * (p - a)[:, 1] - chord[:, 1] * (p - a)[:, 0]
    beside = np.abs(cross) / np.maximum(np.hypot(*chord.T), 1e-9)
    beside[less <= _SPIKE] = 0.0
    k = int(beside.argmax())
    if beside[k] > max(6.0 * noise, SAME):
        x, y = p[k]
        what = f"point {k + 2}, ({x:.1f}, {y:.1f}) [m], lies {beside[k]:.1f} m beside its neighbours' line"
        raise ValueError(f"{name}: {what}: a wrong position? leave it out, or say how good positions are: noise=")


def _smoother(noise: float) -> str:
    """What to do about bends that may be noise."""
    worse = max(2.0 * noise, 0.1)
    return f"; if the points are no better than {worse:g} m, say so: noise={worse:g}"


def check_bends(path: Path, tightest: float, hint: str = "") -> None:
    """ValueError, with the place, where a path bends tighter than `tightest` [m]."""
    k = path.samples
    worst = int(np.abs(k.kappa).argmax())
    radius = 1.0 / max(float(np.abs(k.kappa).max()), 1e-9)
    if radius < tightest:
        x, y = k.xy[worst]
        what = f"bends to a radius of {radius:.2g} m at s = {k.s[worst]:.0f} m, ({x:.1f}, {y:.1f}) [m]"
        raise ValueError(f"{path.name}: {what}; the car's wheel does {tightest:.2g} m{hint}")


def along(path: Path, s: Array, values: Array | None) -> Array | None:
    """Values at the points of a line, at the path's knots."""
    if values is None or not np.isfinite(values).any():
        return None
    knots = path.samples.s
    if np.isfinite(values).all():
        return np.interp(knots, s, values)
    return values[np.maximum(np.searchsorted(s, knots + 1e-9, side="right") - 1, 0)]


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

    n = len(points)
    ring = np.vstack((points, points[:1])) if closed else points
    u = travelled(ring)
    along = np.gradient(ring, u, axis=0)[:n]
    for _ in range(3):
        at, end = u[:n], float(u.max())
        span = float(np.clip(max(np.median(np.diff(u)), 4.0 * noise), *_SPAN))
        cells = int(np.clip(math.ceil(end / span), 2 * _DEGREE, _MOST))
        h = end / cells
        knots = h * np.arange(-_DEGREE, cells + _DEGREE + 1)
        basis = BSpline.design_matrix(np.minimum(at, end * (1.0 - 1e-12)), knots, _DEGREE)
        wide = cells + _DEGREE
        third = diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(wide - 3, wide)) / h**2.5
        if closed:  # the last five coefficients are the first five again
            wrap = csr_matrix((np.ones(wide), (np.arange(wide), np.arange(wide) % cells)), shape=(wide, cells))
            basis, third = basis @ wrap, (third @ wrap)[:cells]
        beside = np.column_stack((-along[:, 1], along[:, 0])) / np.hypot(*along.T)[:, None]
        c, shown = _weighed(basis, third, points, beside, noise, end)
        curve = BSpline(knots, np.vstack((c, c[:_DEGREE])) if closed else c, _DEGREE)
        along = curve(at, 1)
        foot = np.clip(at + ((points - curve(at)) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, end)
        fine = np.linspace(0.0, end, 20 * cells + 1)
        u = np.interp(np.append(foot, end) if closed else foot, fine, travelled(curve(fine)))
        u -= 0.0 if closed else u.min()
    begin, last = (0.0, end) if closed else (float(foot.min()), float(foot.max()))
    return lambda z, order=0: curve(begin + z, order), last - begin, np.maximum.accumulate(foot - begin), shown


def _weighed(basis: Any, third: Any, points: Array, beside: Array, noise: float, end: float) -> tuple[Array, float]:
    """The coefficients for the largest weight of the penalty that keeps to the noise; and the noise that they show.

    third: gives the third derivatives, whose squares are the penalty. beside: direction across the way (n, 2).
    """
    from scipy.sparse.linalg import splu

    basis, third = basis.tocsr(), third.tocsr()
    basis_t, third_t = basis.T.tocsr(), third.T.tocsr()
    n, normal, penalty = len(points), (basis_t @ basis).tocsc(), (third_t @ third).tocsc()
    centre = points.mean(axis=0)
    near = points - centre
    wanted = basis_t @ near

    def solved(log_weight: float) -> tuple[Array, float, float]:
        """Coefficients, by how much their residual is more than the noise's, and the noise that they show."""
        weight = math.exp(log_weight)
        factors = splu(normal + weight * penalty)
        c = factors.solve(wanted)
        for _ in range(2):  # what rounding has left of a stiff curve's equations
            c += factors.solve(basis_t @ (near - basis @ c) - weight * (third_t @ (third @ c)))
        residual = float(((beside * (basis @ c - near)).sum(axis=1) ** 2).sum())
        free = end / (3.0 * (weight * end / n) ** (1.0 / 6.0))
        left = max(n - free, 0.1 * n)
        return c, residual - noise**2 * left * (1.0 + 2.0 * math.sqrt(2.0 / n)), math.sqrt(residual / left)

    ratio = float(normal.diagonal().mean() / penalty.diagonal().mean())
    low, high = math.log(_SOFTEST * ratio), math.log(_STIFFEST * ratio)
    for _ in range(16):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if solved(middle)[1] > 0.0 else (middle, high)
    c, _, shown = solved(low)
    return c + centre, shown
