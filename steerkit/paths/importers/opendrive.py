"""OpenDRIVE files: roads, the centres of their lanes, and how lanes are linked."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.paths.importers.course import Line as Centre
from steerkit.paths.importers.network import Map, Piece
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
    junctions, speeds, left-hand traffic (rule), reversed lanes. Reported and not used: elevation, superelevation,
    shape, geoReference. Raises ValueError for a map that is damaged, torn or contradicts itself.
    Source: ASAM OpenDRIVE 1.4 to 1.8.
    """
    roads, junctions, seen, remarks = read(file)
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
    return Map(kind="road", pieces=pieces, noise=0.02, drawn=False, notes=tuple(remarks))


Links = dict[tuple[str, str, int], list[tuple[str, str, int]]]
"""Of junctions: (junction, incoming road, its lane) -> (connecting road, start or end of it, its lane)."""


def read(file: str) -> tuple[dict[str, Road], Links, bool, list[str]]:
    """Roads by name, the links of junctions, whether it is OpenDRIVE at all, and what the reader notes about it."""
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
    remarks = [
        f"{what}{f' (in {count} roads)' if count > 1 else ''}: read but not used" for what, count in tells.items()
    ]
    return roads, junctions, seen, remarks


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
    """Remarks on a reference line; ValueError where its pieces do not meet or its length is not the stated one."""
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
