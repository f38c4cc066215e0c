"""OpenDRIVE files: roads, the centres of their lanes, and how lanes are linked."""

import functools
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from steerkit._support.errors import require
from steerkit.diagram.maths import Array
from steerkit.paths.importers.course import Line
from steerkit.paths.importers.network import Map, Piece, require_some
from steerkit.paths.importers.xml_stream import get, number, records, shown

STEP = 0.5
"""A lane's centre has a point so often [m]."""
_TORN, _BENT = 0.2, 0.1
"""Pieces of a reference line that lie further apart are torn [m], or that turn by more than this [rad]."""
_DRIVABLE = re.compile(
    "driving|entry|exit|onRamp|offRamp|connectingRamp|slipLane|bidirectional|bus|taxi|HOV|mwyEntry|mwyExit|special[123]"
)
_TOLD_LINKS = 3
"""Links that a map lacks are told one by one up to so many."""
_UNITS = {"": 1.0, "m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
_WIDEST = 15.0
"""A lane is no wider [m]."""
_MOST_TURN = 200.0
"""A spiral turns by no more than this [rad]."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)

Steps = list[tuple[float, Any]]
"""Values that hold from a distance on [m] to the next one's: of a speed [m/s], or a cubic's coefficients (4,)."""


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Lane:
    """A lane within one section."""

    number: int
    kind: str
    widths: Steps
    borders: Steps
    """Instead of widths: where its outer border lies."""
    limits: Steps
    links: dict[str, list[int]]
    """predecessor, successor -> lanes that it goes over into at the section's beginning and end."""
    direction: str
    """standard, reversed or both."""


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Section:
    """A stretch of road with the same lanes."""

    s: float
    end: float
    lanes: dict[int, Lane]


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Road:
    """A road: its reference line and what lies beside it."""

    name: str
    length: float
    left_hand: bool
    shapes: "list[Shape]"
    offsets: Steps
    sections: list[Section]
    links: dict[str, tuple[str, str, str]]
    """predecessor, successor -> (road or junction, its name, start or end)."""
    limits: Steps

    def reference(self, s: Array) -> tuple[Array, Array, Array]:
        """x, y [m] and heading [rad] of the reference line at s (n,) [m]."""
        which = np.maximum(np.searchsorted([shape.s for shape in self.shapes], s, side="right") - 1, 0)
        out = np.empty((3, len(s)))
        for k in np.unique(which):
            shape = self.shapes[k]
            out[:, which == k] = shape.at(np.clip(s[which == k] - shape.s, 0.0, shape.length))
        return out[0], out[1], out[2]

    def centre(self, section: Section, lane: Lane) -> Line:
        """The middle of a lane in a section, in the direction in which it is driven."""
        n = max(4, math.ceil((section.end - section.s) / STEP))
        s = np.linspace(section.s, section.end, n + 1)
        # what begins at the section's end belongs to the next one
        inside = np.minimum(s, np.nextafter(section.end, section.s))
        t = self.offset(section, lane.number, inside)
        x, y, heading = self.reference(s)
        own = _stepped(lane.limits, inside - section.s, math.nan)
        limit = np.where(np.isnan(own), _stepped(self.limits, inside, math.nan), own)
        line = Line(
            xy=np.column_stack((x - t * np.sin(heading), y + t * np.cos(heading))),
            v_limit=limit if np.isfinite(limit).any() else None,
        )
        return line if self.forward(lane) else line.backwards()

    def offset(self, section: Section, wanted: int, s: Array) -> Array:
        """Distance of a lane's middle from the reference line (n,) [m], + = left."""
        side = 1 if wanted > 0 else -1
        middle = inner = outer = _summed(self.offsets, s)
        for k in range(side, wanted + side, side):
            lane = section.lanes.get(k)
            if lane is None:
                raise ValueError(f"road {self.name}: lane {k}, between lane {wanted} and the middle, is missing")
            inner = outer
            wide = _summed(lane.widths, s - section.s)
            if lane.borders:
                wide = side * (_summed(lane.borders, s - section.s) + middle - inner)
            what = f"lane {k} is {wide.min():.3g} to {wide.max():.3g} m wide, expected 0 to {_WIDEST:g}"
            require((wide >= -0.1) & (wide <= _WIDEST), f"road {self.name}", what)
            outer = inner + side * wide
        return 0.5 * (inner + outer)

    def forward(self, lane: Lane) -> bool:
        """Is the lane driven along s?"""
        along = (lane.number < 0) != self.left_hand
        return along != (lane.direction == "reversed")

    def called(self, section: int, lane: int) -> str:
        """The name of the piece of that lane."""
        return f"{self.name}/{section}/{lane}"


def _stepped(steps: Steps, s: Array, before: Any) -> Array:
    """The value that holds at s (n,); `before` the first."""
    values = np.array([before, *(value for _, value in steps)])
    return values[np.searchsorted([begin for begin, _ in steps], s, side="right")]


def _summed(cubics: Steps, s: Array) -> Array:
    """Piecewise cubics at s (n,); 0 before the first."""
    begins = _stepped([(begin, begin) for begin, _ in cubics], s, 0.0)
    return np.asarray(polyval(s - begins, _stepped(cubics, s, np.zeros(4)).T, tensor=False))


def opendrive(file: str) -> Map:
    """The lanes of an OpenDRIVE map: their centres beside the reference line, linked through roads and junctions.

    Read: line, arc, spiral, poly3, paramPoly3 (both pRange), lane offset, lane sections, widths or borders, links,
    junctions, speeds, left-hand traffic (rule), reversed lanes; not elevation, superelevation, shape, geoReference.
    Raises ValueError for a map that is damaged, torn or contradicts itself.
    Source: ASAM OpenDRIVE 1.4 to 1.8.
    """
    roads, junctions, faulty = read(file)
    require_some(roads, faulty, file, "roads with lanes")
    joined = [note for road in roads.values() for note in _linked(road)]
    remarks = joined[:_TOLD_LINKS]
    remarks += [f"{len(joined) - _TOLD_LINKS} more lanes without links alike"] * (len(joined) > _TOLD_LINKS)
    pieces = {
        road.called(k, lane.number): Piece(
            group=road.name,
            lane=str(lane.number),
            length=section.end - section.s,
            next=tuple(_next(road, k, lane, roads, junctions)),
            line=functools.partial(road.centre, section, lane),
            about=lane.kind,
        )
        for road in roads.values()
        for k, section in enumerate(road.sections)
        for lane in section.lanes.values()
        if lane.number != 0 and _DRIVABLE.fullmatch(lane.kind)
    }
    require(pieces, file, "holds no lanes to drive on")
    return Map(kind="road", pieces=pieces, noise=0.02, drawn=False, notes=tuple(remarks), faulty=faulty)


def _linked(road: Road) -> list[str]:
    """Links lanes that go on under their number in the road's next section where the file says nothing of it."""
    notes = []
    for before, after in pairwise(road.sections):
        for number_, lane in before.lanes.items():
            on = after.lanes.get(number_)
            drivable = number_ and on and _DRIVABLE.fullmatch(lane.kind) and _DRIVABLE.fullmatch(on.kind)
            if on and drivable and not lane.links["successor"] and not on.links["predecessor"]:
                lane.links["successor"], on.links["predecessor"] = [number_], [number_]
                lacks = f"no link at s = {after.s:.1f} m; it is taken as going on"
                notes.append(f"road {road.name}, lane {number_}: {lacks}")
    return notes


Links = dict[tuple[str, str, int], list[tuple[str, str, int]]]
"""Of junctions: (junction, incoming road, its lane) -> (connecting road, start or end of it, its lane)."""


def read(file: str) -> tuple[dict[str, Road], Links, dict[str, str]]:
    """Roads by name, the links of junctions, and the roads that are faulty."""
    roads: dict[str, Road] = {}
    faulty: dict[str, str] = {}
    junctions: Links = {}
    for record in records(file, ("road", "junction")):
        if record.tag == "road":
            name = get(record, "id")
            require(name not in roads, file, f"two roads of the name {name}")
            try:
                roads[name] = _road(record)
            except ValueError as error:
                faulty[name] = str(error).removeprefix(f"road {name}: ")
        else:
            for connection in record.findall("connection"):
                incoming, through = connection.get("incomingRoad"), connection.get("connectingRoad")
                if incoming is not None and through is not None:  # no lane leads through a direct or virtual one
                    contact = get(connection, "contactPoint", "start")
                    for link in connection.findall("laneLink"):
                        key = get(record, "id"), incoming, _whole(link, "from")
                        junctions.setdefault(key, []).append((through, contact, _whole(link, "to")))
    return roads, junctions, faulty


def _whole(node: Element, key: str) -> int:
    value = number(node, key)
    require(value == round(value) and abs(value) < 1000, shown(node), f"{key} = {value}, expected a lane's number")
    return round(value)


def _road(node: Element) -> Road:
    name, length = get(node, "id"), number(node, "length")
    where = f"road {name}"
    shapes = [_shape(geometry) for geometry in node.findall("planView/geometry")]
    require(shapes, where, "no geometry")
    _check_line(shapes, length, where)
    sections = node.findall("lanes/laneSection")
    begins = [number(section, "s") for section in sections]
    rising = all(a < b for a, b in pairwise(begins)) and all(0.0 <= s <= length + 0.01 for s in begins)
    require(rising, where, f"lane sections at s = {begins}, expected rising from 0 to {length:g} m")
    links = {
        link.tag: (get(link, "elementType", "road"), get(link, "elementId"), get(link, "contactPoint", "start"))
        for link in (*node.findall("link/predecessor"), *node.findall("link/successor"))
        if link.get("elementId") is not None
    }
    return Road(
        name=name,
        length=length,
        left_hand=get(node, "rule", "RHT") == "LHT",
        shapes=shapes,
        offsets=_cubics(node.findall("lanes/laneOffset"), "s"),
        sections=[
            Section(s=s, end=end, lanes={lane.number: lane for lane in map(_lane, section.findall("*/lane"))})
            for section, s, end in zip(sections, begins, [*begins[1:], length])
            if end - s > 1e-3
        ],
        links=links,
        limits=[(number(kind, "s"), _limit(speed)) for kind in node.findall("type") for speed in kind.findall("speed")],
    )


def _shape(node: Element) -> "Shape":
    s, x0, y0, psi0, length = (number(node, key) for key in ("s", "x", "y", "hdg", "length"))
    require(0.0 <= length <= 1e6, shown(node), f"is {length} m long")
    for child in node:
        local = _local(child, length)
        if local is not None:
            return Shape(s=s, x0=x0, y0=y0, psi0=psi0, length=length, local=local)
    tags = ", ".join(child.tag for child in node) or "nothing"
    raise ValueError(f"{shown(node)} holds {tags}; known: line, arc, spiral, poly3, paramPoly3")


def _local(node: Element, length: float) -> Callable[[Array], tuple[Array, Array, Array]] | None:
    """The curve of a piece of reference line in its own frame; None for an element that is none."""
    if node.tag in ("line", "arc", "spiral"):
        keys = {"line": (), "arc": ("curvature", "curvature"), "spiral": ("curvStart", "curvEnd")}[node.tag]
        k0, k1 = [number(node, key) for key in keys] or (0.0, 0.0)
        turns = max(abs(k0), abs(k1)) * length
        require(turns <= _MOST_TURN, shown(node), f"turns by {turns:.3g} rad, which no road does")
        return functools.partial(spiral, length, k0, k1)
    if node.tag == "poly3":
        return functools.partial(poly3, length, _coefficients(node, "abcd"))
    if node.tag == "paramPoly3":
        u, v = (_coefficients(node, [f"{c}{axis}" for c in "abcd"]) for axis in "UV")
        return functools.partial(param_poly3, 1.0 if get(node, "pRange", "normalized") == "arcLength" else length, u, v)
    return None


def _coefficients(node: Element, names: str | list[str]) -> Array:
    return np.array([number(node, name) for name in names])


def _cubics(nodes: list[Element], key: str = "sOffset") -> Steps:
    rows = [(number(node, key), _coefficients(node, "abcd")) for node in nodes]
    for node, row, before in zip(nodes[1:], rows[1:], rows):
        require(row[0] >= before[0], shown(node), f"{key} = {row[0]}, expected rising from {before[0]}")
    return rows


def _check_line(shapes: "list[Shape]", length: float, where: str) -> None:
    """ValueError where the pieces of a reference line do not meet or its length is not the stated one."""
    total = sum(shape.length for shape in shapes)
    fits = abs(total - length) <= 0.01 + 1e-3 * length
    require(fits, where, f"its geometry is {total:.3f} m long, the road {length:.3f} m: damaged?")
    for before, shape in pairwise(shapes):
        x, y, heading = (float(a[0]) for a in before.at(np.array([before.length])))
        gap = math.hypot(x - shape.x0, y - shape.y0)
        turn = abs(math.remainder(heading - shape.psi0, 2.0 * math.pi))
        at = f"at s = {shape.s:.1f} m"
        require(gap <= _TORN, where, f"its reference line is torn by {gap:.2f} m {at}")
        require(turn <= _BENT, where, f"its reference line has a kink of {turn:.2f} rad {at}")
        apart = abs(before.s + before.length - shape.s)
        require(apart <= 0.01 + 1e-3 * length, where, f"its geometry leaves out {apart:.2f} m {at}")


def _lane(node: Element) -> Lane:
    widths = _cubics(node.findall("width"))
    sides = ("predecessor", "successor")
    return Lane(
        number=_whole(node, "id"),
        kind=get(node, "type", "none"),
        widths=widths,
        borders=[] if widths else _cubics(node.findall("border")),
        limits=[(number(speed, "sOffset", 0.0), _limit(speed)) for speed in node.findall("speed")],
        links={side: [_whole(link, "id") for link in node.findall(f"link/{side}")] for side in sides},
        direction=get(node, "direction", "standard"),
    )


def _limit(node: Element) -> float:
    unit = get(node, "unit", "")
    require(unit in _UNITS, shown(node), f"unit {unit!r}; valid: m/s, km/h, mph")
    if get(node, "max", "undefined") in ("no limit", "undefined"):
        return math.nan
    value = number(node, "max") * _UNITS[unit]
    require(0.0 <= value <= 150.0, shown(node), f"{value:.4g} m/s, expected 0 to 150")
    return value if value > 0.0 else math.nan


def _next(road: Road, k: int, lane: Lane, roads: dict[str, Road], junctions: Links) -> list[str]:
    """The pieces that may be driven after a lane in section k."""
    forward = road.forward(lane)
    side, beside = ("successor", k + 1) if forward else ("predecessor", k - 1)
    links = lane.links[side]
    if 0 <= beside < len(road.sections):
        return [road.called(beside, to) for to in links if _drives_on(road, beside, to, forward=forward)]
    kind, name, contact = road.links.get(side, ("", "", ""))
    ways = [(name, contact, to) for to in links] if kind == "road" else []
    if kind == "junction":
        ways = junctions.get((name, road.name, lane.number), [])
    out = []
    for other, end, to in ways:
        if other in roads and roads[other].sections:
            there, at_start = roads[other], end == "start"
            at = 0 if at_start else len(there.sections) - 1
            if _drives_on(there, at, to, forward=at_start):
                out.append(there.called(at, to))
    return out


def _drives_on(road: Road, section: int, wanted: int, *, forward: bool) -> bool:
    """Is it a lane to drive on, that way?"""
    lane = road.sections[section].lanes.get(wanted)
    if lane is None or not _DRIVABLE.fullmatch(lane.kind):
        return False
    return lane.direction == "both" or road.forward(lane) == forward


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A piece of reference line.

    `local(d)` gives u, v [m] and heading [rad] in its own frame, which begins at the origin along +x, at the distances
    d (n,) [m] from its beginning; `at(d)` the same in the map's frame:

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
    local: Callable[[Array], tuple[Array, Array, Array]]

    def at(self, d: Array) -> tuple[Array, Array, Array]:
        """x, y [m] and heading [rad] in the map at the distances d (n,) [m]."""
        u, v, heading = self.local(d)
        c, s = math.cos(self.psi0), math.sin(self.psi0)
        return self.x0 + u * c - v * s, self.y0 + u * s + v * c, self.psi0 + heading


def spiral(length: float, k0: float, k1: float, d: Array) -> tuple[Array, Array, Array]:
    """A clothoid, whose curvature changes evenly from k0 to k1 [1/m]; with equal curvatures an arc, or a straight.

        heading = k0 d + (k1 - k0) d^2/(2 length),  u = integral cos(heading),  v = integral sin(heading),

    by Gauss-Legendre on panels that turn by a radian at most: to rounding, also for nearly constant curvature, where
    Fresnel integrals cancel.
    """
    rate = (k1 - k0) / length if length > 0.0 else 0.0

    def over(begin: Array, d: Array) -> Array:
        at = begin[:, None] + 0.5 * d[:, None] * (1.0 + _NODES)
        return 0.5 * d * (np.exp(1j * at * (k0 + 0.5 * rate * at)) @ _WEIGHTS)

    ends = np.linspace(0.0, length, 1 + max(1, math.ceil(max(abs(k0), abs(k1)) * length)))
    panel = np.clip(np.searchsorted(ends, d, side="right") - 1, 0, len(ends) - 2)
    before = np.append(0.0, np.cumsum(over(ends[:-1], np.diff(ends))))
    z = before[panel] + over(ends[panel], d - ends[panel])
    return z.real, z.imag, d * (k0 + 0.5 * rate * d)


def param_poly3(scale: float, u: Array, v: Array, d: Array) -> tuple[Array, Array, Array]:
    """Two cubics of a parameter: u(p) = a_u + b_u p + c_u p^2 + d_u p^3, v(p) alike, p = d/scale.

    The curve is exact, the distance along it as even as the map's author made it, as the standard has it.
    """
    p = d / scale if scale > 0.0 else d
    x, y, dx, dy = (np.asarray(polyval(p, a), dtype=float) for a in (u, v, polyder(u), polyder(v)))
    return x, y, np.arctan2(dy, dx)


def poly3(length: float, v: Array, d: Array) -> tuple[Array, Array, Array]:
    """A cubic over its chord: v(u) = a + b u + c u^2 + d u^3, u from the distance: du/dd = 1/sqrt(1 + v'^2).

    u by Dormand and Prince's method of order 8.
    """
    from scipy.integrate import solve_ivp

    slope = polyder(v)
    solver = {"method": "DOP853", "dense_output": True, "rtol": 1e-13, "atol": 1e-13}
    way = solve_ivp(lambda _, u: 1.0 / np.hypot(1.0, polyval(u, slope)), (0.0, length), [0.0], **solver)
    (u,) = way.sol(d)
    return u, polyval(u, v), np.arctan(polyval(u, slope))
