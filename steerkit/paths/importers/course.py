"""A course from a file: its path, the speeds that came with it, and what was done to get it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit._support.files import write_text
from steerkit.paths.importers.smoothing import smoothed
from steerkit.paths.path import Path
from steerkit.paths.waypoints import distances, travelled

Array = NDArray[np.float64]

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
    """Speed that was driven there (n,) [m/s]; None: nobody says."""
    v_limit: Array | None = None
    """Speed that is allowed there (n,) [m/s], NaN where nothing is said."""

    def part(self, kept: NDArray[np.bool_] | slice) -> Line:
        """Some of the points."""
        v, limit = (None if a is None else a[kept] for a in (self.v, self.v_limit))
        return Line(xy=self.xy[kept], v=v, v_limit=limit)

    def backwards(self) -> Line:
        """The other way round; what was driven was not driven so."""
        limit = None if self.v_limit is None else self.v_limit[::-1]
        return Line(xy=self.xy[::-1], v_limit=limit)

    def dense(self, step: float = DENSE) -> Line:
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

    v and v_limit are at the path's knots (`path.samples.s`), None where the file has none; v_limit is NaN where nothing
    is said.
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
        """Write it; `--course FILE`, `steerkit.paths.courses.course_of` and this package read it back."""
        write_text(file, self.text())


def laid(
    line: Line,
    *,
    name: str,
    noise: float,
    closed: bool,
    drawn: bool,
    tightest: float = TIGHTEST,
    notes: tuple[str, ...] = (),
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
    check_spikes(line.xy, noise, name)
    if drawn:
        line = line.dense() if noise > 0.0 else line
    remarks = list(notes)
    if noise > 0.0 and len(line.xy) > 8:
        curve, end, u, shown = smoothed(line.xy, noise, closed=closed)
        count = max(12, round(end))
        fine = curve(np.linspace(0.0, end, count + 1)[: -1 if closed else None])
        remarks.append(f"smoothed by noise = {noise:g} m: the points lie {shown:.2g} m beside the curve (RMS)")
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
    v, limit = (_along(path, s, a) for a in (line.v, line.v_limit))
    return Course(path=path, v=v, v_limit=limit, notes=tuple(remarks))


def distinct(line: Line, name: str) -> Line:
    """Without points that repeat the one before; raises ValueError for numbers that are none, and for less than two."""
    bad = np.flatnonzero(~(np.isfinite(line.xy).all(axis=1) & (np.abs(line.xy) < 1e8).all(axis=1)))
    if bad.size:
        raise ValueError(
            f"{name}: point {bad[0]} is at {tuple(line.xy[bad[0]].tolist())} [m], expected numbers below 1e8"
        )
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


def check_spikes(xy: Array, noise: float, name: str) -> None:
    """ValueError for a single point that lies beside a line that is smooth without it."""
    if len(xy) < 6:
        return

    def turns(points: Array) -> Array:
        heading = np.unwrap(np.arctan2(*np.diff(points, axis=1).transpose(2, 0, 1)[::-1]), axis=-1)
        return np.abs(np.diff(heading, axis=1)).sum(axis=1)

    five = np.stack([xy[k : len(xy) - 4 + k] for k in range(5)], axis=1)
    less = turns(five) - turns(five[:, [0, 1, 3, 4]])
    a, p, b = five[:, 1], five[:, 2], five[:, 3]
    chord = b - a
    cross = chord[:, 0] * (p - a)[:, 1] - chord[:, 1] * (p - a)[:, 0]
    beside = np.abs(cross) / np.maximum(np.hypot(*chord.T), 1e-9)
    bad = np.flatnonzero((less > _SPIKE) & (beside > max(6.0 * noise, SAME)))
    if bad.size:
        k = int(bad[0]) + 2
        what = (
            f"point {k}, ({xy[k, 0]:.1f}, {xy[k, 1]:.1f}) [m], lies {beside[k - 2]:.1f} m beside its neighbours' line"
        )
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


def _along(path: Path, s: Array, values: Array | None) -> Array | None:
    """Values at the points of a line, at the path's knots."""
    if values is None or not np.isfinite(values).any():
        return None
    knots = path.samples.s
    if np.isfinite(values).all():
        return np.interp(knots, s, values)
    nearest = np.clip(np.searchsorted(s, knots + 1e-9, side="right") - 1, 0, len(s) - 1)
    return values[nearest]
