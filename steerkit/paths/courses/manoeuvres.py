"""Test manoeuvres as open courses along +x: lane changes, slalom, step in curvature."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from steerkit._support.errors import require
from steerkit.diagram.units import radians_of
from steerkit.paths.path import Path
from steerkit.task import A_Y_MAX

_STEEPEST = 10.0 / math.sqrt(3.0)
"""Largest z'' of 10 z^3 - 15 z^4 + 6 z^5."""
_RUN = 30.0
"""Straight before and after a manoeuvre [m]."""
_WIDTH = 1.82
"""Width of the car that ISO 3888-2 asks for [m]: a VW Passat's."""
_ISO_3888 = {
    1: ((15.0, 30.0, 25.0, 25.0, 15.0 + 15.0), 3.5),
    2: ((12.0, 13.5, 11.0, 12.5, 12.0), 1.0 + 0.5 * (1.1 * _WIDTH + 0.25 + _WIDTH + 1.0)),
}
"""Lengths of the five sections and sideways distance of the lanes' centres [m]."""


def lane_change(part: int = 1, *, speed: float = 9.0, a_y: float = A_Y_MAX, name: str = "") -> Path:
    """The double lane change of ISO 3888-1, or the obstacle avoidance of ISO 3888-2, scaled in length to a speed.

    There and back between the lanes' centres, over sections in the standard's proportions,

        y = h (10 z^3 - 15 z^4 + 6 z^5),  z = distance/length of the transition,

    all sections stretched alike until the shorter transition has v^2 y'' = a_y at its steepest: length =
    v sqrt(5.77 h/a_y). The standards' own lengths at 80 km/h would ask 16 (part 1) and 65 m/s^2 of this centre line: a
    driver there uses the width of the lanes, and the test has no path.

    part: 1 or 2. speed [m/s], a_y [m/s^2] > 0. Raises ValueError for others.
    Source: ISO 3888-1:2018, ISO 3888-2:2011 (sections, offset; widths for a car of 1.82 m).
    """
    where = f"lane_change '{name or part}'"
    require(part in _ISO_3888, where, f"part {part!r} of ISO 3888; valid: 1, 2")
    require(0.0 < speed < math.inf and 0.0 < a_y < math.inf, where, f"speed {speed} [m/s], a_y {a_y} [m/s^2], > 0")
    sections, h = _ISO_3888[part]
    stretch = speed * math.sqrt(_STEEPEST * h / a_y) / min(sections[1], sections[3])
    entry, first_change, offset_lane, second_change, exit_lane = (stretch * length for length in sections)
    plan = [(_RUN + entry, 0.0), (first_change, h), (offset_lane, h), (second_change, 0.0), (exit_lane + _RUN, 0.0)]
    return _through(plan, name or f"iso3888-{part}")


def slalom(cones: int = 7, *, spacing: float = 18.0, offset: float = 1.0, name: str = "slalom") -> Path:
    """A slalom round `cones` cones `spacing` [m] apart, passing them `offset` [m] to the left and right in turn.

    |kappa| <= 5.77 offset_change/spacing^2, offset_change = 2 offset: 0.036/m by default, 2.9 m/s^2 at 9 m/s.
    Raises ValueError for no cones or sizes that are not positive.
    """
    require(cones >= 1, f"slalom '{name}'", f"cones = {cones}, expected >= 1")
    require(spacing > 0.0 and offset > 0.0, f"slalom '{name}'", f"spacing {spacing}, offset {offset} [m], expected > 0")
    swings = [(spacing, offset * (1.0 if k % 2 == 0 else -1.0)) for k in range(cones)]
    return _through([(_RUN, 0.0), *swings, (spacing, 0.0), (_RUN, 0.0)], name)


def curvature_step(radius: float = 27.0, *, turn_deg: float = 180.0, name: str = "curvature-step") -> Path:
    """A straight of 30 m that becomes a circular arc to the left at once, and a straight again: steps in curvature.

    Curvature rises over about 0.5 m, between two knots of the path, and overshoots by a tenth. radius [m]: 27 m is
    3 m/s^2 at 9 m/s. turn_deg: how far round.
    Raises ValueError for a radius or turn that is not positive, or a turn beyond 330 degrees (it would meet itself).
    """
    where = f"curvature_step '{name}'"
    require(1.0 <= radius < math.inf, where, f"radius {radius} [m], expected >= 1")
    require(0.0 < turn_deg <= 330.0, where, f"turn_deg {turn_deg}, expected 0 to 330")
    turn = radians_of(turn_deg)
    n = math.ceil(4.0 * turn * radius)
    angle = np.linspace(0.0, turn, n + 1)
    arc = np.column_stack((_RUN + radius * np.sin(angle), radius * (1.0 - np.cos(angle))))
    along = np.arange(0.0, _RUN, 0.25)[:, None]
    end = arc[-1] + (along + 0.25) * np.array([math.cos(turn), math.sin(turn)])
    return Path.from_waypoints(
        np.vstack((along * np.array([1.0, 0.0]), arc, end)), closed=False, spacing=0.5, name=name
    )


def _through(plan: Sequence[tuple[float, float]], name: str) -> Path:
    """A path from (0, 0) along +x: each piece (length, y at its end) by a smooth step."""
    points, x, y = [np.zeros((1, 2))], 0.0, 0.0
    for length, to in plan:
        z = np.linspace(0.0, 1.0, math.ceil(2.0 * length) + 1)[1:]
        points.append(np.column_stack((x + length * z, y + (to - y) * z**3 * (10.0 - 15.0 * z + 6.0 * z**2))))
        x, y = x + length, to
    return Path.from_waypoints(np.vstack(points), closed=False, spacing=0.5, name=name)
