"""Roads in files, each by its format's own writer where there is one: OpenDRIVE (scenariogeneration), GPX (gpxpy)."""

import json
import math
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path as FilePath

import gpxpy.gpx
import numpy as np
import pymap3d
from scenariogeneration import xodr

from steerkit.paths.path import Path

CENTRE = (52.28, 8.02)
"""Where the tracks are [degrees]."""


def positions(xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Latitude and longitude [degrees] of places in metres about `CENTRE`."""
    lat, lon, _ = pymap3d.enu2geodetic(xy[:, 0], xy[:, 1], 0.0, *CENTRE, 0.0)
    return np.asarray(lat), np.asarray(lon)


def driven(path: Path, *, v: float = 5.0, noise: float = 1.0, seed: int = 0, further: float = 0.0) -> np.ndarray:
    """What a receiver says of a drive once along a path, once a second: (n, 2) [m]."""
    s = np.arange(0.0, path.length + further, v)
    return np.asarray(path.point(s)) + noise * np.random.default_rng(seed).normal(size=(len(s), 2))


def gpx(xy: np.ndarray, file: FilePath) -> FilePath:
    """A GPX file of places [m], one a second, written by gpxpy."""
    lat, lon = positions(xy)
    whole, track, segment = gpxpy.gpx.GPX(), gpxpy.gpx.GPXTrack(name="lap"), gpxpy.gpx.GPXTrackSegment()
    whole.tracks.append(track)
    track.segments.append(segment)
    begin = datetime(2026, 11, 22, 15, tzinfo=UTC)
    for k, (a, b) in enumerate(zip(lat, lon)):
        segment.points.append(gpxpy.gpx.GPXTrackPoint(a, b, time=begin + timedelta(seconds=k)))
    file.write_text(whole.to_xml())
    return file


def geojson(xy: np.ndarray, file: FilePath, **more: object) -> FilePath:
    """A GeoJSON file with a line in it."""
    lat, lon = positions(xy)
    line = {"type": "LineString", "coordinates": [[float(b), float(a)] for a, b in zip(lat, lon)]}
    feature = {"type": "Feature", "properties": {"name": "yard", **more}, "geometry": line}
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return file


def _arc(k: float, turn: float) -> list[object]:
    """A bend with clothoids before and behind it."""
    return [xodr.Spiral(1e-9, k, 12.0), xodr.Arc(k, angle=turn), xodr.Spiral(k, 1e-9, 12.0)]


def _cubic() -> object:
    # a gentle S whose parameter is its length to a part in a thousand
    return xodr.ParamPoly3(0, 1, 0, -6e-6, 0, 0, 2e-3, -2e-5, "arcLength", 30.0)


ROADS: dict[str, Callable[[], list[object]]] = {
    "line": lambda: [xodr.Line(120.0)],
    "arc": lambda: [xodr.Line(20.0), xodr.Arc(0.05, angle=1.2), xodr.Line(20.0), xodr.Arc(-0.04, length=30.0)],
    "spiral": lambda: [xodr.Line(15.0), *_arc(0.06, 0.9), xodr.Line(10.0), *_arc(-0.03, 0.5)],
    "spirals": lambda: [
        xodr.Spiral(0.001, 0.08, 40.0),
        xodr.Spiral(0.08, -0.05, 50.0),
        xodr.Spiral(-0.05, -0.01, 20.0),
    ],
    "cubic": lambda: [xodr.Line(10.0), _cubic(), xodr.Line(10.0)],
}
"""Reference lines that the writer of OpenDRIVE files makes."""


def opendrive(pieces: list[object], file: FilePath) -> FilePath:
    """An OpenDRIVE file with one road, written by scenariogeneration."""
    road = xodr.create_road(pieces, id=1)  # type: ignore[arg-type]
    map_ = xodr.OpenDrive("map")
    map_.add_road(road)
    map_.adjust_roads_and_lanes()
    map_.write_xml(str(file))
    return file


def junction(file: FilePath) -> FilePath:
    """A crossing of three arms of 60 m, with roads 100 and up between them, written by scenariogeneration."""
    roads = [xodr.create_road(xodr.Line(60.0), id=k, left_lanes=1, right_lanes=1) for k in (1, 2, 3)]
    for road in roads:
        road.add_type(xodr.RoadType.town, 0, speed=50, speed_unit="km/h")
    creator = xodr.CommonJunctionCreator(id=50, name="crossing", startnum=100)
    for road, angle, contact in zip(roads, (0.0, 2.0 * math.pi / 3.0, 4.0 * math.pi / 3.0), ("successor",) * 3):
        creator.add_incoming_road_circular_geometry(road, radius=15.0, angle=angle, road_connection=contact)
    for a, b in ((1, 2), (2, 3), (1, 3)):
        creator.add_connection(road_one_id=a, road_two_id=b)
    map_ = xodr.OpenDrive("town")
    for road in roads:
        map_.add_road(road)
    map_.add_junction_creator(creator)
    map_.adjust_roads_and_lanes()
    map_.write_xml(str(file))
    return file


def by_hand(
    file: FilePath, geometry: str, *, length: float, lanes: str = "", rule: str = "RHT", more: str = ""
) -> FilePath:
    """An OpenDRIVE file with one road of that geometry; by default a lane of 3.5 m on each side."""
    width = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
    lanes = lanes or (
        f'<laneSection s="0"><left><lane id="1" type="driving">{width}</lane></left>'
        f'<center><lane id="0" type="none"/></center><right><lane id="-1" type="driving">{width}</lane></right>'
        "</laneSection>"
    )
    file.write_text(
        f'<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="7"/><road id="1" junction="-1" rule="{rule}" '
        f'length="{length!r}"><planView>{geometry}</planView>{more}<lanes>{lanes}</lanes></road></OpenDRIVE>'
    )
    return file
