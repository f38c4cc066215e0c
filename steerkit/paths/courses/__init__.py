"""Built-in courses by name, courses from files, and courses by formula."""

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import known, require
from steerkit.diagram.maths import Array
from steerkit.diagram.units import radians_of
from steerkit.paths.path import Path
from steerkit.paths.waypoints import read_columns
from steerkit.task import A_Y_MAX

Bend = tuple[float, float, float, float]
"""Straight before the bend [m], turn [degrees, + = left], tightest radius [m], length of its ramps [m]."""


def paper() -> Path:
    """A closed course like that of the NFQ steering experiments: 795 m, seven left and four right bends.

    The tightest (5.9 m) asks 385 degrees of steering wheel of a VW Passat (wheelbase 2.71 m, ratio 15.6) before any
    slip; at 4 m/s there, a_y = 2.7 m/s^2. About 130 s a round at 4 to 7.5 m/s. Stretches stay 12.9 m apart.
    Source: designed to the figures that the experiment states; its true map is not published.
    """
    plan = np.loadtxt(str(files(__package__) / "paper.csv"), delimiter=",").tolist()
    return bends(plan, spacing=0.5, name="paper")


def circle(radius: float = 30.0, *, name: str = "circle") -> Path:
    """A circle of `radius` [m] from the origin along +x, turning left: centre (0, radius), kappa = 1/radius."""
    require(0.0 < radius < math.inf, f"circle '{name}'", f"radius {radius} [m], expected > 0")
    angle = np.linspace(0.0, 2.0 * math.pi, 240, endpoint=False)
    xy = radius * np.column_stack((np.sin(angle), 1.0 - np.cos(angle)))
    return Path.from_waypoints(xy, closed=True, spacing=min(1.0, radius / 10.0), name=name)


def straight(length: float = 500.0, *, name: str = "straight") -> Path:
    """An open straight of `length` [m] from the origin along +x."""
    require(0.1 <= length < math.inf, f"straight '{name}'", f"length {length} [m], expected >= 0.1")
    return Path.from_waypoints([(0.0, 0.0), (length, 0.0)], closed=False, name=name)


def figure_eight(size: float = 60.0, *, name: str = "figure-eight") -> Path:
    """A closed figure of eight, `size` [m] from tip to tip, from its right tip: Bernoulli's lemniscate.

    With a = size/2: x = a cos t/(1 + sin^2 t), y = x sin t; |kappa| = 3*sqrt(x^2 + y^2)/a^2 <= 6/size, zero where it
    crosses itself at a right angle; length 2.622*size.
    """
    require(0.0 < size < math.inf, f"figure_eight '{name}'", f"size {size} [m], expected > 0")
    t = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)
    x = 0.5 * size * np.cos(t) / (1.0 + np.sin(t) ** 2)
    xy = np.column_stack((x, x * np.sin(t)))
    return Path.from_waypoints(xy, closed=True, spacing=min(0.5, size / 100.0), name=name)


def random_course(seed: int, *, length: float = 500.0, max_kappa: float = 0.1, name: str = "") -> Path:
    """A random closed smooth course with left and right bends, driven left round, that never meets itself.

    In polar form radius ~ 1 + a sum_k c_k cos(k phi + phi_k), k = 2..7, c_k ~ normal/sqrt(k), scaled to `length`; a is
    the largest for which |kappa| <= max_kappa and radius >= 0.25 everywhere.

    seed: equal seeds give equal courses. length [m]: exact to 1e-4. max_kappa [1/m]: bound of |kappa|.
    Raises ValueError unless length*max_kappa >= 8: a circle already needs 2 pi.
    """
    fits = math.isfinite(length * max_kappa) and length > 0.0 and length * max_kappa >= 8.0
    given = f"length {length} [m] * max_kappa {max_kappa} [1/m]"
    require(fits, f"random_course {seed}", f"{given}, expected length > 0 and a product >= 8")
    rng = np.random.default_rng(seed)
    k = np.arange(2, 8)[:, None]
    weight, phase = rng.standard_normal(k.shape) / np.sqrt(k), rng.uniform(0.0, 2.0 * math.pi, k.shape)
    phi = np.linspace(0.0, 2.0 * math.pi, max(720, math.ceil(4.0 * length * max_kappa)), endpoint=False)
    terms = weight * np.exp(1j * (k * phi + phase))
    wave, slope, bend = terms.real.sum(0), -(k * terms.imag).sum(0), -(k * k * terms.real).sum(0)  # and d/dphi

    def tightness(a: float) -> float:
        """Largest |kappa| for total length 1; infinite where the course comes too near the middle."""
        r, r1, r2 = 1.0 + a * wave, a * slope, a * bend
        speed = np.hypot(r, r1)
        if float(r.min()) < 0.25:
            return math.inf
        return float((np.abs(r * r + 2.0 * r1 * r1 - r * r2) / speed**3).max() * speed.mean() * 2.0 * math.pi)

    low, high = 0.0, 4.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if tightness(middle) <= 0.99 * length * max_kappa else (low, middle)
    r = 1.0 + low * wave
    xy = np.column_stack((r * np.cos(phi), r * np.sin(phi)))
    around = np.hypot(r, low * slope).mean() * 2.0 * math.pi  # exact to rounding: a smooth periodic integrand
    spacing = min(1.0, 0.08 / max_kappa)
    return Path.from_waypoints(xy * length / around, closed=True, spacing=spacing, name=name or f"random-{seed}")


def bends(plan: Sequence[Bend], *, spacing: float = 1.0, name: str = "bends") -> Path:
    """A closed course of straights and bends from the origin along +x; curvature ramps up and down twice smoothly.

    In a ramp kappa = (10 z^3 - 15 z^4 + 6 z^5)/radius, z = distance/ramp. The straights are changed as little as
    possible (least squares) for the ends to meet.

    plan: one `Bend` each. Raises ValueError when the turns do not sum to +-360 degrees, a ramp is longer than its
    bend allows, or a straight would have to be negative.
    """
    where = f"bends '{name}'"
    total = sum(turn_deg for _, turn_deg, *_ in plan)
    require(abs(abs(total) - 360.0) < 1e-9, where, f"turns sum to {total:g} degrees, expected 360 or -360")
    headings, pieces, psi = [], [], 0.0
    for k, (_, turn_deg, radius, ramp) in enumerate(plan):
        turn = radians_of(turn_deg)
        long = f"bend {k}: ramp {ramp} [m], expected at most radius*turn = {abs(turn) * radius:.3g} m"
        require(0.0 <= ramp <= abs(turn) * radius or turn == 0.0, where, long)
        headings.append(psi)
        pieces.append(_bend(psi, turn, radius, ramp))
        psi += turn
    along = np.column_stack((np.cos(headings), np.sin(headings)))
    straights = np.array([straight for straight, *_ in plan])
    gap = straights @ along + sum(piece[-1] for piece in pieces)
    straights = straights - along @ np.linalg.lstsq(along.T @ along, gap, rcond=1e-9)[0]  # all may lie along one line
    open_by = float(np.hypot(*(straights @ along + sum(piece[-1] for piece in pieces))))
    require(open_by < 1e-6, where, f"no straights of these headings close it: {open_by:.3g} m are left open")
    lengths = np.round(straights, 1).tolist()
    require(bool((straights >= 0.0).all()), where, f"to close, straights become {lengths} [m], expected all >= 0")
    points, at = [], np.zeros(2)
    for piece, direction, straight in zip(pieces, along, straights):
        steps = np.linspace(0.0, straight, math.ceil(straight) + 1)[:-1]
        points += [at + steps[:, None] * direction, at + straight * direction + piece[:-1]]
        at = at + straight * direction + piece[-1]
    return Path.from_waypoints(np.vstack(points), closed=True, spacing=spacing, name=name)


def _bend(psi: float, turn: float, radius: float, ramp: float) -> NDArray[np.float64]:
    """Points of a bend from the origin, about 0.5 m apart, both ends included; just the origin if it turns by 0."""
    if turn == 0.0:
        return np.zeros((1, 2))
    from scipy.integrate import cumulative_simpson

    length = abs(turn) * radius + ramp
    s = np.linspace(0.0, length, 10 * math.ceil(2.0 * length) + 1)
    z = np.clip(np.minimum(s, length - s) / ramp, 0.0, 1.0) if ramp > 0.0 else np.ones_like(s)
    kappa = math.copysign(1.0 / radius, turn) * z**3 * (10.0 - 15.0 * z + 6.0 * z**2)
    heading = psi + cumulative_simpson(kappa, x=s, initial=0.0)
    return cumulative_simpson(np.stack((np.cos(heading), np.sin(heading))), x=s, initial=0.0).T[::10]


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


def lane_change(part: int = 1, *, speed: float = 9.0) -> Path:
    """The double lane change of ISO 3888-1, or the obstacle avoidance of ISO 3888-2, scaled in length to a speed.

    There and back between the lanes' centres, over sections in the standard's proportions,

        y = h (10 z^3 - 15 z^4 + 6 z^5),  z = distance/length of the transition,

    all sections stretched alike until the shorter transition has v^2 y'' = a_y = 3 m/s^2 at its steepest: length =
    v sqrt(5.77 h/a_y). The standards' own lengths at 80 km/h would ask 16 (part 1) and 65 m/s^2 of this centre line: a
    driver there uses the width of the lanes, and the test has no path.

    part: 1 or 2. speed [m/s] > 0. Raises ValueError for others.
    Source: ISO 3888-1:2018, ISO 3888-2:2011 (sections, offset; widths for a car of 1.82 m).
    """
    require(part in _ISO_3888, "lane_change", f"part {part!r} of ISO 3888; valid: 1, 2")
    require(0.0 < speed < math.inf, "lane_change", f"speed {speed} [m/s], expected > 0")
    sections, h = _ISO_3888[part]
    stretch = speed * math.sqrt(_STEEPEST * h / A_Y_MAX) / min(sections[1], sections[3])
    entry, first_change, offset_lane, second_change, exit_lane = (stretch * length for length in sections)
    plan = [(_RUN + entry, 0.0), (first_change, h), (offset_lane, h), (second_change, 0.0), (exit_lane + _RUN, 0.0)]
    return _through(plan, f"iso3888-{part}")


def slalom() -> Path:
    """A slalom round seven cones 18 m apart, passing them 1 m to the left and right in turn.

    |kappa| <= 5.77 * 2 m/(18 m)^2 = 0.036/m, 2.9 m/s^2 at 9 m/s.
    """
    swings = [(18.0, 1.0 if k % 2 == 0 else -1.0) for k in range(7)]
    return _through([(_RUN, 0.0), *swings, (18.0, 0.0), (_RUN, 0.0)], "slalom")


def curvature_step() -> Path:
    """A straight of 30 m that becomes half a circle to the left at once, and a straight again: steps in curvature.

    Its radius of 27 m asks 3 m/s^2 at 9 m/s. Curvature rises over about 0.5 m, between two knots, and overshoots 10 %.
    """
    radius = 27.0
    angle = np.linspace(0.0, math.pi, math.ceil(4.0 * math.pi * radius) + 1)
    arc = np.column_stack((_RUN + radius * np.sin(angle), radius * (1.0 - np.cos(angle))))
    along = np.arange(0.0, _RUN, 0.25)[:, None]
    end = arc[-1] - (along + 0.25) * np.array([1.0, 0.0])
    points = np.vstack((along * np.array([1.0, 0.0]), arc, end))
    return Path.from_waypoints(points, closed=False, spacing=0.5, name="curvature-step")


def _through(plan: Sequence[tuple[float, float]], name: str) -> Path:
    """A path from (0, 0) along +x: each piece (length, y at its end) by a smooth step."""
    points, x, y = [np.zeros((1, 2))], 0.0, 0.0
    for length, to in plan:
        z = np.linspace(0.0, 1.0, math.ceil(2.0 * length) + 1)[1:]
        points.append(np.column_stack((x + length * z, y + (to - y) * z**3 * (10.0 - 15.0 * z + 6.0 * z**2))))
        x, y = x + length, to
    return Path.from_waypoints(np.vstack(points), closed=False, spacing=0.5, name=name)


def names() -> tuple[str, ...]:
    """The names that `course` knows."""
    return tuple(_COURSES)


def course(name: str) -> Path:
    """The built-in course called `name`, made once, since paths are immutable; or that of a file: see `read_course`.

    * paper: closed, 795 m, like the course of the NFQ steering experiments (`paper`);
    * genesis: a recorded real lap, 3.7 km, bends down to 24 m, open: it ends 102 m short of its start;
    * genesis-rfs: a shorter drive, 477 m with one right bend down to 18 m, open;
    * iso3888-1, iso3888-2: lane changes for 9 m/s and 3 m/s^2 (`lane_change`), open;
    * calibration: a figure of eight, 100 m by 35 m, bends down to 17 m, for `steerkit car calibrate`;
    * highway: closed, 6 km, bends down to 400 m, for speeds of 12 to 30 m/s;
    * bends-250: closed, two straights of 300 m and two bends of 250 m, for lane keeping at 80 km/h;
    * circle, straight, figure-eight, slalom, curvature-step: the formulas with their default sizes.

    Raises ValueError for another name, with the nearest one, and for a file of which no course can be made.
    """
    if name not in _COURSES:
        from steerkit.paths.importers import KINDS, is_file, read_course  # a car's server does without

        if is_file(name):
            return read_course(name).path
        known(name, _COURSES, "course", also=f"FILE{', '.join(KINDS)}")
    return _built_in(name)


@cache
def _built_in(name: str) -> Path:
    return _COURSES[name]()


def recorded_speed(name: str) -> tuple[Array, Array]:
    """The speed that was driven on a recorded course: s (n,) [m] along `course(name)` and v (n,) [m/s].

    Raises ValueError unless it is one of the recorded courses.
    """
    v = _columns(_RECORDED[known(name, _RECORDED, "recorded course")])["v"]
    return np.linspace(0.0, course(name).length, len(v)), v  # the rows are evenly spaced


def _recorded(name: str) -> Path:
    columns = _columns(_RECORDED[name])
    return Path.from_waypoints(np.column_stack((columns["x"], columns["y"])), closed=False, name=name)


def _columns(file: str) -> dict[str, Array]:
    return read_columns((files(__name__) / file).read_text(encoding="utf-8"), file)


_RECORDED = {"genesis": "genesis.csv", "genesis-rfs": "genesis_rfs.csv"}
_COURSES: dict[str, Callable[[], Path]] = {
    "paper": paper,
    **{name: partial(_recorded, name) for name in _RECORDED},
    "highway": partial(random_course, 3, length=6000.0, max_kappa=0.0025, name="highway"),
    "bends-250": partial(bends, [(300.0, 180.0, 250.0, 66.0)] * 2, name="bends-250"),
    "circle": circle,
    "straight": straight,
    "figure-eight": figure_eight,
    "calibration": partial(figure_eight, 100.0, name="calibration"),
    "iso3888-1": partial(lane_change, 1),
    "iso3888-2": partial(lane_change, 2),
    "slalom": slalom,
    "curvature-step": curvature_step,
}
