"""Readers of what was recorded or drawn: GPX, GeoJSON and CSV files."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit._support.files import opened, read_text
from steerkit._support.tables import seconds_of
from steerkit.paths.importers.course import Line, distinct
from steerkit.paths.importers.xml_stream import number, records, value
from steerkit.paths.waypoints import (
    check_gps,
    check_metres,
    check_stated,
    distances,
    east_north,
    read_columns,
    stated,
    travelled,
)

Array = NDArray[np.float64]


class Track:
    """Positions as they were read: latitude and longitude [degrees] or x and y [m], time [s] and speed [m/s]."""

    def __init__(self, name: str, *, flat: bool = False, drawn: bool = False):
        self.name, self.flat, self.drawn = name, flat, drawn
        self.a, self.b = array("d"), array("d")
        """Latitude and longitude, or x and y where `flat`."""
        self.t, self.v = array("d"), array("d")
        """NaN, or nothing at all, where the file has none."""

    @property
    def noise(self) -> float:
        """How far its points lie beside the way unless said otherwise [m]: a phone's outdoors, or a drawn line's."""
        return 0.1 if self.drawn else 1.0

    @property
    def origin_deg(self) -> tuple[float, float] | None:
        """Where x = y = 0 is [degrees], if it is known."""
        return None if self.flat else (self.a[0], self.b[0])

    def line(self) -> Line:
        """All of it in metres: as it is, or east and north of the first; raises ValueError for no place on Earth."""
        a, b = np.frombuffer(self.a), np.frombuffer(self.b)
        if self.origin_deg is None:
            return Line(xy=np.column_stack((a, b)))
        check_gps(a, b, self.name)
        return Line(xy=east_north(a, b, self.origin_deg))

    def driven(self, noise: float, where: str) -> tuple[Line, list[str]]:
        """Its line without what was recorded at rest, and what was done."""
        line = self.line()
        if self.flat:
            check_metres(line.xy, where)
        t, v = (np.array(column) if column else np.full(len(line.xy), np.nan) for column in (self.t, self.v))
        return (line, []) if self.drawn else cleaned(line.xy, t, v, noise, where)

    def add(self, a: float, b: float, t: float = math.nan, v: float = math.nan) -> None:
        """One more position."""
        self.a.append(a)
        self.b.append(b)
        self.t.append(t)
        self.v.append(v)


def gpx(file: str) -> list[Track]:
    """The tracks and routes of a GPX file, segments of a track one after the other; raises ValueError as it is broken.

    A track was recorded, a route was drawn. Source: GPX 1.1 schema (Topografix); the speed of GPX 1.0 and of
    extensions is read where it stands.
    """
    tracks: list[Track] = []
    for node in records(file, ("trkpt", "rtept", "name"), ("trk", "rte", "wpt")):
        if node.tag in ("trk", "rte"):
            tracks.append(Track(str(len(tracks)), drawn=node.tag == "rte"))
        elif not tracks or node.tag == "wpt":
            continue
        elif node.tag == "name":
            called = (node.text or "").strip()
            if called and not tracks[-1].a and called not in {track.name for track in tracks}:
                tracks[-1].name = called.replace(",", " ")
        else:
            times, speeds = node.findall("time"), [*node.iter("speed")]
            t = _seconds(times[0].text or "") if times else math.nan
            tracks[-1].add(number(node, "lat"), number(node, "lon"), t, value(speeds[0]) if speeds else math.nan)
    return [track for track in tracks if len(track.a) > 1]


def _seconds(text: str) -> float:
    found = seconds_of(text)
    if found is None:
        raise ValueError(f"time is {text.strip()[:40]!r}, expected 2026-11-22T15:00:00Z")
    return found


def geojson(file: str) -> list[Track]:
    """The lines of a GeoJSON file: LineString and MultiLineString, alone, in features and in collections.

    A line is as drawn; with as many `coordTimes` or `times` in its properties it was recorded. Positions are
    longitude, latitude in degrees (RFC 7946); with a `crs` member that names none in degrees, x, y in metres.
    Raises ValueError for what is no GeoJSON, damaged or cut off, and for coordinates that are no numbers.
    """
    try:
        import ijson
    except ImportError:
        raise ValueError(f"{file}: maps and tracks need a package: pip install 'steerkit-control[roads]'") from None
    kind, crs, tracks = "", "CRS84", list[Track]()
    try:
        with opened(file) as stream:
            for prefix, _, found in ijson.parse(_shallow(ijson.basic_parse(stream, use_float=True, buf_size=_CHUNK))):
                kind = found if prefix == "type" else kind
                crs = found if prefix == "crs.properties.name" else crs
            require(kind in _GEO, file, f"type {kind!r}, expected GeoJSON: {', '.join(_GEO)}")
            stream.seek(0)
            where = "features.item" if kind == "FeatureCollection" else ""
            flat = not any(word in crs for word in ("CRS84", "4326"))
            for feature in ijson.items(stream, where, use_float=True, buf_size=_CHUNK):
                tracks += _lines(feature, tracks, flat)
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror})") from error
    except (ijson.JSONError, UnicodeError, RecursionError) as error:
        raise ValueError(f"{file}: no JSON, damaged or cut off ({' '.join(str(error).split())[:80]})") from error
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"{file}: no GeoJSON, or damaged ({type(error).__name__}: {error})") from error
    return [track for track in tracks if len(track.a) > 1]


_GEO = ("FeatureCollection", "Feature", "GeometryCollection", "LineString", "MultiLineString")
_CHUNK = 1 << 12
_DEEPEST = 40


def _shallow(events: Iterable[tuple[str, Any]]) -> Iterator[tuple[str, Any]]:
    """The events; ValueError where brackets within each other would take memory by the square of their number."""
    depth = 0
    for event, found in events:
        depth += event.startswith("start") - event.startswith("end")
        if depth > _DEEPEST:
            raise ValueError(f"more than {_DEEPEST} brackets within each other: no GeoJSON")
        yield event, found


def _lines(feature: dict[str, Any], before: list[Track], flat: bool) -> list[Track]:
    """The lines of a feature, or of a geometry alone, with its name and times."""
    geometry = feature.get("geometry", feature) or {}
    parts = geometry.get("geometries", [geometry])
    lines = [part["coordinates"] for part in parts if part.get("type") == "LineString"]
    lines += [line for part in parts if part.get("type") == "MultiLineString" for line in part["coordinates"]]
    about = feature.get("properties") or {}
    base = str(about.get("name") or feature.get("id") or about.get("id") or len(before)).replace(",", " ")
    times = about.get("coordTimes") or about.get("times") or about.get("coordinateProperties", {}).get("times") or []
    used, made = {track.name for track in before}, list[Track]()
    for k, points in enumerate(lines):
        name = base + f".{k}" * (len(lines) > 1)
        timed = len(lines) == 1 and len(times) == len(points)
        track = Track(f"{name}-{len(before) + k}" if name in used else name, flat=flat, drawn=not timed)
        stamps = [_seconds(text) for text in times] if timed else [math.nan] * len(points)
        stamps.reverse()
        points.reverse()
        while points:
            point = points.pop()  # not held twice
            good = len(point) >= 2 and all(type(x) in (int, float) and math.isfinite(x) for x in point)
            require(good, "coordinates", f"a position {point}, expected longitude and latitude, as numbers")
            a, b = point[:2] if flat else point[1::-1]
            track.add(a, b, stamps.pop())
        made.append(track)
    return made


def text_of(file: str) -> str:
    """The text of a CSV file; raises ValueError for one that cannot be read, or holds none."""
    try:
        return read_text(file, "course", latin=True)
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror})") from error


def csv(file: str) -> list[Track]:
    """The points of a CSV file with columns x, y [m] or lat, lon [degrees], and t [s], v [m/s] where there are any."""
    text = text_of(file)
    columns = read_columns(text, file)
    flat = {"x", "y"} <= columns.keys()
    require(flat or {"lat", "lon"} <= columns.keys(), file, f"columns {', '.join(columns)}; valid: x, y or lat, lon")
    said = stated(text)
    del text
    track = Track("0", flat=flat)
    names = ("x" if flat else "lat", "y" if flat else "lon", "t", "v")
    for column, name in zip((track.a, track.b, track.t, track.v), names):
        column.frombytes(columns.pop(name, np.empty(0)).tobytes())
    if said and flat:
        xy = track.line().xy
        steps, gap = distances(xy), math.dist(xy[0], xy[-1])
        length = float(steps.sum()) + (min(gap, 1.5 * float(np.median(steps))) if said[0] else 0.0)
        check_stated(said[1], length, 0.5 + 2e-3 * length, file)
    return [track]


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


def cleaned(xy: Array, t: Array, v: Array, noise: float, where: str) -> tuple[Line, list[str]]:
    """The points of a track that tell where the way is, with the speed at each, and what was left out.

    xy (n, 2) [m]; t (n,) [s] and v (n,) [m/s], NaN where the receiver does not say. Where the car stood, one point of
    many is left. Raises ValueError for gaps, for times that do not rise and for jumps that no car makes.
    """
    if not np.isfinite(t).all():
        return distinct(Line(xy=xy, v=v if np.isfinite(v).all() else None), where), []
    steps = np.diff(t)
    back = np.flatnonzero(steps < 0.0)
    require(not back.size, where, f"time runs back after point {back[0] if back.size else 0}: two drives in one track?")
    new = np.concatenate(([True], steps > 0.0))
    xy, t, v = xy[new], t[new], v[new]
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
    kept = _moving(xy, t, noise)
    left_out = int((~kept).sum())
    notes = [f"left out {left_out} of {len(kept)} points, recorded while the car stood"] if left_out else []
    return distinct(Line(xy=xy[kept], v=_speeds(xy, t, v)[kept]), where), notes


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


def _speeds(xy: Array, t: Array, v: Array) -> Array:
    """Speed at each point: as the receiver says; else the slope of the distance over some seconds."""
    if np.isfinite(v).all():
        return v
    out = np.empty(len(t))
    reach = max(0.5 * _FIT, 1.5 * float(np.median(np.diff(t))))
    for k in range(len(t)):
        near = np.abs(t - t[k]) <= reach
        # the chord's length grows with noise at every step, a straight fit through the positions does not
        dt = t[near] - t[near].mean()
        out[k] = math.hypot(*(dt @ xy[near]) / (dt @ dt))
    return out


def rounds(line: Line, noise: float, which: int | None, where: str) -> tuple[Line, bool, list[str]]:
    """The line cut to one round, if it comes back to its beginning in the direction in which it left.

    which: the first round, the second ...; None: the first, if there is one. Returns whether it is a round.
    Raises ValueError for a round that was not driven.
    """
    begins = [0, *_returns(line.xy, noise)]
    found = len(begins) - 1
    if which is None and not found:
        return line, False, []
    number = which or 1
    require(1 <= number <= found, where, f"lap {number}, but it has {found or 'no'} whole rounds")
    part = line.part(slice(begins[number - 1], begins[number]))
    left = len(line.xy) - len(part.xy)
    remark = f"round {number} of {found}: points {begins[number - 1]} to {begins[number] - 1}, {left} others left out"
    return part, True, [remark] if left else []


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
