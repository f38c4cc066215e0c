"""From an address to a course: the reader of each kind of file, what is chosen in it, and how it is smoothed."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path as FilePath

import numpy as np

from steerkit._support.errors import known, require
from steerkit.paths.importers import lanelets, tracks
from steerkit.paths.importers.course import TIGHTEST, Course, Line, laid
from steerkit.paths.importers.network import Map, Piece
from steerkit.paths.importers.opendrive import opendrive
from steerkit.paths.importers.tracks import cleaned, rounds
from steerkit.paths.importers.xml_stream import root_of
from steerkit.paths.path import Array
from steerkit.paths.waypoints import check_gps, check_metres

_RECORDED = 1.0
"""Noise of what a receiver recorded unless stated otherwise: a phone's, outdoors [m]."""
_DRAWN = 0.1
"""The same of a drawn line [m]."""


def contents(file: str) -> Map:
    """All that can be driven in a map's or track's file (what stands after a `#` is passed over).

    Raises ValueError for a file that cannot be read, is damaged, or of no known kind.
    """
    address = Address.parsed(file.partition("#")[0])
    ending = FilePath(address.file).suffix.lower()
    try:
        if ending == ".xodr":
            return opendrive(address.file)
        if ending in (".osm", ".xml"):
            root = root_of(address.file)
            readers = {"commonRoad": lanelets.commonroad, "osm": lanelets.osm, "OpenDRIVE": opendrive}
            what = f"its first element is <{root}>, expected one of {', '.join(f'<{name}>' for name in readers)}"
            require(root in readers, address.file, what)
            return readers[root](address.file)
        readers_of_tracks = {".gpx": tracks.gpx, ".csv": tracks.csv}
        found = readers_of_tracks.get(ending, tracks.geojson)(address.file)
    except MemoryError:
        raise ValueError(f"{address.file}: asks for more memory than there is: damaged?") from None
    kind = "feature" if ending in (".geojson", ".json") else "track"
    require(found, address.file, f"holds no {kind} of two points or more")
    drawn = found[0].drawn and all(track.drawn for track in found)
    pieces = {track.name: _piece(track) for track in found}
    return Map(kind=kind, pieces=pieces, noise=_DRAWN if drawn else _RECORDED, drawn=drawn)


def read_course(address: str, *, tightest: float = TIGHTEST, closed: bool | None = None) -> Course:
    """The course at an address, `FILE` or `FILE#KEY=VALUE,KEY=VALUE`: its path, the speeds along it, what was done.

    Keys of every format: noise [m], closed=yes or no, reverse=yes; of CSV: lap; GPX: track, lap; GeoJSON: feature, lap;
    OpenDRIVE: road, lane, to; CommonRoad and Lanelet2: lanelet, to; OSM: way, to. `to` names the road, lanelet or way
    to which the shortest route leads, along lanes that are connected; the one where it begins: once round.

    tightest [m]: least radius of the car. closed: as the address's, which goes before. Raises ValueError, with the
    choices, for a file with more than one road or track of which none is chosen; with the reason, for what cannot be
    driven: gaps, kinks, bends below `tightest`, lanes that are not connected; and for damaged files.
    """
    where = Address.parsed(address)
    found = contents(where.file)
    line, closed_route, remarks = chosen(found, where, closed)
    kind = KINDS[FilePath(where.file).suffix.lower()]
    first = f"read {FilePath(where.file).name} ({kind}), sha256 {_digest(where.file)}: {remarks[0]}"
    noise = _noise(found, where)
    assumed = f"noise = {noise:g} m is assumed; FILE#noise=... says otherwise"
    recorded = found.kind in ("track", "feature") and not _track(found, where).drawn
    return laid(
        line.backwards() if where.reverse else line,
        name=where.name,
        noise=noise,
        closed=closed_route,
        drawn=not recorded and found.drawn,
        tightest=tightest,
        notes=(first, *remarks[1:], *found.notes, *([assumed] if where.noise is None else [])),
        origin_deg=_origin(found, where),
        hint="; recorded too coarsely for its bends? record more often, or drive them slower" if recorded else "",
    )


def chosen(found: Map, where: Address, closed: bool | None = None) -> tuple[Line, bool, list[str]]:
    """The line that an address means, before it is smoothed; is it closed; and what to say of it."""
    choice = dict(where.choice)
    lap = _lap(choice.pop("lap", None), where.file)
    line, round_, remarks = found.route(choice, where.file)
    notes = [*remarks]
    wanted = closed if where.closed is None else where.closed
    if found.kind in ("track", "feature"):
        line, more = _recorded(_track(found, where), _noise(found, where), where.file)
        notes += more
        if wanted is not False:
            line, round_, cut = rounds(line, _noise(found, where), lap, where.file)
            notes += cut
    return line, (round_ or _meets(line.xy)) if wanted is None else wanted, notes


def _track(found: Map, where: Address) -> tracks.Track:
    name = where.choice.get(found.kind) or next(iter(found.pieces))
    track: tracks.Track = found.pieces[name].line.args[0]  # type: ignore[attr-defined]
    return track


def _noise(found: Map, where: Address) -> float:
    if where.noise is not None:
        return where.noise
    if found.kind in ("track", "feature"):
        return _DRAWN if _track(found, where).drawn else _RECORDED
    return found.noise


def _origin(found: Map, where: Address) -> tuple[float, float] | None:
    if found.kind not in ("track", "feature"):
        return found.origin_deg
    track = _track(found, where)
    return None if track.flat else (track.a[0], track.b[0])


def _piece(track: tracks.Track) -> Piece:
    return Piece(
        group=track.name, length=_rough_length(track), line=partial(_places, track), about="drawn" * track.drawn
    )


def _places(track: tracks.Track) -> Line:
    return Line(xy=np.column_stack((track.a, track.b)))


def _rough_length(track: tracks.Track) -> float:
    a, b, _, _ = tracks.numbers(track)
    if track.flat:
        return float(np.hypot(np.diff(a), np.diff(b)).sum())
    east = np.cos(np.deg2rad(np.clip(a[1:], -90.0, 90.0))) * np.diff(b)
    return float(111_320.0 * np.hypot(np.diff(a), east).sum())


def _recorded(track: tracks.Track, noise: float, where: str) -> tuple[Line, list[str]]:
    """A track in metres, without what was recorded at rest; and what was done."""
    a, b, t, v = tracks.numbers(track)
    if track.flat:
        xy: Array = np.column_stack((a, b))
        check_metres(xy, where)
    else:
        import pymap3d

        check_gps(a, b, where)
        east, north, _ = pymap3d.geodetic2enu(a, b, 0.0, a[0], b[0], 0.0)
        xy = np.column_stack((east, north))
    if track.drawn:
        return Line(xy=xy), []
    line, remarks = cleaned(xy, t if np.isfinite(t).all() else None, v, noise, where)
    return line, [*remarks]


def _meets(xy: Array) -> bool:
    """Does a line end where it began, going the same way?"""
    ends = np.array([xy[1] - xy[0], xy[-1] - xy[-2]])
    meets = float(np.hypot(*(xy[-1] - xy[0]))) < 1.0 and len(xy) > 6
    return meets and float(ends[0] @ ends[1]) > 0.0


def _lap(text: str | None, where: str) -> int | None:
    require(text is None or text.isdigit(), f"'{where}'", f"lap = {text}, expected 1, 2 ...")
    return None if text is None else int(text)


def _digest(file: str) -> str:
    with FilePath(file).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()[:16]


KINDS: Mapping[str, str] = {
    ".csv": "CSV",
    ".gpx": "GPX",
    ".geojson": "GeoJSON",
    ".json": "GeoJSON",
    ".xodr": "OpenDRIVE",
    ".xml": "CommonRoad or OSM",
    ".osm": "OSM or Lanelet2",
}
"""How the name of a file with a road in it ends, and what it then is."""
_SETTINGS = ("noise", "closed", "reverse")


@dataclass(frozen=True, kw_only=True)
class Address:
    """A file, which road or track of it, and how it is to be smoothed."""

    file: str
    choice: Mapping[str, str]
    """What is chosen by name: road, lane, lanelet, way, track, feature, to, lap."""
    noise: float | None
    """How far points lie beside the way, as a standard deviation [m]; None: the format's."""
    closed: bool | None
    """None: closed if it comes back to its beginning."""
    reverse: bool
    """The other way round."""

    @classmethod
    def parsed(cls, text: str) -> Address:
        """The address in a text: `FILE`, or `FILE#KEY=VALUE,KEY=VALUE`; raises ValueError with the valid keys."""
        file, _, rest = text.partition("#")
        values: dict[str, str] = {}
        for word in filter(None, rest.split(",")):
            key, sign, value = word.partition("=")
            require(sign and value, f"'{text}'", f"'{word}', expected KEY=VALUE, such as noise=0.5 or road=1")
            require(key not in values, f"'{text}'", f"{key} stands twice")
            values[key] = value
        kind = FilePath(file).suffix.lower()
        known(kind or "none", KINDS, "a course's file: ending")
        choice = {key: value for key, value in values.items() if key not in _SETTINGS}
        for key in choice:
            valid = CHOICES[kind]
            known(key, (*valid, *_SETTINGS), f"'{text}': {KINDS[kind]} key")
        return cls(
            file=file,
            choice=choice,
            noise=_noise_of(values["noise"], text) if "noise" in values else None,
            closed=_yes_or_no("closed", values["closed"], text) if "closed" in values else None,
            reverse=_yes_or_no("reverse", values["reverse"], text) if "reverse" in values else False,
        )

    @property
    def name(self) -> str:
        """What the course is called: the file's name, and what of it."""
        parts = [FilePath(self.file).stem, *(f"{key}{value}" for key, value in self.choice.items())]
        parts += ["reversed"] * self.reverse
        clean = "".join(c if c.isalnum() or c in "-_." else "_" for c in "-".join(parts))
        return clean.replace("--", "-_")  # two hyphens part the names of scenarios


CHOICES: Mapping[str, tuple[str, ...]] = {
    ".csv": ("lap",),
    ".gpx": ("track", "lap"),
    ".geojson": ("feature", "lap"),
    ".json": ("feature", "lap"),
    ".xodr": ("road", "lane", "to"),
    ".xml": ("lanelet", "way", "to"),
    ".osm": ("lanelet", "way", "to"),
}
"""What can be chosen by name, by the file's ending."""


def is_road(name: str) -> bool:
    """Does a course's name mean a file other than a plain CSV, or something in a file?"""
    file, sign, _ = name.partition("#")
    ending = FilePath(file).suffix.lower()
    return ending in KINDS and (bool(sign) or ending != ".csv")


def _noise_of(text: str, where: str) -> float:
    try:
        noise = float(text)
    except ValueError:
        noise = -1.0
    require(0.0 <= noise <= 10.0, f"'{where}'", f"noise = {text} [m], expected 0 to 10")
    return noise


def _yes_or_no(key: str, text: str, where: str) -> bool:
    return known(text, ("yes", "no"), f"'{where}': {key}") == "yes"
