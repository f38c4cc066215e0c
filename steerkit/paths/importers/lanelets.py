"""Readers of lanelets and ways: CommonRoad scenarios, and OSM files with plain ways or with Lanelet2's lanelets."""

import re
from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from xml.etree.ElementTree import Element

import numpy as np

from steerkit._support.errors import require
from steerkit.diagram.maths import Array
from steerkit.paths.importers.course import Line
from steerkit.paths.importers.network import Map, Piece, require_some
from steerkit.paths.importers.xml_stream import get, number, records, shown, value
from steerkit.paths.waypoints import check_gps, distances, east_north, travelled

KMH = 1.0 / 3.6
_UNITS = {"": KMH, "km/h": KMH, "kmh": KMH, "kph": KMH, "mph": 0.44704, "m/s": 1.0, "knots": 1852.0 / 3600.0}
"""Of a speed limit in OSM, and what one of them is [m/s]."""
_WAYS = re.compile(
    "(motorway|trunk|primary|secondary|tertiary)(_link)?|"
    "unclassified|residential|living_street|service|road|track|raceway|busway"
)
"""`highway` of ways for cars."""
_WIDEST = 20.0
"""A lanelet is no wider [m]."""


def commonroad(file: str) -> Map:
    """The lanelets of a CommonRoad scenario: each one's centre between its bounds, point by point.

    Speed limits are those of the signs that lanelets refer to (type 274, or maxspeed). A lanelet whose bounds do not
    belong together is left out. Source: CommonRoad XML format 2018b and 2020a. Raises ValueError where none is good.
    """
    pieces: dict[str, Piece] = {}
    signs: dict[str, float] = {}
    faulty: dict[str, str] = {}
    for record in records(file, ("lanelet", "trafficSign")):
        if record.tag == "trafficSign":
            signs |= _limit_of_sign(record)
            continue
        if not len(record) and record.get("ref"):
            continue  # where a goal lies
        name = get(record, "id")
        try:
            line = _centre(record)
        except ValueError as error:
            faulty[name] = str(error)
            continue
        limits = [value(speed) for speed in record.findall("speedLimit") if not len(speed)]
        require(name not in pieces, file, f"two lanelets of the name {name}")
        kind = ((node.text or "").strip() for tag in ("type", "laneletType") for node in record.findall(tag))
        refs = [get(node, "ref") for node in record.findall("trafficSignRef")]
        pieces[name] = Piece(
            group=name,
            length=float(distances(line).sum()),
            next=tuple(get(node, "ref") for node in record.findall("successor")),
            line=partial(_limited, line, limits[:1], signs, refs),
            about=" ".join(kind),
        )
    require_some(pieces, faulty, file, "lanelets")
    return Map(kind="lanelet", pieces=pieces, noise=0.05, drawn=True, faulty=faulty)


def _centre(lanelet: Element) -> Array:
    left, right = (_points(lanelet.find(side), side) for side in ("leftBound", "rightBound"))
    if len(left) != len(right):
        raise ValueError(f"{len(left)} points left and {len(right)} right, expected as many")
    middle = _between(left, right)
    along, across = np.diff(middle, axis=0), (left - right)[:-1]
    if float(np.median(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0])) < 0.0:
        raise ValueError("its left bound is on the right")
    return middle


def _points(bound: Element | None, side: str) -> Array:
    points = [] if bound is None else bound.findall("point")
    if len(points) < 2:
        raise ValueError(f"{side} of {len(points)} points, expected 2 or more")
    rows = [[value(at) for at in (*point.findall("x")[:1], *point.findall("y")[:1])] for point in points]
    if not all(len(row) == 2 for row in rows):
        raise ValueError(f"{side} has a point without x or y")
    return np.array(rows)


def _limit_of_sign(sign: Element) -> dict[str, float]:
    for element in sign.findall("trafficSignElement"):
        kind, speed = element.findtext("trafficSignID", ""), element.find("additionalValue")
        if speed is not None and kind.strip().lower() in ("274", "maxspeed", "r2-1"):
            return {get(sign, "id"): value(speed)}  # [m/s]
    return {}


def _limited(xy: Array, limits: list[float], signs: Mapping[str, float] = {}, refs: Sequence[str] = ()) -> Line:
    """The line with the least of its speed limits and those of the signs that it refers to [m/s]."""
    limits = limits + [signs[ref] for ref in refs if ref in signs]
    return Line(xy=xy, v_limit=np.full(len(xy), min(limits)) if limits else None)


def _matched(left: Array, right: Array) -> tuple[Array, Array]:
    """Two bounds at equal shares of their lengths."""
    lengths = [travelled(bound) for bound in (left, right)]
    if min(s[-1] for s in lengths) <= 0.0:
        raise ValueError("a bound without length")
    shares = [s / s[-1] for s in lengths]
    at = np.unique(np.concatenate(shares))
    left, right = (np.column_stack([np.interp(at, s, c) for c in bound.T]) for s, bound in zip(shares, (left, right)))
    return left, right


def _between(left: Array, right: Array) -> Array:
    """The line in the middle of two bounds' points in pairs."""
    wide = np.hypot(*(left - right).T)
    if wide.max() > _WIDEST:
        raise ValueError(f"its bounds are {wide.max():.3g} m apart, expected at most {_WIDEST:g}")
    if wide.max() < 0.1:
        raise ValueError("its bounds are one line")
    return np.asarray(0.5 * (left + right))


class _Osm:
    """Nodes by number, in arrays: a dictionary of them would take several times the file."""

    def __init__(self, file: str) -> None:
        self.ids, places = array("q"), tuple(array("d") for _ in range(4))
        self.ways: dict[str, tuple[array[int], dict[str, str]]] = {}
        self.lanelets: dict[str, tuple[list[str], list[str], dict[str, str]]] = {}
        for record in records(file, ("node", "way", "relation")):
            tags = {get(tag, "k"): get(tag, "v", "") for tag in record.findall("tag")}
            if record.tag == "node":
                self.ids.append(_id(record, "id"))
                metres = (float(tags.get(key, "nan")) for key in ("local_x", "local_y"))
                for column, place in zip(places, (number(record, "lat"), number(record, "lon"), *metres)):
                    column.append(place)
            elif record.tag == "way":
                self.ways[get(record, "id")] = array("q", [_id(node, "ref") for node in record.findall("nd")]), tags
            elif tags.get("type") == "lanelet":
                left, right = (
                    [get(m, "ref") for m in record.findall("member") if m.get("role") == side]
                    for side in ("left", "right")
                )
                self.lanelets[get(record, "id")] = left, right, tags
        require(self.ids, file, "holds no nodes")
        self.order = np.argsort(self.ids, kind="stable")
        self.sorted = np.array(self.ids)[self.order]
        rows: Array = np.array(places)
        lat, lon, own = rows[0], rows[1], rows[2:]
        self.origin: tuple[float, float] | None = None  # of x = y = 0 [degrees], not of Lanelet2's own metres
        self.xy = own.T
        if not np.isfinite(own).all():
            if np.abs(lat).max() > 0.2:  # maps of nowhere lie at latitude and longitude 0
                check_gps(lat, lon, file)
            self.origin = float(lat[0]), float(lon[0])
            self.xy = east_north(lat, lon, self.origin)

    def find(self, wanted: Sequence[int]) -> Array:
        """The places of nodes by number (n, 2) [m]."""
        numbers = np.asarray(wanted, dtype=np.int64)
        at = np.minimum(np.searchsorted(self.sorted, numbers), len(self.sorted) - 1)
        missing = numbers[self.sorted[at] != numbers]
        if missing.size:
            raise ValueError(f"node {missing[0]} is not in the file: cut out?")
        return self.xy[self.order[at]]


def _id(node: Element, key: str) -> int:
    try:
        return int(np.int64(int(get(node, key))))
    except (ValueError, OverflowError):
        raise ValueError(f"{shown(node)}: {key} = {node.get(key)!r:.40}, expected a whole number") from None


def osm(file: str) -> Map:
    """The lanelets of an OSM file, if it has any (Lanelet2), else its ways for cars.

    A lanelet's centre is the middle of its bounds at equal shares of their lengths; lanelets follow each other where
    both bounds do. Ways are cut where they meet, and driven both ways unless `oneway` says otherwise. Positions become
    metres about the first node (ENU), or are Lanelet2's own local_x, local_y. What lacks something is left out. Raises
    ValueError for a file without anything good. Source: OSM XML 0.6; Poggenhans et al. 2018.
    """
    data = _Osm(file)
    faulty: dict[str, str] = {}
    pieces = _lanelets(data, faulty) if data.lanelets else _ways(data, faulty)
    kind, noise = ("lanelet", 0.1) if data.lanelets else ("way", 1.0)
    require_some(
        pieces, faulty, file, "lanelets to drive on" if data.lanelets else "lanelets or ways for cars (tag highway)"
    )
    return Map(kind=kind, pieces=pieces, noise=noise, drawn=True, origin_deg=data.origin, faulty=faulty)


def _lanelets(data: _Osm, faulty: dict[str, str]) -> dict[str, Piece]:
    begins: dict[tuple[int, int], list[str]] = {}
    made: dict[str, tuple[Array, tuple[int, int], dict[str, str]]] = {}
    for name, (left_ways, right_ways, tags) in data.lanelets.items():
        if tags.get("subtype", "road") not in ("road", "highway", "play_street", "bus_lane", "road_shoulder"):
            continue
        try:
            left, right = _chained(left_ways, data), _chained(right_ways, data)
            a, b = data.find(left), data.find(right)
            # in the direction of driving each has the other on its side, wherever along the road they begin
            left, right = left if _beside(a, b) < 0.0 else left[::-1], right if _beside(b, a) > 0.0 else right[::-1]
            line = _between(*_matched(data.find(left), data.find(right)))
        except ValueError as error:
            faulty[name] = str(error)
            continue
        made[name] = line, (left[-1], right[-1]), tags
        begins.setdefault((left[0], right[0]), []).append(name)
    return {
        name: Piece(
            group=name,
            length=float(distances(line).sum()),
            next=tuple(begins.get(end, ())),
            line=partial(_limited, line, _speeds(tags.get("speed_limit", ""))),
            about=tags.get("location", ""),
        )
        for name, (line, end, tags) in made.items()
    }


def _chained(names: list[str], data: _Osm) -> list[int]:
    """The nodes of the ways that make a bound, one after the other whichever way each was drawn."""
    if not names:
        raise ValueError("no left or no right bound")
    for name in names:
        if name not in data.ways or not len(data.ways[name][0]):
            raise ValueError(f"its bound, way {name}, {'has no nodes' if name in data.ways else 'is not in the file'}")
    nodes, *parts = (data.ways[name][0].tolist() for name in names)
    while parts:
        k = next((k for k, p in enumerate(parts) if {p[0], p[-1]} & {nodes[0], nodes[-1]}), -1)
        if k < 0:
            raise ValueError("the ways of its bound do not meet")
        part = parts.pop(k)
        if nodes[-1] not in (part[0], part[-1]):
            nodes.reverse()
        nodes += (part if part[0] == nodes[-1] else part[::-1])[1:]
    if len(nodes) < 2:
        raise ValueError("a bound of fewer than two nodes")
    return nodes


def _beside(line: Array, points: Array) -> float:
    """How far points lie to the left of the line's nearest segment, in the mean [m]."""
    step, points = np.diff(line, axis=0), points[:: max(1, len(points) // 32)]  # some will do, however many there are
    along = np.maximum((step**2).sum(axis=1), 1e-12)
    away = points[:, None] - line[:-1]
    share = np.clip((away * step).sum(axis=2) / along, 0.0, 1.0)
    nearest = np.hypot(*np.moveaxis(away - share[..., None] * step, 2, 0)).argmin(axis=1)
    k = np.arange(len(points))
    cross = step[nearest, 0] * away[k, nearest, 1] - step[nearest, 1] * away[k, nearest, 0]
    return float((cross / np.sqrt(along[nearest])).mean())


def _ways(data: _Osm, faulty: dict[str, str]) -> dict[str, Piece]:
    """Ways cut where they meet, forwards and, but for one-way streets, backwards."""
    cars = {
        name: (nodes.tolist(), tags)
        for name, (nodes, tags) in data.ways.items()
        if _WAYS.fullmatch(tags.get("highway", ""))
    }
    uses = Counter(node for nodes, _ in cars.values() for node in nodes)
    begins: dict[int, list[str]] = {}
    made: dict[str, tuple[str, list[int], dict[str, str]]] = {}
    for name, (nodes, tags) in cars.items():
        cuts = [0, *(k for k in range(1, len(nodes) - 1) if uses[nodes[k]] > 1), len(nodes) - 1]
        parts = [(f"{name}/{k}", nodes[a : b + 1]) for k, (a, b) in enumerate(pairwise(cuts)) if b > a]
        oneway = tags.get("oneway", "yes" if tags.get("junction") == "roundabout" else "no")
        driven = parts if oneway != "-1" else []
        if oneway in ("no", "-1", "false", "0"):
            driven = driven + [(f"{called}-", part[::-1]) for called, part in reversed(parts)]
        for called, part in driven:
            made[called] = name, part, tags
            begins.setdefault(part[0], []).append(called)
    pieces = {}
    for called, (name, part, tags) in made.items():
        try:
            xy = data.find(part)
        except ValueError as error:
            faulty[name] = str(error)
            continue
        twin = called.removesuffix("-") if called.endswith("-") else f"{called}-"
        pieces[called] = Piece(
            group=name,
            length=float(distances(xy).sum()),
            next=tuple(after for after in begins.get(part[-1], ()) if after != twin),
            line=partial(_limited, xy, _speeds(tags.get("maxspeed", ""))),
            back=called.endswith("-"),
            about=" ".join(filter(None, (tags.get("highway"), tags.get("name")))),
        )
    return pieces


def _speeds(text: str) -> list[float]:
    """A speed limit of OSM in m/s; none where it says none that is a number."""
    found = re.fullmatch(r"\s*([\d.]+)\s*([a-z/]*)\s*", text.lower())
    try:
        speed = float(found[1]) * _UNITS[found[2]] if found else 0.0
    except (ValueError, KeyError):
        return []
    return [speed] if 0.0 < speed < 150.0 else []
