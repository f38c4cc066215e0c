"""Readers of what was recorded or drawn: GPX, GeoJSON and CSV files."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit._support.files import read_text
from steerkit.paths.importers.course import Line, distinct
from steerkit.paths.importers.xml_stream import Node, records
from steerkit.paths.waypoints import distances, read_columns, travelled

Array = NDArray[np.float64]


class Track:
    """Positions as they were read: latitude and longitude [degrees] or x and y [m], time [s] and speed [m/s]."""

    def __init__(self, name: str, *, flat: bool = False, drawn: bool = False):
        self.name, self.flat, self.drawn = name, flat, drawn
        self.a, self.b = array("d"), array("d")
        """Latitude and longitude, or x and y where `flat`."""
        self.t, self.v = array("d"), array("d")
        """NaN where the file has none."""

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
    root = ""
    for record in records(file, {"trkpt", "rtept", "name"}, {"gpx", "trk", "rte", "wpt"}):
        if isinstance(record, str):
            root = root or record
            if record in ("trk", "rte"):
                tracks.append(Track(str(len(tracks)), drawn=record == "rte"))
        elif record.tag == "name":
            used = {track.name for track in tracks}
            if tracks and not tracks[-1].a and record.text.strip() and record.text.strip() not in used:
                tracks[-1].name = record.text.strip().replace(",", " ")
        elif tracks:
            t, v = record.find("time"), _deep(record, "speed")
            time = _seconds(t) if t is not None else math.nan
            tracks[-1].add(record.number("lat"), record.number("lon"), time, v.value() if v is not None else math.nan)
    require(root == "gpx", file, "is no GPX file: its first element is no <gpx>")
    return [track for track in tracks if len(track.a) > 1]


def _deep(node: Node, tag: str) -> Node | None:
    if node.tag == tag:
        return node
    return next((found for child in node.children if (found := _deep(child, tag)) is not None), None)


def _seconds(node: Node) -> float:
    try:
        when = datetime.fromisoformat(node.text.strip())
    except ValueError:
        raise ValueError(f"{node.where}: <time> is {node.text.strip()[:40]!r}, expected 2026-11-22T15:00:00Z") from None
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


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
    tracks: list[Track] = []
    reader = _GeoJson(file, tracks)
    try:
        with FilePath(file).open("rb") as stream:
            for prefix, event, value in ijson.parse(stream, use_float=True, buf_size=_CHUNK):
                reader.take(prefix, event, value)
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror})") from error
    except (ijson.JSONError, UnicodeError, RecursionError) as error:
        raise ValueError(f"{file}: no JSON, damaged or cut off ({' '.join(str(error).split())[:80]})") from error
    kind = reader.kind
    require(kind in _GEO, file, f"type {kind!r}, expected GeoJSON: {', '.join(_GEO)}")
    return [track for track in tracks if len(track.a) > 1]


_GEO = ("FeatureCollection", "Feature", "GeometryCollection", "LineString", "MultiLineString")
_DEEPEST, _CHUNK = 40, 1 << 12


class _GeoJson:
    """Takes the events of a JSON parser one by one, and keeps only numbers."""

    def __init__(self, file: str, tracks: list[Track]):
        self.file, self.tracks = file, tracks
        self.kind, self.flat = "", False
        self.depth = 0
        self.begun = -1
        """How deep the coordinates at hand began; -1: none."""
        self.point: list[float] = []
        self.fresh = Track("")
        self.waiting: list[Track] = []
        """Lines of the feature at hand."""
        self.geometry, self.name, self.times = "", "", array("d")

    def take(self, prefix: str, event: str, value: Any) -> None:
        """One event."""
        last = prefix.rpartition(".")[2]
        if event in ("start_map", "start_array"):
            self.depth += 1
            require(self.depth <= _DEEPEST, self.file, f"more than {_DEEPEST} brackets within each other: no GeoJSON")
        if event in ("end_map", "end_array"):
            self.depth -= 1
        if event == "start_array" and last == "coordinates" and (prefix == last or "geometr" in prefix):
            self.begun = self.depth
        if self.begun >= 0:
            self._coordinate(event, value)
        elif prefix == "type":
            self.kind = str(value)
        elif prefix == "crs.properties.name":
            self.flat = not any(word in str(value) for word in ("CRS84", "4326"))
        elif event == "string" and last == "type" and "geometr" in prefix.rpartition(".")[0]:
            self.geometry = value
        elif last in ("name", "id", "@id") and event in ("string", "number") and "." in prefix and "crs" not in prefix:
            self.name = self.name or str(value).replace(",", " ")
        elif event == "string" and ("coordTimes" in prefix or ".times" in prefix):
            node = Node("time", {}, self.file)
            node.text = value
            self.times.append(_seconds(node))
        if event == "end_map" and ((last == "item" and prefix.count("item") == 1) or not prefix):
            self._finish()

    def _coordinate(self, event: str, value: Any) -> None:
        if event == "number":
            require(math.isfinite(value), self.file, f"a coordinate {value}, expected numbers")
            self.point.append(float(value))
        elif event == "end_array":
            if self.point:
                require(len(self.point) >= 2, self.file, f"a position {self.point}, expected longitude and latitude")
                self.fresh.add(self.point[1], self.point[0])
                self.point.clear()
            elif len(self.fresh.a):
                self.waiting.append(self.fresh)
                self.fresh = Track("")
            if self.depth < self.begun:
                if len(self.fresh.a):
                    self.waiting.append(self.fresh)
                    self.fresh = Track("")
                self.begun = -1
        elif event != "start_array":
            raise ValueError(f"{self.file}: {str(value)[:40]!r} among the coordinates, expected numbers")

    def _finish(self) -> None:
        """The end of a feature: its lines get its name and times."""
        lines = self.waiting if self.geometry in ("LineString", "MultiLineString") or not self.geometry else []
        used = {track.name for track in self.tracks}
        base = self.name or str(len(self.tracks))
        for k, track in enumerate(lines):
            name = base + (f".{k}" if len(lines) > 1 else "")
            track.name = name if name not in used else f"{name}#{len(self.tracks)}".replace("#", "-")
            if len(lines) == 1 and len(self.times) == len(track.a):
                track.t = self.times
            track.drawn = not math.isfinite(track.t[0])
            track.flat = self.flat
            if self.flat:
                track.a, track.b = track.b, track.a
            self.tracks.append(track)
        self.waiting, self.geometry, self.name, self.times = [], "", "", array("d")


def csv(file: str) -> list[Track]:
    """The points of a CSV file with columns x, y [m] or lat, lon [degrees], and t [s], v [m/s] where there are any."""
    try:
        text = read_text(file, "course")
        columns = read_columns(text, file)
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror})") from error
    flat = {"x", "y"} <= columns.keys()
    require(flat or {"lat", "lon"} <= columns.keys(), file, f"columns {', '.join(columns)}; valid: x, y or lat, lon")
    said = re.search(r"^#.*: (closed|open) path, ([\d.]+) m", text, re.MULTILINE)
    del text
    track = Track("0", flat=flat)
    track.a, track.b = (array("d", columns[key].tobytes()) for key in (("x", "y") if flat else ("lat", "lon")))
    if said and flat:
        steps = np.hypot(np.diff(columns["x"]), np.diff(columns["y"]))
        gap = math.dist((track.a[0], track.b[0]), (track.a[-1], track.b[-1]))
        length = float(steps.sum()) + (min(gap, 1.5 * float(np.median(steps))) if said[1] == "closed" else 0.0)
        found_text = f"its first line says {said[2]} m, its points make {length:.1f} m: cut short, or changed by hand"
        require(
            abs(length - float(said[2])) < 0.5 + 2e-3 * length,
            file,
            f"{found_text}; write it again, or delete that line",
        )
    for key, column in (("t", track.t), ("v", track.v)):
        column.frombytes(columns[key].tobytes() if key in columns else np.full(len(track.a), np.nan).tobytes())
    return [track]


def numbers(track: Track) -> Iterator[Array]:
    """Its four columns as arrays, in the same memory."""
    return (np.frombuffer(column) for column in (track.a, track.b, track.t, track.v))


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
    remark = f"round {number} of {found}: points {begins[number - 1]} to {begins[number] - 1}, {left} others left out"
    return part, True, (remark,) if left else ()


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
