"""OpenDRIVE files: roads, the centres of their lanes, and how lanes are linked."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.paths.importers.course import Line as Centre
from steerkit.paths.importers.network import Map, Piece
from steerkit.paths.importers.opendrive.geometry import Line, ParamPoly3, Poly3, Shape, Spiral, cubic
from steerkit.paths.importers.xml_stream import Node, records

Array = NDArray[np.float64]
Cubics = tuple[tuple[float, tuple[float, float, float, float]], ...]
"""Where each of several cubics begins [m], and its coefficients."""

STEP = 0.5
"""A lane's centre has a point so often [m]."""
_TORN, _TOLD, _BENT = 0.2, 0.02, 0.1
"""Pieces of a reference line that lie further apart are torn, from here on it is said [m]; they turn by this [rad]."""
_DRIVABLE = [
    "driving",
    "entry",
    "exit",
    "onRamp",
    "offRamp",
    "connectingRamp",
    "slipLane",
    "bidirectional",
    "bus",
    "taxi",
    "HOV",
    "mwyEntry",
    "mwyExit",
    "special1",
    "special2",
    "special3",
]
_UNITS = {"": 1.0, "m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
_WIDEST = 15.0
"""A lane is no wider [m]."""


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Lane:
    """A lane within one section."""

    number: int
    kind: str
    widths: Cubics
    borders: Cubics
    """Instead of widths: where its outer border lies."""
    limits: tuple[tuple[float, float], ...]
    """Distance into the section [m], speed allowed from there on [m/s]."""
    before: tuple[int, ...]
    after: tuple[int, ...]
    """Lanes that it goes over into at the section's beginning and end."""
    direction: str
    """standard, reversed or both."""


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Section:
    """A stretch of road with the same lanes."""

    s: float
    end: float
    lanes: dict[int, Lane]


@dataclass(eq=False, kw_only=True, slots=True)
class Road:
    """A road: its reference line and what lies beside it."""

    name: str
    length: float
    left_hand: bool
    shapes: list[Shape]
    offsets: Cubics
    sections: list[Section]
    links: dict[str, tuple[str, str, str]]
    """predecessor, successor -> (road or junction, its name, start or end)."""
    limits: tuple[tuple[float, float], ...]
    notes: list[str] = field(default_factory=list)

    def reference(self, s: Array) -> tuple[Array, Array, Array]:
        """x, y [m] and heading [rad] of the reference line at s (n,) [m]."""
        begins = np.array([shape.s for shape in self.shapes])
        which = np.clip(np.searchsorted(begins, s, side="right") - 1, 0, len(begins) - 1)
        out = np.empty((3, len(s)))
        for k in np.unique(which):
            here = which == k
            out[:, here] = self.shapes[k].at(np.clip(s[here] - begins[k], 0.0, self.shapes[k].length))
        return out[0], out[1], out[2]

    def centre(self, section: Section, number: int, step: float = STEP) -> Centre:
        """The middle of a lane in a section, in the direction in which it is driven."""
        n = max(4, math.ceil((section.end - section.s) / step))
        s = np.linspace(section.s, section.end, n + 1)
        # what begins at the section's end belongs to the next one
        inside = np.minimum(s, np.nextafter(section.end, section.s))
        t = self.offset(section, number, inside)
        x, y, heading = self.reference(s)
        xy = np.column_stack((x - t * np.sin(heading), y + t * np.cos(heading)))
        lane = section.lanes[number]
        limit = _stepped(self.limits, inside)
        own = _stepped(tuple((section.s + ds, v) for ds, v in lane.limits), inside)
        limit = np.where(np.isnan(own), limit, own)
        if not self.forward(lane):
            xy, limit = xy[::-1], limit[::-1]
        return Centre(xy=xy, v_limit=limit if np.isfinite(limit).any() else None)

    def offset(self, section: Section, number: int, s: Array) -> Array:
        """Distance of a lane's middle from the reference line (n,) [m], + = left."""
        side = 1 if number > 0 else -1
        inner = outer = _summed(self.offsets, s)
        for k in range(side, number + side, side):
            lane = section.lanes.get(k)
            if lane is None:
                raise ValueError(f"road {self.name}: lane {k}, between lane {number} and the middle, is missing")
            inner = outer
            wide = side * (_summed(lane.borders, s - section.s) + self._middle(s) - inner) if lane.borders else None
            wide = _summed(lane.widths, s - section.s) if wide is None else wide
            sane = bool(((wide >= -0.1) & (wide <= _WIDEST)).all())
            what = f"lane {k} is {wide.min():.3g} to {wide.max():.3g} m wide, expected 0 to {_WIDEST:g}"
            require(sane, f"road {self.name}", what)
            outer = inner + side * wide
        return 0.5 * (inner + outer)

    def _middle(self, s: Array) -> Array:
        return _summed(self.offsets, s)

    def forward(self, lane: Lane) -> bool:
        """Is the lane driven along s?"""
        along = (lane.number < 0) != self.left_hand
        return along != (lane.direction == "reversed")


def _summed(cubics: Cubics, s: Array) -> Array:
    """Piecewise cubics at s (n,); 0 before the first."""
    if not cubics:
        return np.zeros_like(s)
    begins = np.array([begin for begin, _ in cubics])
    which = np.searchsorted(begins, s, side="right") - 1
    out = np.zeros_like(s)
    for k in np.unique(which[which >= 0]):
        here = which == k
        out[here] = cubic(cubics[k][1], s[here] - begins[k])
    return out


def _stepped(steps: tuple[tuple[float, float], ...], s: Array) -> Array:
    if not steps:
        return np.full(len(s), np.nan)
    which = np.searchsorted([begin for begin, _ in steps], s, side="right") - 1
    return np.where(which >= 0, np.array([v for _, v in steps])[np.maximum(which, 0)], np.nan)


def opendrive(file: str) -> Map:
    """The lanes of an OpenDRIVE map: their centres beside the reference line, linked through roads and junctions.

    Read: line, arc, spiral, poly3, paramPoly3 (both pRange), lane offset, lane sections, widths or borders, links,
    junctions, speeds, left-hand traffic (rule), reversed lanes. Told and not used: elevation, superelevation, shape,
    geoReference. Raises ValueError for a map that is damaged, torn or contradicts itself.
    Source: ASAM OpenDRIVE 1.4 to 1.8.
    """
    roads, junctions, seen, told = read(file)
    require(seen, file, "is no OpenDRIVE file: its first element is no <OpenDRIVE>")
    require(roads, file, "holds no roads with lanes")
    pieces: dict[str, Piece] = {}
    for road in roads.values():
        for k, section in enumerate(road.sections):
            for number, lane in section.lanes.items():
                called = f"{road.name}/{k}/{number}"
                if number == 0 or lane.kind not in _DRIVABLE:
                    continue
                pieces[called] = Piece(
                    group=road.name,
                    lane=str(number),
                    length=section.end - section.s,
                    next=tuple(_next(road, k, lane, roads, junctions)),
                    line=partial(road.centre, section, number),
                    about=lane.kind,
                )
    require(pieces, file, "holds no lanes to drive on")
    return Map(kind="road", pieces=pieces, noise=0.02, drawn=False, notes=tuple(told))


Links = dict[tuple[str, str, int], list[tuple[str, str, int]]]
"""Of junctions: (junction, incoming road, its lane) -> (connecting road, start or end of it, its lane)."""


def read(file: str) -> tuple[dict[str, Road], Links, bool, list[str]]:
    """Roads by name, the links of junctions, whether it is OpenDRIVE at all, and what is told of it."""
    roads: dict[str, Road] = {}
    junctions: Links = {}
    seen, tells = False, dict[str, int]()
    for record in records(file, {"road", "junction", "geoReference"}, {"OpenDRIVE"}):
        if isinstance(record, str):
            seen = True
        elif record.tag == "geoReference":
            tells["geoReference"] = 1
        elif record.tag == "road":
            road = _road(record)
            require(road.name not in roads, record.where, f"two roads of the name {road.name}")
            roads[road.name] = road
            for note in road.notes:
                tells[note] = tells.get(note, 0) + 1
        else:
            for connection in record.all("connection"):
                _connect(record.get("id"), connection, junctions)
    told = [f"{what}{f' (in {count} roads)' if count > 1 else ''}: told, not used" for what, count in tells.items()]
    return roads, junctions, seen, told


def _connect(junction: str, connection: Node, links: Links) -> None:
    if "incomingRoad" not in connection.attributes or "connectingRoad" not in connection.attributes:
        return  # a direct or virtual junction's: no lane leads through
    incoming, road = connection.get("incomingRoad"), connection.get("connectingRoad")
    for link in connection.all("laneLink"):
        key = junction, incoming, _whole(link, "from")
        links.setdefault(key, []).append((road, connection.get("contactPoint", "start"), _whole(link, "to")))


def _whole(node: Node, key: str) -> int:
    value = node.number(key)
    require(value == round(value) and abs(value) < 1000, node.where, f"{key} = {value}, expected a lane's number")
    return round(value)


def _road(node: Node) -> Road:
    name, length = node.get("id"), node.number("length")
    where = f"{node.where}: road {name}"
    plan = node.find("planView")
    shapes = [_shape(g) for g in plan.all("geometry")] if plan is not None else []
    require(shapes, where, "no geometry")
    notes = _checked(shapes, length, where)
    for path, what in (
        (("elevationProfile", "elevation"), "elevation"),
        (("lateralProfile", "superelevation"), "superelevation"),
        (("lateralProfile", "shape"), "lateral shape"),
    ):
        parent = node.find(path[0])
        rows = parent.all(path[1]) if parent is not None else []
        if any(row.number(c, 0.0) != 0.0 for row in rows for c in ("b", "c", "d")) or (
            what != "elevation" and any(row.number("a", 0.0) != 0.0 for row in rows)
        ):
            notes.append(what)
    links = {}
    for side in ("predecessor", "successor"):
        link = node.find("link", side)
        if link is not None and "elementId" in link.attributes:
            kind = link.get("elementType", "road")
            links[side] = kind, link.get("elementId"), link.get("contactPoint", "start")
    lanes = node.find("lanes")
    sections = _sections(lanes, length, where) if lanes is not None else []
    limits = [(t.number("s"), _limit(v)) for t in node.all("type") for v in t.all("speed")]
    return Road(
        name=name,
        length=length,
        left_hand=node.get("rule", "RHT") == "LHT",
        shapes=shapes,
        offsets=_cubics(lanes.all("laneOffset"), "s") if lanes is not None else (),
        sections=sections,
        links=links,
        limits=tuple(limits),
        notes=notes,
    )


def _shape(node: Node) -> Shape:
    keys = {"s": "s", "x0": "x", "y0": "y", "psi0": "hdg", "length": "length"}
    place = {name: node.number(key) for name, key in keys.items()}
    for child in node.children:
        if child.tag == "line":
            return Line(**place)
        if child.tag == "arc":
            k = child.number("curvature")
            return Spiral(**place, k0=k, k1=k)
        if child.tag == "spiral":
            return Spiral(**place, k0=child.number("curvStart"), k1=child.number("curvEnd"))
        if child.tag == "poly3":
            return Poly3(**place, v=_coefficients(child, "abcd"))
        if child.tag == "paramPoly3":
            u, v = (_coefficients(child, [f"{c}{axis}" for c in "abcd"]) for axis in "UV")
            return ParamPoly3(**place, u=u, v=v, normalised=child.get("pRange", "normalized") != "arcLength")
    tags = ", ".join(child.tag for child in node.children) or "nothing"
    raise ValueError(f"{node.where}: <geometry> holds {tags}; known: line, arc, spiral, poly3, paramPoly3")


def _coefficients(node: Node, names: str | list[str]) -> tuple[float, float, float, float]:
    a, b, c, d = (node.number(name) for name in names)
    return a, b, c, d


def _cubics(nodes: list[Node], key: str = "sOffset") -> Cubics:
    rows = [(node.number(key), _coefficients(node, "abcd")) for node in nodes]
    for node, row, before in zip(nodes[1:], rows[1:], rows):
        require(row[0] >= before[0], node.where, f"<{node.tag}> {key} = {row[0]}, expected rising from {before[0]}")
    return tuple(rows)


def _checked(shapes: list[Shape], length: float, where: str) -> list[str]:
    """What is to be said of a reference line; ValueError where its pieces do not meet or it is not as long as told."""
    notes = []
    total = sum(shape.length for shape in shapes)
    fits = abs(total - length) <= 0.01 + 1e-3 * length
    require(fits, where, f"its geometry is {total:.3f} m long, the road {length:.3f} m: damaged?")
    for before, shape in pairwise(shapes):
        x, y, heading = (float(a[0]) for a in before.at(np.array([before.length])))
        gap = math.hypot(x - shape.x0, y - shape.y0)
        turn = abs((heading - shape.psi0 + math.pi) % (2.0 * math.pi) - math.pi)
        require(gap <= _TORN, where, f"its reference line is torn by {gap:.2f} m at s = {shape.s:.1f} m")
        require(turn <= _BENT, where, f"its reference line has a kink of {turn:.2f} rad at s = {shape.s:.1f} m")
        apart = abs(before.s + before.length - shape.s)
        require(apart <= 0.01 + 1e-3 * length, where, f"its geometry leaves out {apart:.2f} m at s = {shape.s:.1f} m")
        if gap > _TOLD:
            notes.append(f"a reference line with gaps above {_TOLD:g} m")
    return notes


def _sections(lanes: Node, length: float, where: str) -> list[Section]:
    nodes = lanes.all("laneSection")
    begins = [node.number("s") for node in nodes]
    rising = all(a < b for a, b in pairwise(begins)) and all(0.0 <= s <= length + 0.01 for s in begins)
    require(rising, where, f"lane sections at s = {begins}, expected rising from 0 to {length:g} m")
    return [
        Section(s=s, end=end, lanes={lane.number: lane for side in node.children for lane in _lanes(side)})
        for node, s, end in zip(nodes, begins, [*begins[1:], length])
        if end - s > 1e-3
    ]


def _lanes(side: Node) -> list[Lane]:
    found = []
    for node in side.all("lane"):
        speeds = [(speed.number("sOffset", 0.0), _limit(speed)) for speed in node.all("speed")]
        link = node.find("link")
        before, after = (
            tuple(_whole(n, "id") for n in link.all(key)) if link is not None else ()
            for key in ("predecessor", "successor")
        )
        found.append(
            Lane(
                number=_whole(node, "id"),
                kind=node.get("type", "none"),
                widths=_cubics(node.all("width")),
                borders=_cubics(node.all("border")) if not node.all("width") else (),
                limits=tuple(speeds),
                before=before,
                after=after,
                direction=node.get("direction", "standard"),
            )
        )
    return found


def _limit(node: Node) -> float:
    text = node.get("max", "undefined")
    unit = node.get("unit", "")
    require(unit in _UNITS, node.where, f"<speed> unit {unit!r}; valid: m/s, km/h, mph")
    if text in ("no limit", "undefined"):
        return math.nan
    value = node.number("max") * _UNITS[unit]
    require(0.0 <= value <= 150.0, node.where, f"<speed> of {value:.4g} m/s, expected 0 to 150")
    return value if value > 0.0 else math.nan


def _next(road: Road, k: int, lane: Lane, roads: dict[str, Road], junctions: Links) -> list[str]:
    """The pieces that may be driven after a lane in section k."""
    forward = road.forward(lane)
    links = lane.after if forward else lane.before
    beside = k + 1 if forward else k - 1
    if 0 <= beside < len(road.sections):
        found = [(road, beside, number) for number in links]
        return [_called(*one) for one in found if _drives_on(*one, forward=forward)]
    kind, name, contact = road.links.get("successor" if forward else "predecessor", ("", "", ""))
    if kind == "junction":
        ways = junctions.get((name, road.name, lane.number), [])
    else:
        ways = [(name, contact, number) for number in links] if kind == "road" else []
    out = []
    for other, end, number in ways:
        if other in roads and roads[other].sections:
            there = roads[other]
            at = 0 if end == "start" else len(there.sections) - 1
            if _drives_on(there, at, number, forward=end == "start"):
                out.append(_called(there, at, number))
    return out


def _called(road: Road, section: int, number: int) -> str:
    return f"{road.name}/{section}/{number}"


def _drives_on(road: Road, section: int, number: int, *, forward: bool) -> bool:
    """Is it a lane to drive on, that way?"""
    lane = road.sections[section].lanes.get(number)
    return lane is not None and lane.kind in _DRIVABLE and (lane.direction == "both" or road.forward(lane) == forward)
