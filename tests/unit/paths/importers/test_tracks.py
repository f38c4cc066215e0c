"""GPX, GeoJSON and CSV as their writers write them."""

from __future__ import annotations

import json
from pathlib import Path as FilePath

import gpxpy
import numpy as np
import pytest

from steerkit.paths.importers import contents, read_course
from steerkit.paths.importers.tracks import csv, geojson, gpx
from tests.support import road_files

XY = np.column_stack((np.linspace(0.0, 200.0, 41), 10.0 * np.sin(np.linspace(0.0, 3.0, 41))))


def test_gpx_as_the_formats_library_reads_it(tmp_path: FilePath) -> None:
    file = road_files.gpx(XY, tmp_path / "lap.gpx")
    (track,) = gpx(str(file))
    theirs = gpxpy.parse(file.read_text()).tracks[0].segments[0].points
    assert [*track.a] == [p.latitude for p in theirs], "to the last bit"
    assert [*track.b] == [p.longitude for p in theirs]
    assert [*track.t] == [p.time.timestamp() for p in theirs if p.time]
    assert (track.name, track.drawn) == ("lap", False)


def test_gpx_speeds_routes_and_segments(tmp_path: FilePath) -> None:
    file = tmp_path / "a.gpx"
    point = '<trkpt lat="52.{0}" lon="8.0"><extensions><x:speed>{1}</x:speed></extensions></trkpt>'
    segments = "".join(f"<trkseg>{''.join(point.format(k, k) for k in part)}</trkseg>" for part in ((1, 2), (3, 4)))
    route = '<rte><name>a,b</name><rtept lat="52.0" lon="8.0"/><rtept lat="52.01" lon="8.0"/></rte>'
    file.write_text(f'<gpx xmlns:x="y"><wpt lat="1" lon="2"><name>w</name></wpt><trk>{segments}</trk>{route}</gpx>')
    track, drawn = gpx(str(file))
    assert [*track.v] == [1.0, 2.0, 3.0, 4.0]
    assert (drawn.name, drawn.drawn, len(drawn.a)) == ("a b", True, 2)
    assert contents(str(file)).listed().startswith("track 0 (33")


def test_geojson_lines(tmp_path: FilePath) -> None:
    file = road_files.geojson(XY, tmp_path / "a.geojson")
    (track,) = geojson(str(file))
    positions = json.loads(file.read_text())["features"][0]["geometry"]["coordinates"]
    assert [[b, a] for a, b in zip(track.a, track.b)] == positions
    assert (track.name, track.drawn) == ("yard", True)
    times = [f"2026-11-22T15:00:{k:02d}Z" for k in range(41)]
    (timed,) = geojson(str(road_files.geojson(XY, file, more={"coordTimes": times})))
    assert not timed.drawn
    assert np.diff(timed.t) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ({"type": "LineString", "coordinates": [[8, 52], [8.1, 52], [8.2, 52, 70]]}, ["0"]),
        ({"type": "MultiLineString", "coordinates": [[[8, 52], [8.1, 52]], [[9, 52], [9.1, 52]]]}, ["0.0", "0.1"]),
        (
            {
                "type": "FeatureCollection",
                "name": "layer",
                "features": [
                    {"type": "Feature", "id": 7, "geometry": {"coordinates": [[8, 52], [9, 52]], "type": "LineString"}},
                    {"type": "Feature", "geometry": {"type": "Point", "coordinates": [8, 52]}, "properties": None},
                    {
                        "type": "Feature",
                        "properties": {"name": "x", "coordinates": [1, 2, 3], "type": "Polygon"},
                        "geometry": {"type": "LineString", "coordinates": [[8, 52], [9, 52]]},
                    },
                ],
            },
            ["7", "x"],
        ),
    ],
)
def test_geojson_of_other_shapes(text: object, names: list[str], tmp_path: FilePath) -> None:
    file = tmp_path / "a.json"
    file.write_text(json.dumps(text))
    assert [track.name for track in geojson(str(file))] == names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "no JSON, damaged or cut off"),
        ("", "no JSON, damaged or cut off"),
        ("[1]", "type '', expected GeoJSON"),
        ('{"type": "Polygon", "coordinates": [[[8, 52], [9, 52]]]}', "type 'Polygon', expected GeoJSON: Feature"),
        ('{"type": "LineString", "coordinates": [[8, "52"]]}', "'52' among the coordinates, expected numbers"),
        ('{"type": "LineString", "coordinates": [[8], [9]]}', "a position .8.0., expected longitude and latitude"),
        ('{"a": ' * 60 + "1" + "}" * 60, "more than 40 brackets"),
    ],
)
def test_what_is_no_geojson_is_refused(text: str, message: str, tmp_path: FilePath) -> None:
    file = tmp_path / "a.json"
    file.write_text(text)
    with pytest.raises(ValueError, match=message):
        geojson(str(file))


def test_csv_with_noise_speed_and_rounds(tmp_path: FilePath) -> None:
    file = tmp_path / "a.csv"
    file.write_text("t,x,y,v\n" + "\n".join(f"{k},{x},{y},{4 + 0.01 * k}" for k, (x, y) in enumerate(XY)))
    (track,) = csv(str(file))
    assert track.flat
    made = read_course(f"{file}#noise=0.05")
    assert made.v is not None
    assert made.v[0] == pytest.approx(4.0, abs=1e-3)
    assert made.v[-1] == pytest.approx(4.4, abs=1e-3)
    assert made.path.length == pytest.approx(201.1, abs=0.2)


def test_a_track_without_points_is_said(tmp_path: FilePath) -> None:
    file = tmp_path / "a.gpx"
    file.write_text("<gpx><trk/></gpx>")
    with pytest.raises(ValueError, match="holds no track of two points or more"):
        contents(str(file))
    file.write_text("<kml/>")
    with pytest.raises(ValueError, match="is no GPX file"):
        contents(str(file))
