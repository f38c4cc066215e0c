"""Readers of lanelets and ways: CommonRoad scenarios, and OSM files with plain ways or with Lanelet2's lanelets."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.paths.importers.course import Line
from steerkit.paths.importers.network import Map, Piece
from steerkit.paths.importers.xml_stream import Node, records
from steerkit.paths.waypoints import check_gps, distances, travelled

Array = NDArray[np.float64]

KMH = 1.0 / 3.6
_UNITS = {"": KMH, "km/h": KMH, "kmh": KMH, "kph": KMH, "mph": 0.44704, "m/s": 1.0, "knots": 1852.0 / 3600.0}
"""Of a speed limit in OSM, and what one of them is [m/s]."""
_WAYS = [
    "motorway",
    "trunk",
    "primary",
    "secondary",
    "tertiary",
    "unclassified",
    "residential",
    "living_street",
    "service",
    "road",
    "track",
    "raceway",
    "motorway_link",
    "trunk_link",
    "primary_link",
    "secondary_link",
    "tertiary_link",
    "busway",
]
"""`highway` of ways for cars."""
_WIDEST = 20.0
"""A lanelet is no wider [m]."""


def commonroad(file: str) -> Map:
    """The lanelets of a CommonRoad scenario: each one's centre between its bounds, point by point.

    Speed limits are those of the signs that lanelets refer to (type 274, or maxspeed). Source: CommonRoad XML format
    2018b and 2020a. Raises ValueError for what is no such file, and for bounds that do not belong together.
    """
    pieces: dict[str, Piece] = {}
    signs: dict[str, float] = {}
    wanted: dict[str, list[str]] = {}
    seen = False
    for record in records(file, {"lanelet", "trafficSign"}, {"commonRoad"}):
        if isinstance(record, str):
            seen = True
        elif record.tag == "trafficSign":
            signs |= _limit_of_sign(record)
        else:
            name = record.get("id")
            bounds = [_points(record.find(side), record.where, side) for side in ("leftBound", "rightBound")]
            line = _between(*bounds, where=record.where, matched=True)
            speed = record.find("speedLimit")
            limit = speed.value() if speed is not None and not speed.children else math.nan
            wanted[name] = [node.get("ref") for node in record.all("trafficSignRef")]
            require(name not in pieces, record.where, f"two lanelets of the name {name}")
            kind = (node.text.strip() for tag in ("type", "laneletType") for node in record.all(tag))
            pieces[name] = Piece(
                group=name,
                length=_length(line),
                next=tuple(node.get("ref") for node in record.all("successor")),
                line=partial(_limited, line, signs, wanted[name], limit),
                about=" ".join(kind),
            )
    require(seen, file, "is no CommonRoad file: its first element is no <commonRoad>")
    require(pieces, file, "holds no lanelets")
    return Map(kind="lanelet", pieces=pieces, noise=0.05, drawn=True)


def _points(bound: Node | None, where: str, side: str) -> Array:
    if bound is None:
        raise ValueError(f"{where}: no {side}")
    rows = []
    for point in bound.all("point"):
        x, y = point.find("x"), point.find("y")
        if x is None or y is None:
            raise ValueError(f"{point.where}: a point without x or y")
        rows.append((x.value(), y.value()))
    require(len(rows) >= 2, where, f"{side} has {len(rows)} points, expected 2 or more")
    return np.array(rows)


def _limit_of_sign(sign: Node) -> dict[str, float]:
    for element in sign.all("trafficSignElement"):
        kind, value = element.find("trafficSignID"), element.find("additionalValue")
        if kind is not None and value is not None and kind.text.strip().lower() in ("274", "maxspeed", "r2-1"):
            return {sign.get("id"): value.value()}  # [m/s]
    return {}


def _limited(xy: Array, signs: Mapping[str, float], refs: list[str], limit: float) -> Line:
    limits = [signs[ref] for ref in refs if ref in signs] + [limit] * math.isfinite(limit)
    return Line(xy=xy, v_limit=np.full(len(xy), min(limits)) if limits else None)


def _between(left: Array, right: Array, *, where: str, matched: bool) -> Array:
    """The line in the middle of two bounds: of their points in pairs, or of points at equal shares of their lengths."""
    if not matched or len(left) != len(right):
        require(not matched, where, f"{len(left)} points left and {len(right)} right, expected as many")
        shares = [_shares(bound) for bound in (left, right)]
        at = np.unique(np.concatenate(shares))
        left, right = (
            np.column_stack([np.interp(at, s, c) for c in bound.T]) for s, bound in zip(shares, (left, right))
        )
    wide = np.hypot(*(left - right).T)
    require(wide.max() <= _WIDEST, where, f"its bounds are {wide.max():.3g} m apart, expected at most {_WIDEST:g}")
    middle = 0.5 * (left + right)
    along, across = np.diff(middle, axis=0), (left - right)[:-1]
    sides = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    require(float(np.median(sides)) >= 0.0, where, "its left bound is on the right")
    return middle


def _shares(points: Array) -> Array:
    s = travelled(points)
    require(s[-1] > 0.0, "lanelet", "a bound without length")
    return s / s[-1]


def _length(xy: Array) -> float:
    return float(distances(xy).sum())


class _Osm:
    """Nodes by number, in arrays: a dictionary of them would take several times the file."""

    def __init__(self) -> None:
        self.ids, self.lat, self.lon = array("q"), array("d"), array("d")
        self.x, self.y = array("d"), array("d")
        """Lanelet2's own metres, where every node has them."""
        self.ways: dict[str, tuple[array[int], dict[str, str]]] = {}
        self.lanelets: dict[str, tuple[list[str], list[str], dict[str, str]]] = {}

    def take(self, record: Node) -> None:
        """One node, way or relation."""
        tags = {tag.get("k"): tag.get("v", "") for tag in record.all("tag")}
        if record.tag == "node":
            self.ids.append(_id(record, "id"))
            self.lat.append(record.number("lat"))
            self.lon.append(record.number("lon"))
            for column, key in ((self.x, "local_x"), (self.y, "local_y")):
                if key in tags:
                    column.append(float(tags[key]))
        elif record.tag == "way":
            self.ways[record.get("id")] = array("q", [_id(node, "ref") for node in record.all("nd")]), tags
        elif tags.get("type") == "lanelet":
            members = record.all("member")
            left, right = ([m.get("ref") for m in members if m.get("role", "") == side] for side in ("left", "right"))
            self.lanelets[record.get("id")] = left, right, tags

    def placed(self, file: str) -> tuple[tuple[float, float] | None, Any]:
        """Where x = y = 0 is [degrees], and a function of node numbers that gives their places (n, 2) [m]."""
        ids = np.array(self.ids)
        require(len(ids), file, "holds no nodes")
        order = np.argsort(ids, kind="stable")
        ids = ids[order]
        origin = None
        if len(self.x) == len(self.y) == len(ids):
            xy = np.column_stack((self.x, self.y))[order]
        else:
            import pymap3d

            lat, lon = np.array(self.lat), np.array(self.lon)
            if np.abs(lat).max() > 0.2:  # maps of nowhere lie at latitude and longitude 0
                check_gps(lat, lon, file)
            origin = (float(lat[0]), float(lon[0]))
            east, north, _ = pymap3d.geodetic2enu(lat, lon, 0.0, *origin, 0.0)
            xy = np.column_stack((east, north))[order]

        def find(wanted: Any) -> Array:
            numbers = np.asarray(wanted, dtype=np.int64)
            at = np.minimum(np.searchsorted(ids, numbers), len(ids) - 1)
            missing = numbers[ids[at] != numbers]
            require(not missing.size, file, f"node {missing[0] if missing.size else 0} is not in the file: cut out?")
            return np.asarray(xy[at])

        return origin, find


def _id(node: Node, key: str) -> int:
    try:
        return int(np.int64(int(node.get(key))))
    except (ValueError, OverflowError):
        raise ValueError(f"{node.where}: {key} = {node.get(key)[:40]!r}, expected a whole number") from None


def osm(file: str) -> Map:
    """The lanelets of an OSM file, if it has any (Lanelet2), else its ways for cars.

    A lanelet's centre is the middle of its bounds at equal shares of their lengths; lanelets follow each other where
    both bounds do. Ways are cut where they meet, and driven both ways unless `oneway` says otherwise. Positions
    become metres about the first node (ENU), or are Lanelet2's own local_x, local_y.
    Raises ValueError for what is no OSM file, and for what is missing in it.
    Source: OSM XML 0.6; Poggenhans et al. 2018.
    """
    data, seen = _Osm(), False
    for record in records(file, {"node", "way", "relation"}, {"osm"}):
        if isinstance(record, str):
            seen = True
        else:
            data.take(record)
    require(seen, file, "is no OSM file: its first element is no <osm>")
    origin, find = data.placed(file)
    pieces = _lanelets(data, find, file) if data.lanelets else _ways(data, find)
    require(pieces, file, "holds neither lanelets nor ways for cars (tag highway)")
    kind, noise = ("lanelet", 0.1) if data.lanelets else ("way", 1.0)
    return Map(kind=kind, pieces=pieces, noise=noise, drawn=True, origin_deg=origin)


def _lanelets(data: _Osm, find: Any, file: str) -> dict[str, Piece]:
    ends: dict[tuple[int, int], list[str]] = {}
    made: dict[str, tuple[Array, tuple[int, int], float, str]] = {}
    for name, (left_ways, right_ways, tags) in data.lanelets.items():
        if tags.get("subtype", "road") not in ("road", "highway", "play_street", "bus_lane", "road_shoulder"):
            continue
        where = f"{file}: lanelet {name}"
        bounds = [_chained(ways, data, where) for ways in (left_ways, right_ways)]
        bounds = _aligned(bounds[0], bounds[1], find)
        line = _between(find(bounds[0]), find(bounds[1]), where=where, matched=False)
        limit = _speed(tags.get("speed_limit", ""))
        made[name] = line, (bounds[0][-1], bounds[1][-1]), limit, tags.get("location", "")
        ends.setdefault((bounds[0][0], bounds[1][0]), []).append(name)
    return {
        name: Piece(
            group=name,
            length=_length(line),
            next=tuple(ends.get(end, ())),
            line=partial(_limited, line, {}, [], limit),
            about=about,
        )
        for name, (line, end, limit, about) in made.items()
    }


def _chained(names: list[str], data: _Osm, where: str) -> list[int]:
    """The nodes of the ways that make a bound, one after the other whichever way each was drawn."""
    require(names, where, "no left or no right bound")
    parts = []
    for name in names:
        require(name in data.ways, where, f"its bound, way {name}, is not in the file")
        parts.append([*data.ways[name][0]])
    nodes = parts.pop(0)
    while parts:
        k = next((k for k, p in enumerate(parts) if {p[0], p[-1]} & {nodes[0], nodes[-1]}), -1)
        require(k >= 0, where, "the ways of its bound do not meet")
        part = parts.pop(k)
        if nodes[-1] not in (part[0], part[-1]):
            nodes.reverse()
        nodes += (part if part[0] == nodes[-1] else part[::-1])[1:]
    require(len(nodes) >= 2, where, "a bound of fewer than two nodes")
    return nodes


def _aligned(left: list[int], right: list[int], find: Any) -> list[list[int]]:
    """The bounds in the direction of driving: the left one is on the left."""
    a, b = find(left), find(right)
    if math.dist(a[0], b[0]) + math.dist(a[-1], b[-1]) > math.dist(a[0], b[-1]) + math.dist(a[-1], b[0]):
        right, b = right[::-1], b[::-1]
    along, across = 0.5 * (a[-1] + b[-1] - a[0] - b[0]), a[0] - b[0]
    if along[0] * across[1] - along[1] * across[0] < 0.0:
        left, right = left[::-1], right[::-1]
    return [left, right]


def _ways(data: _Osm, find: Any) -> dict[str, Piece]:
    """Ways cut where they meet, forwards and, but for one-way streets, backwards."""
    cars = {name: (nodes, tags) for name, (nodes, tags) in data.ways.items() if tags.get("highway") in _WAYS}
    uses = Counter(node for nodes, _ in cars.values() for node in nodes)
    begins: dict[int, list[str]] = {}
    made: dict[str, tuple[str, Array, int, float, str, str]] = {}
    for name, (nodes, tags) in cars.items():
        cuts = [0, *(k for k in range(1, len(nodes) - 1) if uses[nodes[k]] > 1), len(nodes) - 1]
        oneway = tags.get("oneway", "yes" if tags.get("junction") == "roundabout" else "no")
        about = " ".join(filter(None, (tags.get("highway", ""), tags.get("name", ""))))
        parts = [nodes[a : b + 1] for a, b in pairwise(cuts) if b > a]
        ways = [(f"{name}/{k}", part) for k, part in enumerate(parts)] if oneway != "-1" else []
        if oneway in ("no", "-1", "false", "0"):
            ways += [(f"{name}/{k}-", part[::-1]) for k, part in reversed([*enumerate(parts)])]
        for called, part in ways:
            twin = called.removesuffix("-") if called.endswith("-") else f"{called}-"
            made[called] = name, find(part), part[-1], _speed(tags.get("maxspeed", "")), about, twin
            begins.setdefault(part[0], []).append(called)
    return {
        called: Piece(
            group=name,
            length=_length(xy),
            next=tuple(after for after in begins.get(end, ()) if after != twin),
            line=partial(_limited, xy, {}, [], limit),
            back=called.endswith("-"),
            about=about,
        )
        for called, (name, xy, end, limit, about, twin) in made.items()
    }


def _speed(text: str) -> float:
    """A speed limit of OSM in m/s; NaN where it says none that is a number."""
    number, _, unit = text.strip().partition(" ")
    digits = number.rstrip("kmphKMPH/")
    unit = (unit or number[len(digits) :]).strip().lower()
    try:
        value = float(digits) * _UNITS.get(unit, math.nan)
    except ValueError:
        return math.nan
    return value if 0.0 < value < 150.0 else math.nan
