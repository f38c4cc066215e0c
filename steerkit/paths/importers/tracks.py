"""Readers of what was recorded or drawn: GPX, KML, TCX, GeoJSON and CSV files."""

import functools
import itertools
import json
import math
from array import array
from collections.abc import Callable, Iterable, Iterator
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit._support.files import read_text, seconds_of
from steerkit.diagram.maths import Array
from steerkit.paths import waypoints
from steerkit.paths.importers.course import Line, distinct
from steerkit.paths.importers.xml_stream import finite, number, records, shown, value


class Track:
    """Positions as they were read: latitude and longitude [degrees] or x and y [m], time [s] and speed [m/s]."""

    def __init__(self, name: str, *, flat: bool = False, drawn: bool = False):
        self.name, self.flat, self.drawn = name, flat, drawn
        self.a, self.b = array("d"), array("d")
        """Latitude and longitude, or x and y where `flat`."""
        self.t, self.v = array("d"), array("d")
        """NaN, or nothing at all, where the file has none."""
        self.bad: list[str] = []
        """Why positions are left out, one each."""

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
        names = ("x", "y") if self.flat else ("lat", "lon")
        return Line(xy=waypoints.placed(dict(zip(names, map(np.frombuffer, (self.a, self.b)))), self.name)[0])

    def driven(self, noise: float, span: tuple[float, float], where: str) -> tuple[Line, list[str]]:
        """Its line without what was recorded at rest, and what was done; span: from and to, after its start [s]."""
        line = self.line()
        if self.flat:
            waypoints.check_metres(line.xy, where)
        t, v = (np.array(column) if column else np.full(len(line.xy), np.nan) for column in (self.t, self.v))
        timed = not self.drawn and np.isfinite(t).sum() > 0.5 * len(t)
        require(timed or span == EVER, where, "from, to [s] choose by time, which these positions are without")
        line, more = (line, []) if self.drawn else cleaned(line.xy, t, v, noise, where, span)
        return line, waypoints.said_of(self.bad) + more

    def read(
        self, where: str, place: Callable[[], Iterable[float]], t: object = None, v: Element | None = None
    ) -> None:
        """One more, if its latitude and longitude, or x and y, time and speed are numbers and it is on Earth."""
        try:
            a, b = place()
            require(self.flat or (abs(a) <= 90.0 and abs(b) <= 180.0), where, f"is at {a:g}, {b:g}, expected degrees")
            read = a, b, math.nan if t is None else _seconds(str(t)), math.nan if v is None else value(v)
        except ValueError as error:
            self.bad.append(str(error))
            return
        for column, one in zip((self.a, self.b, self.t, self.v), read):
            column.append(one)

    def trim(self) -> None:
        """Leave out a first and a last position that are wrong: the first would be the origin of all."""
        a, b, t = (np.array(column) for column in (self.a, self.b, self.t))
        for end, why in waypoints.stray_ends(a, b, t, flat=self.flat, drawn=self.drawn).items():
            self.bad.append(why)
            for column in (self.a, self.b, self.t, self.v):
                column.pop(end)

    def call(self, name: str, others: "Iterable[Track]") -> None:
        """Its name, unless it has one or another track has it; a comma would part keys of an address."""
        name = " ".join(name.replace(",", " ").split())
        if name and not self.a and name not in {track.name for track in others}:
            self.name = name


def gpx(file: str) -> list[Track]:
    """The tracks and routes of a GPX file, segments of a track one after the other; raises ValueError as it is broken.

    A track was recorded, a route drawn. Source: GPX 1.1 schema (Topografix); speeds of GPX 1.0 and extensions are read.
    """
    tracks: list[Track] = []
    for node in _whole(records(file, ("trkpt", "rtept", "name"), ("trk", "rte", "wpt")), tracks):
        if node.tag in ("trk", "rte"):
            tracks.append(Track(str(len(tracks)), drawn=node.tag == "rte"))
        elif not tracks or node.tag == "wpt":
            continue
        elif node.tag == "name":
            tracks[-1].call(node.text or "", tracks)
        else:
            place = functools.partial(map, functools.partial(number, node), ("lat", "lon"))
            tracks[-1].read(shown(node), place, node.findtext("time"), next(node.iter("speed"), None))
    return _some(tracks)


def tcx(file: str) -> list[Track]:
    """The activities and courses of a TCX file, laps one after the other; trackpoints without a position are passed.

    Raises ValueError as it is broken. Source: TrainingCenterDatabase v2 schema (Garmin).
    """
    tracks: list[Track] = []
    for node in _whole(records(file, ("Trackpoint", "Name"), ("Activity", "Course")), tracks):
        if node.tag in ("Activity", "Course"):
            tracks.append(Track(str(len(tracks))))
        elif tracks and node.tag == "Name":
            tracks[-1].call(node.text or "", tracks)
        elif tracks and (at := node.find("Position")) is not None:
            place = [*at.iterfind("LatitudeDegrees"), *at.iterfind("LongitudeDegrees")]
            tracks[-1].read(
                shown(node), functools.partial(map, value, place), node.findtext("Time"), next(node.iter("Speed"), None)
            )
    return _some(tracks)


def kml(file: str) -> list[Track]:
    """The lines and rings (drawn) and the tracks of times (gx:Track, recorded) of a KML file's placemarks.

    Raises ValueError as it is broken. Source: OGC KML 2.3.
    """
    tracks: list[Track] = []
    for mark in _whole(records(file, ("Placemark",)), tracks):
        for node in mark.iter():
            if node.tag not in ("LineString", "LinearRing", "Track"):
                continue
            tracks.append(Track(str(len(tracks)), drawn=node.tag != "Track"))
            tracks[-1].call(mark.findtext("name") or "", tracks)
            times: list[str | None] = [when.text or "" for when in node.iterfind("when")]
            places = [(at.text or "").split() for at in node.iterfind("coord")]
            if tracks[-1].drawn:
                places = [at.split(",") for at in (node.findtext("coordinates") or "").split()]
                times = [None] * len(places)
            what = f"{len(times)} times and {len(places)} positions, expected as many"
            require(len(times) == len(places), f"Track {tracks[-1].name}", what)
            for at, t in zip(places, times):
                tracks[-1].read(shown(node), functools.partial(map, finite, at[1::-1], ("lat", "lon")), t)
    return _some(tracks)


def _whole(nodes: Iterator[Element], tracks: list[Track]) -> Iterator[Element]:
    """The elements of a file; of one that is cut off after positions, those before, and the track says so."""
    try:
        yield from nodes
    except ValueError as error:
        if not any(len(track.a) > 1 for track in tracks):
            raise
        tracks[-1].bad.append(f"all that follows, {error}")


def _some(tracks: list[Track]) -> list[Track]:
    """All of them without wrong ends; ValueError where none has two positions, and some position says why."""
    for track in tracks:
        track.trim()
    bad = [why for track in tracks for why in track.bad]
    if bad and not any(len(track.a) > 1 for track in tracks):
        raise ValueError(bad[0])
    return tracks


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
        data = json.loads(read_text(file, "course"))
    except (json.JSONDecodeError, ValueError, RecursionError) as error:
        raise ValueError(f"{file}: no JSON, damaged or cut off ({' '.join(str(error).split())[:80]})") from error
    data = data if isinstance(data, dict) else {}
    kind, tracks = data.get("type", ""), list[Track]()
    require(kind in _GEO, file, f"type {kind!r:.40}, expected GeoJSON: {', '.join(_GEO)}")
    try:
        features = data["features"] if kind == "FeatureCollection" else [data]
        crs = str(data["crs"]["properties"]["name"]) if data.get("crs") else "CRS84"
        flat = not any(word in crs for word in ("CRS84", "4326"))
    except (KeyError, TypeError) as error:
        raise ValueError(f"{file}: no GeoJSON, or damaged ({type(error).__name__}: {error})") from error
    for k, feature in enumerate(features):
        try:
            tracks += _lines(feature, tracks, flat)
        except (AttributeError, KeyError, TypeError, ValueError) as error:  # not the next one's fault
            tracks.append(Track(f"number {k}"))
            tracks[-1].bad.append(f"no GeoJSON, or damaged ({type(error).__name__}: {error})")
    return _some(tracks)


_GEO = ("FeatureCollection", "Feature", "GeometryCollection", "LineString", "MultiLineString")


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
        for point, stamp in zip(points, times if timed else [None] * len(points)):
            track.read("coordinates", functools.partial(_place, point, flat), stamp)
        made.append(track)
    return made


def _place(point: Any, flat: bool) -> list[float]:
    """x and y, or latitude and longitude, of a position of GeoJSON."""
    good = isinstance(point, list) and len(point) >= 2
    good = good and all(type(x) in (int, float) and abs(x) < 1e9 for x in point)  # nor NaN
    require(good, "coordinates", f"a position {point}, expected longitude and latitude, as numbers"[:200])
    return point[:2] if flat else point[1::-1]


def csv(file: str) -> list[Track]:
    """The points of a CSV file with columns x, y [m] or lat, lon [degrees], and t [s], v [m/s] where there are any."""
    text, bad = read_text(file, "course", latin=True), dict[int, str]()
    columns = waypoints.read_columns(text, file, bad)
    flat = {"x", "y"} <= columns.keys()
    require(flat or {"lat", "lon"} <= columns.keys(), file, f"columns {', '.join(columns)}; valid: x, y or lat, lon")
    said = waypoints.stated(text)
    del text
    track = Track("0", flat=flat)
    track.bad += bad.values()
    names = ("x" if flat else "lat", "y" if flat else "lon", "t", "v")
    for column, name in zip((track.a, track.b, track.t, track.v), names):
        column.frombytes(columns.pop(name, np.empty(0)).tobytes())
    if said and flat:
        xy = track.line().xy
        steps, gap = waypoints.distances(xy), math.dist(xy[0], xy[-1])
        length = float(steps.sum()) + (min(gap, 1.5 * float(np.median(steps))) if said[0] else 0.0)
        waypoints.check_stated(said[1], length, 0.5 + 2e-3 * length, file)
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


EVER = (-math.inf, math.inf)
"""From and to of all that was recorded [s]."""


def cleaned(
    xy: Array, t: Array, v: Array, noise: float, where: str, span: tuple[float, float] = EVER
) -> tuple[Line, list[str]]:
    """The points of a track that tell where the way is, with the speed at each, and what was left out.

    xy (n, 2) [m]; t (n,) [s] and v (n,) [m/s], NaN where the receiver does not say. Where the car stood, one point of
    many is left. At gaps, where time runs back and at jumps that no car makes the track is parted: the longest part
    within the span [s] is taken. Raises ValueError where less than four points are left.
    """
    known = np.isfinite(t)
    if known.sum() <= 0.5 * len(t) or not np.diff(t[known]).any():
        notes = ["the positions' times do not rise: speeds are not known"] if known.any() else []
        return distinct(Line(xy=xy, v=v if np.isfinite(v).all() else None), where), notes
    known[known] = np.diff(t[known], prepend=-np.inf) != 0.0
    xy, t, v = xy[known], t[known], v[known]
    notes = [f"left out {(~known).sum()} points without a time of their own"] if not known.all() else []
    far = np.hypot(*(xy[2:] - xy[:-2]).T) - min(6.0 * noise, 30.0) <= waypoints.FASTEST * np.abs(t[2:] - t[:-2])
    jumps = waypoints.distances(xy) - min(6.0 * noise, 30.0) > waypoints.FASTEST * np.abs(np.diff(t))
    wrong = np.flatnonzero(jumps[1:] & jumps[:-1] & far) + 1
    if wrong.size:
        notes.append(f"left out {wrong.size} wrong positions, which no car reaches; the first is point {wrong[0]}")
        xy, t, v = (np.delete(a, wrong, axis=0) for a in (xy, t, v))
    since = t - t[0]
    within = (span[0] <= since) & (since <= span[1])
    many = f"{within.sum()} points with times of their own, expected 4 or more"
    require(within.sum() >= 4, where, f"{many}; it lasts from 0 to {since.max():.0f} s")
    xy, t, v, since = xy[within], t[within], v[within], since[within]
    moved, steps = waypoints.distances(xy), np.diff(t)
    lost = (steps > max(_LOST, 3.0 * float(np.median(np.abs(steps))))) & (moved > _MOVED + 6.0 * noise)
    breaks = np.flatnonzero(lost | (steps < 0.0) | (moved - min(6.0 * noise, 30.0) > waypoints.FASTEST * np.abs(steps)))
    if breaks.size:
        ends = [0, *(breaks + 1), len(t)]
        parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
        metres = [float(waypoints.distances(xy[part]).sum()) if part.stop - part.start >= 4 else 0.0 for part in parts]
        part = parts[int(np.argmax(metres))]
        require(max(metres) > 0.0, where, f"is in {len(parts)} parts of less than 4 points: gaps, or time runs back")
        k = breaks[0]
        why = "time runs back" if steps[k] < 0.0 else f"a gap of {steps[k]:.0f} s and {moved[k]:.0f} m"
        taken = f"{since[part][0]:.0f} to {since[part][-1]:.0f} s, {max(metres):.0f} of {sum(metres):.0f} m"
        longest = f"the longest of {len(parts)} parts is taken, {taken}; FILE#from=...,to=... [s] chooses"
        notes.append(f"{why} after {since[k]:.0f} s: {longest}")
        xy, t, v = xy[part], t[part], v[part]
    kept = _moving(xy, t, noise)
    if not kept.all():
        notes.append(f"left out {(~kept).sum()} of {len(kept)} points, recorded while the car stood")
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
        near[max(k - 1, 0) : k + 2] = True  # a slope needs a neighbour, however late
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
    steps = waypoints.distances(xy)
    usual = float(np.median(steps))
    s = waypoints.travelled(xy)
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
