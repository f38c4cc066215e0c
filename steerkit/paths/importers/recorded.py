"""Tracks that somebody recorded on the way: where the car stood, gaps, rounds, and how fast it went."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.paths.importers.course import Line, distinct
from steerkit.paths.waypoints import distances, travelled

Array = NDArray[np.float64]

_STOOD = 5.0
"""A car that moves less than the noise allows within this time stands [s]."""
_LOST = 5.0
"""A receiver that says nothing for this long has lost the way [s], if the car has moved by `_MOVED` meanwhile [m]."""
_MOVED = 30.0
_FIT = 9.0
"""The speed is the slope of the distance over this time [s]."""
_LEAST_ROUND = 60.0
"""A round is this long at least [m]."""
_FASTEST = 100.0
"""[m/s]; what seems faster is a wrong position."""


def cleaned(xy: Array, t: Array | None, v: Array | None, noise: float, where: str) -> tuple[Line, tuple[str, ...]]:
    """The points of a track that tell where the way is, with the speed at each, and what was left out.

    xy (n, 2) [m]; t (n,) [s] or None; v (n,) [m/s], NaN where the receiver does not say, or None. Where the car stood,
    one point of many is left. Raises ValueError for gaps, for times that do not rise and for jumps that no car makes.
    """
    notes: list[str] = []
    if t is None or not np.isfinite(t).all():
        _check_jumps(xy, where)
        return distinct(Line(xy=xy), where), ()
    steps = np.diff(t)
    back = np.flatnonzero(steps < 0.0)
    require(not back.size, where, f"time runs back after point {back[0] if back.size else 0}: two drives in one track?")
    new = np.concatenate(([True], steps > 0.0))
    xy, t = xy[new], t[new]
    v = None if v is None else v[new]
    moved, steps = distances(xy), np.diff(t)
    require(len(t) >= 4, where, f"{len(t)} points with times of their own, expected 4 or more")
    speed = (moved - min(6.0 * noise, 30.0)) / steps
    if speed.max() > _FASTEST:
        k = int(speed.argmax())
        raise ValueError(
            f"{where}: point {k + 1} is {moved[k]:.0f} m from the one {steps[k]:.2g} s before: a wrong position"
        )
    usual = float(np.median(steps))
    lost = np.flatnonzero((steps > max(_LOST, 3.0 * usual)) & (moved > _MOVED + 6.0 * noise))
    if lost.size:
        k = int(lost[0])
        what = (
            f"a gap of {steps[k]:.0f} s and {moved[k]:.0f} m after point {k} ({t[k] - t[0]:.0f} s from the beginning)"
        )
        raise ValueError(f"{where}: {what}: the receiver had lost the way; record that stretch again, at 1 Hz or more")
    _check_jumps(xy, where)
    kept = _moving(xy, t, noise)
    if not kept.all():
        notes.append(f"left out {int((~kept).sum())} of {len(kept)} points, recorded while the car stood")
    driven = _speeds(xy, t, v, kept)
    line = Line(xy=xy[kept], v=driven[kept])
    return distinct(line, where), tuple(notes)


def _check_jumps(xy: Array, where: str) -> None:
    """ValueError for a single point far from the way between its neighbours."""
    if len(xy) < 8:
        return
    step = distances(xy)
    usual = float(np.median(step))
    off = np.hypot(*(xy[1:-1] - 0.5 * (xy[:-2] + xy[2:])).T)
    direct = np.hypot(*(xy[2:] - xy[:-2]).T)
    bad = np.flatnonzero((off > 12.0 * max(usual, 1.0)) & (off > 3.0 * direct)) + 1
    if bad.size:
        x, y = xy[bad[0]]
        what = f"point {bad[0]}, ({x:.0f}, {y:.0f}) [m], is {off[bad[0] - 1]:.0f} m beside its neighbours"
        raise ValueError(f"{where}: {what}: a wrong position; leave it out")


def _moving(xy: Array, t: Array, noise: float) -> NDArray[np.bool_]:
    """All points but those recorded while the car stood; of each stop the first is kept."""
    kept = np.ones(len(t), dtype=bool)
    reach = max(4.0 * noise, 0.5)
    k = 0
    while k < len(t) - 1:
        last = k
        while last + 1 < len(t) and math.dist(xy[last + 1], xy[k]) < reach:
            last += 1
        if t[last] - t[k] >= _STOOD:
            kept[k + 1 : last + 1] = False
            k = last + 1
        else:
            k += 1
    return kept


def _speeds(xy: Array, t: Array, v: Array | None, kept: NDArray[np.bool_]) -> Array:
    """Speed at each point: as the receiver says; else the slope of the distance over some seconds."""
    if v is not None and np.isfinite(v).all():
        return np.asarray(v)
    out = np.empty(len(t))
    for k in range(len(t)):
        near = np.flatnonzero(np.abs(t - t[k]) <= max(0.5 * _FIT, 1.5 * float(np.median(np.diff(t)))))
        # the chord's length grows with noise at every step, a straight fit through the positions does not
        dt = t[near] - t[near].mean()
        slope = (dt @ xy[near]) / (dt @ dt)
        out[k] = math.hypot(*slope)
    return out


def rounds(line: Line, noise: float, which: int | None, where: str) -> tuple[Line, bool, tuple[str, ...]]:
    """The line cut to one round, if it comes back to its beginning in the direction in which it left.

    which: the first round, the second ...; None: the first, if there is one. Returns whether it is a round.
    Raises ValueError for a round that was not driven.
    """
    begins = [0, *_returns(line.xy, noise)]
    found = len(begins) - 1
    if which is None and not found:
        return line, False, ()
    number = which or 1
    require(1 <= number <= found, where, f"lap {number}, but it has {found or 'no'} whole rounds")
    part = line.part(slice(begins[number - 1], begins[number]))
    left = len(line.xy) - len(part.xy)
    told = f"round {number} of {found}: points {begins[number - 1]} to {begins[number] - 1}, {left} others left out"
    return part, True, (told,) if left else ()


def _returns(xy: Array, noise: float) -> list[int]:
    """The points at which a track has come round to its beginning: the nearest of each visit, going the same way."""
    steps = distances(xy)
    usual = float(np.median(steps))
    s = travelled(xy)
    reach = max(5.0, 4.0 * noise, 1.5 * usual)
    ahead = min(int(np.searchsorted(s, max(10.0, 6.0 * noise))), len(xy) - 1)
    away = xy[ahead] - xy[0]
    distance = np.hypot(*(xy - xy[0]).T)
    found, k = list[int](), int(np.searchsorted(s, _LEAST_ROUND))
    while k < len(xy):
        if distance[k] > reach:
            k += 1
            continue
        end = k
        while end < len(xy) and distance[end] <= reach:
            end += 1
        before = max(0, int(np.searchsorted(s, s[k] - max(10.0, 6.0 * noise))))
        if (xy[min(end, len(xy) - 1)] - xy[before]) @ away > 0.0:
            short = (0.4 * usual + noise) * float(np.hypot(*away))  # the last point of a round lies before the first
            passed = np.flatnonzero((xy[k:end] - xy[0]) @ away >= -short)
            found.append(k + int(passed[0]) if passed.size else end)
        k = max(end, int(np.searchsorted(s, s[k] + _LEAST_ROUND)))
    return [n for n in found if n >= 6]
