"""Courses from files: CSV, GPX, GeoJSON, OpenDRIVE, CommonRoad, OSM and Lanelet2."""

import hashlib
import math
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from steerkit._support.errors import known, require
from steerkit._support.files import opened, read_text, refuse_workbook
from steerkit.diagram.maths import Array
from steerkit.paths.importers import lanelets, tracks
from steerkit.paths.importers.course import TIGHTEST, Course, Line, along, course_of, laid, path_in
from steerkit.paths.importers.network import Map, Piece
from steerkit.paths.importers.opendrive import opendrive
from steerkit.paths.importers.tracks import EVER, rounds
from steerkit.paths.importers.xml_stream import root_of
from steerkit.paths.waypoints import distances, placed, read_columns, said_of, travelled

__all__ = ["TIGHTEST", "Address", "Course", "Line", "Map", "Piece", "contents", "course_of", "is_road", "read_course"]


_TABLE = tomllib.loads(FilePath(__file__).with_name("reading.toml").read_text(encoding="utf-8"))
KINDS: Mapping[str, str] = _TABLE["kinds"]
"""How the name of a file with a road in it ends, and what it then is."""
CHOICES: Mapping[str, list[str]] = _TABLE["choices"]
"""What can be chosen by name in it."""
_SETTINGS = ("noise", "closed", "reverse")
_YES = {"yes": True, "no": False}
_READERS: Mapping[str, Callable[[str], Any]] = {
    ".csv": tracks.csv,
    ".geojson": tracks.geojson,
    ".json": tracks.geojson,
    "gpx": tracks.gpx,
    "kml": tracks.kml,
    "TrainingCenterDatabase": tracks.tcx,
    "commonRoad": lanelets.commonroad,
    "osm": lanelets.osm,
    "OpenDRIVE": opendrive,
}
"""Readers of tracks or of a map, by the ending or by the first element of an XML file."""
_ROOTS = {".gpx": ("gpx",), ".kml": ("kml",), ".tcx": ("TrainingCenterDatabase",)}


def contents(file: str) -> Map:
    """All that can be driven in a map's or track's file (what stands after a `#` is passed over).

    Raises ValueError for a file that cannot be read, is damaged, or of no known kind.
    """
    file = Address.parsed(file.partition("#")[0]).file
    try:
        return _contents(file, FilePath(file).suffix.lower())
    except MemoryError:
        raise ValueError(f"{file}: asks for more memory than there is: damaged?") from None
    except ValueError as error:
        raise ValueError(f"{file}: {str(error).removeprefix(f'{file}: ')}") from error


def _contents(file: str, ending: str) -> Map:
    kind = ending
    if ending not in _READERS:
        kind, valid = root_of(file), _ROOTS.get(ending, ("commonRoad", "osm", "OpenDRIVE"))
        what = f"its first element is <{kind}>, expected one of {', '.join(f'<{name}>' for name in valid)}"
        require(kind in valid, file, what)
    made = _READERS[kind](file)
    if isinstance(made, Map):
        return made
    kind = "feature" if "json" in ending else "track"
    pieces, faulty = dict[str, Piece](), {track.name: track.bad[0] for track in made if track.bad}
    for name, track in ((track.name, track) for track in made if len(track.a) > 1):
        try:
            length = float(distances(track.line().xy).sum())
            pieces[name] = Piece(group=name, length=length, line=track.line, about="drawn" * track.drawn)
            faulty.pop(name, None)  # its good part is driven
        except ValueError as error:
            faulty[name] = str(error).removeprefix(f"{name}: ")
    first = next(iter(faulty.values()), f"holds no {kind} of two points or more")
    require(pieces, file, first)
    return Map(kind=kind, pieces=pieces, faulty=faulty, tracks={t.name: t for t in made if t.name in pieces})


def read_course(address: str, *, tightest: float = TIGHTEST, closed: bool | None = None) -> Course:
    """The course at an address, `FILE` or `FILE#KEY=VALUE,KEY=VALUE`: its path, the speeds along it, what was done.

    Keys of every format: noise [m], closed=yes or no, reverse=yes; of CSV: lap, from, to [s]; GPX, KML, TCX: track too;
    GeoJSON: feature; OpenDRIVE: road, lane, to; CommonRoad, Lanelet2: lanelet, to; OSM: way, to. `to` names the road,
    lanelet or way to which the shortest route leads, along lanes that are connected; where it begins: once round.

    The points of a CSV file without keys are exact: the course leads through them (`course_of`).

    tightest [m]: least radius of the car. closed: as the address's, which goes before. Raises ValueError, with the
    choices, for a file with more than one road or track of which none is chosen; with the reason, for what cannot be
    driven: gaps, kinks, bends below `tightest`, lanes that are not connected; and for damaged files.
    """
    where = Address.parsed(address)
    if not is_road(address):
        return _exact(where.file, closed)
    found = contents(where.file)
    line, closed_route, remarks = chosen(found, where, closed)
    source = found.source(where.choice)
    with opened(where.file) as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()[:16]
    file = FilePath(where.file)
    notes = [f"read {file.name} ({KINDS[file.suffix.lower()]}), sha256 {digest}: {remarks[0]}", *remarks[1:]]
    notes += [*found.notes, *found.left_out]
    if where.noise is None:
        notes.append(f"noise = {source.noise:g} m is assumed; FILE#noise=... says otherwise")
    recorded = source is not found and not source.drawn
    return laid(
        line.backwards() if where.reverse else line,
        name=where.name,
        noise=source.noise if where.noise is None else where.noise,
        closed=closed_route,
        drawn=source.drawn,
        tightest=tightest,
        notes=notes,
        origin_deg=source.origin_deg,
        hint="; recorded too coarsely for its bends? record more often, or drive them slower" if recorded else "",
    )


def _exact(file: str, closed: bool | None) -> Course:
    """The course through the points of a CSV file."""
    text, bad = read_text(file, "course", latin=True), dict[int, str]()
    columns = read_columns(text, file, bad)
    path = path_in(text, columns, FilePath(file).name, closed)
    s = travelled(placed(columns, file)[0])
    v, limit = (along(path, s * (path.length / s[-1]), columns.get(name)) for name in ("v", "v_limit"))
    note = f"read {FilePath(file).name}: the course leads through its {len(s)} points; FILE#noise=... [m] smooths them"
    return Course(path=path, v=v, v_limit=limit, notes=(note, *said_of(bad.values())))


def chosen(found: Map, where: "Address", closed: bool | None = None) -> tuple[Line, bool, list[str]]:
    """The line that an address means, before it is smoothed; is it closed; and what to say of it."""
    choice = dict(where.choice)
    lap = choice.pop("lap", None)
    require(lap is None or lap.isdigit(), f"'{where.file}'", f"lap = {lap}, expected 1, 2 ...")
    span = EVER
    if found.tracks:
        begin, end = (choice.pop(key, str(no)) for key, no in zip(("from", "to"), EVER))
        span = (_number(begin), _number(end))
        require(span[0] < span[1], f"'{where.file}'", f"from = {begin}, to = {end}, expected seconds from its start")
    line, round_, notes = found.route(choice, where.file)
    wanted = closed if where.closed is None else where.closed
    source = found.source(choice)
    if isinstance(source, tracks.Track):
        noise = source.noise if where.noise is None else where.noise
        line, more = source.driven(noise, span, where.file)
        notes += more
        if wanted is not False:
            line, round_, cut = rounds(line, noise, None if lap is None else int(lap), where.file)
            notes += cut
    return line, (round_ or _meets(line.xy)) if wanted is None else wanted, notes


def _number(text: str) -> float:
    return float(text) if re.fullmatch(r"-?inf|\d*\.?\d+", text) else math.nan


def _meets(xy: Array) -> bool:
    """Does a line end where it began, going the same way?"""
    ends = np.array([xy[1] - xy[0], xy[-1] - xy[-2]])
    meets = float(np.hypot(*(xy[-1] - xy[0]))) < 1.0 and len(xy) > 6
    return meets and float(ends[0] @ ends[1]) > 0.0


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
    def parsed(cls, text: str) -> "Address":
        """The address in a text: `FILE`, or `FILE#KEY=VALUE,KEY=VALUE`; raises ValueError with the valid keys."""
        file, _, rest = text.partition("#")
        values: dict[str, str] = {}
        for word in filter(None, rest.split(",")):
            key, sign, value = word.partition("=")
            if not sign and values and next(reversed(values)) in ("track", "feature"):  # a comma of its name
                last = next(reversed(values))
                values[last] = " ".join(f"{values[last]} {word}".split())
                continue
            require(sign and value, f"'{text}'", f"'{word}', expected KEY=VALUE, such as noise=0.5 or road=1")
            require(key not in values, f"'{text}'", f"{key} stands twice")
            values[key] = value
        kind = FilePath(file).suffix.lower()
        refuse_workbook(file)
        known(kind or "none", KINDS, "a course's file: ending")
        for key in values:
            known(key, (*CHOICES[KINDS[kind]], *_SETTINGS), f"'{text}': {KINDS[kind]} key")
        choice = {key: value for key, value in values.items() if key not in _SETTINGS}
        for key in ("closed", "reverse"):
            known(values.get(key, "no"), _YES, f"'{text}': {key}")
        noise = values.get("noise")
        good = noise is None or (re.fullmatch(r"\d*\.?\d+", noise) and float(noise) <= 10.0)
        require(good, f"'{text}'", f"noise = {noise} [m], expected 0 to 10")
        return cls(
            file=file,
            choice=choice,
            noise=None if noise is None else float(noise),
            closed=_YES[values["closed"]] if "closed" in values else None,
            reverse=_YES[values.get("reverse", "no")],
        )

    @property
    def name(self) -> str:
        """What the course is called: the file's name, and what of it."""
        parts = [FilePath(self.file).stem, *(f"{key}{value}" for key, value in self.choice.items())]
        parts += ["reversed"] * self.reverse
        clean = "".join(c if c.isalnum() or c in "-_." else "_" for c in "-".join(parts))
        return clean.replace("--", "-_")  # two hyphens part the names of scenarios


def is_file(name: str) -> bool:
    """Does a course's name mean a file?"""
    ending = FilePath(name.partition("#")[0]).suffix.lower()
    return ending in KINDS or ending.startswith(".xls")  # which `Address` refuses


def is_road(name: str) -> bool:
    """Does a course's name mean a file other than a plain CSV, or something in a file?"""
    return is_file(name) and not name.lower().endswith(".csv")
