"""GPX, GeoJSON and CSV as their writers write them."""

import contextlib
import json
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path as FilePath

import gpxpy
import numpy as np
import pytest

from steerkit.paths.courses import course
from steerkit.paths.importers import Line, contents, read_course
from steerkit.paths.importers.course import check_spikes, laid
from steerkit.paths.importers.tracks import Track, cleaned, csv, geojson, gpx, rounds
from steerkit.paths.waypoints import stray_ends
from steerkit.scenario import Scenario
from tests.support import road_files
from tests.support.road_files import positions

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
    (timed,) = geojson(str(road_files.geojson(XY, file, coordTimes=times)))
    assert not timed.drawn
    assert np.diff(timed.t) == pytest.approx(1.0)


LINE = {"coordinates": [[8, 52], [9, 52]], "type": "LineString"}
FEATURES = [
    {"type": "Feature", "id": 7, "geometry": LINE},
    {"type": "Feature", "geometry": {"type": "Point", "coordinates": [8, 52]}, "properties": None},
    {"type": "Feature", "geometry": None},
    {"type": "Feature", "properties": {"name": "x", "coordinates": [1, 2, 3], "type": "Polygon"}, "geometry": LINE},
]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ({"type": "LineString", "coordinates": [[8, 52], [8.1, 52], [8.2, 52, 70]]}, ["0"]),
        ({"type": "MultiLineString", "coordinates": [[[8, 52], [8.1, 52]], [[9, 52], [9.1, 52]]]}, ["0.0", "0.1"]),
        ({"type": "FeatureCollection", "name": "layer", "features": FEATURES}, ["7", "x"]),
    ],
)
def test_geojson_of_other_shapes(text: object, names: list[str], tmp_path: FilePath) -> None:
    file = tmp_path / "a.json"
    file.write_text(json.dumps(text))
    assert [track.name for track in geojson(str(file))] == names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", "type '', expected GeoJSON"),
        ('{"type": "Polygon", "coordinates": [[[8, 52], [9, 52]]]}', "type 'Polygon', expected GeoJSON: Feature"),
        ('{"type": "LineString", "coordinates": [[8, "52"]]}', "a position .8, '52'., expected longitude and latitude"),
        ("[" * 100_000, "no JSON, damaged or cut off"),
        ('{"type": "LineString", "coordinates": [[true, 52]]}', "a position .True, 52., expected longitude"),
        (f'{{"type": "LineString", "coordinates": [[{"9" * 5000}, 52]]}}', "no JSON, damaged or cut off"),
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
    assert (track.flat, track.noise, Track("0", drawn=True).noise) == (True, 1.0, 0.1)
    assert [*track.t] == [*range(41)]
    made = read_course(f"{file}#noise=0.05")
    assert made.v is not None
    assert made.v[0] == pytest.approx(4.0, abs=1e-3)
    assert made.v[-1] == pytest.approx(4.4, abs=1e-3)
    assert made.path.length == pytest.approx(201.1, abs=0.2)


def test_a_csv_file_is_as_long_as_its_first_line_says(tmp_path: FilePath) -> None:
    """There and back beside it: 201 m, closed 202 m."""
    file, rows = tmp_path / "a.csv", [f"{x},{y}" for y, way in ((0, 1), (1, -1)) for x in range(0, 102, 2)[::way]]
    for kind, said, fits in (("open", 201.9, 1), ("open", 202.0, 0), ("closed", 202.9, 1), ("closed", 203.0, 0)):
        file.write_text("\n".join([f"# a: {kind} path, {said} m", "x,y", *rows]))
        with contextlib.nullcontext() if fits else pytest.raises(ValueError, match="its points make 20"):
            assert not csv(str(file))[0].t


PATH = course("circle")


def track(seconds: float, noise: float = 0.0, v: float = 5.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(0.0, seconds, 1.0)
    xy = np.asarray(PATH.point(v * t))
    return xy + noise * np.random.default_rng(seed).normal(size=xy.shape), t


def nothing(xy: np.ndarray) -> np.ndarray:
    """What a receiver without times or speeds says."""
    return np.full(len(xy), np.nan)


def test_speed_is_the_slope_of_the_way() -> None:
    xy, t = track(36.0)
    line, notes = cleaned(xy, t, nothing(t), 0.0, "lap")
    assert notes == []
    assert line.v is not None
    assert line.v[5:-5] == pytest.approx(5.0, rel=0.12), "a chord of nine seconds is shorter than its arc"
    told, _ = cleaned(xy, t, np.full(len(t), 4.9), 0.0, "lap")
    assert told.v is not None
    assert (told.v == 4.9).all(), "what the receiver says goes before"


def test_of_a_stop_one_point_is_left() -> None:
    xy, _ = track(30.0)
    rng = np.random.default_rng(1)
    stood = xy[12] + 0.3 * rng.normal(size=(40, 2))
    all_xy = np.vstack((xy[:13], stood, xy[13:]))
    all_t = np.arange(len(all_xy)) * 1.0
    line, (note,) = cleaned(all_xy, all_t, nothing(all_xy), 0.5, "lap")
    assert note == "left out 40 of 70 points, recorded while the car stood"
    assert np.array_equal(line.xy, xy)
    at = [0, 0, 0, 0, 0, 0, 9, 9, 9, 9, 9, 9, 15, 21, 21, 21, 21, 21, 27]  # stood twice; five samples are too short
    twice = np.column_stack((at, np.zeros(19)))
    line, _ = cleaned(twice, np.arange(19.0), nothing(twice), 0.5, "lap")
    assert line.xy[:, 0].tolist() == [0, 9, 15, 21, 27]


def test_of_a_track_with_a_gap_the_longest_part_is_taken_or_the_one_that_is_chosen() -> None:
    xy, t = track(36.0)
    keep = (t < 10.0) | (t > 20.0)
    of = (xy[keep], t[keep], nothing(t[keep]), 0.5, "lap")
    line, (note,) = cleaned(*of)
    assert np.array_equal(line.xy, xy[21:])
    said = "a gap of 12 s and 50 m after 9 s: the longest of 2 parts is taken, 21 to 35 s, 70 of 115 m; FILE#from="
    assert note.startswith(said)
    line, notes = cleaned(*of, span=(1.0, 12.0))
    assert np.array_equal(line.xy, xy[1:10])
    assert not notes
    with pytest.raises(ValueError, match=r"3 points with times of their own.*lasts from 0 to 35 s"):
        cleaned(*of, span=(8.0, 21.0))


def test_gaps_never_refuse_and_nothing_is_nan(tmp_path: FilePath) -> None:
    """Equal times, a point alone between two pauses, times of which one is none, a file that is cut off."""
    xy, t = track(60.0)
    alone = t + 40.0 * (t > 20.0) + 40.0 * (t > 21.0)
    for times in (np.floor(t / 2.0), np.zeros(60), alone, np.where(t == 9.0, np.nan, t)):
        line, notes = cleaned(xy, times, nothing(t), 0.5, "lap")
        assert line.v is None or np.isfinite(line.v).all()
        assert len(notes) == (times is not alone)
    file = road_files.gpx(XY, tmp_path / "a.gpx")
    text = file.read_text()
    file.write_text(text.replace('lat="', 'lat="1', 1).replace(":03Z", ":xxZ"))
    notes = read_course(str(file)).notes
    assert any("positions are left out, the first: <trkpt lat=" in note for note in notes), notes
    on_standby = t + 600.0 * (t > 10.0)  # ten minutes without a word, but not a metre further
    cleaned(xy, on_standby, nothing(t), 0.5, "lap")
    seldom = np.delete(np.arange(0, 36, 4), 4)  # three of its usual steps are no gap
    assert len(cleaned(xy[seldom], t[seldom], nothing(seldom), 0.5, "lap")[0].xy) == 8


def test_four_points_with_times_of_their_own_are_the_fewest() -> None:
    xy, t = track(5.0)
    twice = np.array([0.0, 1.0, 1.0, 2.0, 3.0])
    assert len(cleaned(xy, twice, nothing(t), 0.5, "lap")[0].xy) == 4
    with pytest.raises(ValueError, match="3 points with times of their own, expected 4 or more"):
        cleaned(xy[:4], twice[:4], nothing(t[:4]), 0.5, "lap")


@pytest.mark.parametrize("by", [(900.0, 0.0), (0.0, 80.0)])
@pytest.mark.parametrize("timed", [True, False])
def test_a_wrong_position_is_refused_or_left_out(by: tuple[float, float], timed: bool) -> None:
    xy, t = track(36.0)
    xy[14] += by
    told = dict(name="lap", noise=0.5, closed=False, drawn=False)
    line, notes = cleaned(xy, t if timed else nothing(t), nothing(t), 0.5, "lap")
    if timed and by[0]:
        assert notes == ["left out 1 wrong positions, which no car reaches; the first is point 14"]
        assert np.array_equal(line.xy, np.delete(xy, 14, axis=0))
    else:
        with pytest.raises(ValueError, match=r"point 1[45].* a wrong position"):
            laid(line, **told)


def test_a_jump_after_which_the_way_goes_on_is_no_wrong_position() -> None:
    """The points before and after it would be just as far apart without it."""
    xy, t = track(36.0)
    xy[14] += (250.0, 0.0)
    xy[15:] += (250.0, 0.0)
    _, notes = cleaned(xy, t, nothing(t), 0.5, "lap")
    assert not any("wrong position" in note for note in notes)


def test_of_two_drives_in_one_track_the_longer_one_is_taken() -> None:
    xy, t = track(36.0)
    t[20:] -= 15.0
    line, (note,) = cleaned(xy, t, nothing(t), 0.5, "lap")
    assert np.array_equal(line.xy, xy[:20])
    assert note.startswith("time runs back after 19 s: the longest of 2 parts is taken, 0 to 19 s")


LATLON = [(52.0 + 1e-4 * k, 8.0 + 1e-5 * k) for k in range(30)]
TCX = '<TrainingCenterDatabase xmlns="http://www.garmin.com/xmlschemas/TrainingCenterDatabase/v2">{}</TrainingCenterDatabase>'


def test_tcx_activities_and_courses(tmp_path: FilePath) -> None:
    point = (
        "<Trackpoint><Time>2026-11-22T15:00:{2:02d}Z</Time><Position><LatitudeDegrees>{0}</LatitudeDegrees>"
        "<LongitudeDegrees>{1}</LongitudeDegrees></Position><Extensions><x:TPX xmlns:x='y'><x:Speed>4.5</x:Speed>"
        "</x:TPX></Extensions></Trackpoint>"
    )
    points = "".join(point.format(*at, k) for k, at in enumerate(LATLON))
    inside = "<Trackpoint><Time>2026-11-22T15:01:00Z</Time></Trackpoint>"
    course = f"<Courses><Course><Name>Park, run</Name><Track>{points}</Track></Course></Courses>"
    activity = f"<Activities><Activity><Id>1</Id><Lap><Track>{points}{inside}</Track></Lap></Activity></Activities>"
    file = tmp_path / "a.tcx"
    file.write_text(TCX.format(activity + course))
    found = contents(str(file))
    assert [*found.tracks] == ["0", "Park run"]
    assert [*zip(found.tracks["0"].a, found.tracks["0"].b)] == LATLON
    assert [*found.tracks["0"].v] == [4.5] * 30
    made = read_course(f"{file}#track=Park, run,from=5,noise=1")
    assert made.path.length == pytest.approx(24 * 11.15, abs=1.0)


def test_kml_lines_and_tracks(tmp_path: FilePath) -> None:
    line = " ".join(f"{lon},{lat},70" for lat, lon in LATLON)
    when = "".join(f"<when>2026-11-22T15:00:{k:02d}Z</when>" for k in range(30))
    where = "".join(f"<gx:coord>{lon} {lat} 70</gx:coord>" for lat, lon in LATLON)
    marks = (
        "<Placemark><name>spot</name><Point><coordinates>8,52</coordinates></Point></Placemark>"
        f"<Placemark><name>way</name><LineString><coordinates>\n{line}\n</coordinates></LineString></Placemark>"
        f"<Placemark><gx:Track>{when}{where}</gx:Track></Placemark>"
    )
    file = tmp_path / "a.kml"
    head = '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"><Document>'
    file.write_text(f"{head}{marks}</Document></kml>")
    found = contents(str(file)).tracks
    assert [(name, one.drawn) for name, one in found.items()] == [("way", True), ("1", False)]
    for one in found.values():
        assert [*zip(one.a, one.b)] == LATLON
    made = read_course(f"{file}#track=1")
    assert made.v == pytest.approx(11.15, abs=0.05)
    with pytest.raises(ValueError, match=r"from, to .s. choose by time"):
        read_course(f"{file}#track=way,from=3")
    for ending, known in (("kml", "<kml>"), ("xml", "<commonRoad>, <osm>, <OpenDRIVE>")):
        file.with_suffix(f".{ending}").write_text("<svg/>")
        with pytest.raises(ValueError, match=f"its first element is <svg>, expected one of {known}"):
            contents(str(file.with_suffix(f".{ending}")))


@pytest.mark.parametrize(("noise", "seed"), [(0.0, 0), (1.0, 0), (1.0, 1), (1.0, 2)])
def test_a_round_ends_where_it_began(noise: float, seed: int) -> None:
    around = 2.0 * np.pi * 30.0 / 5.0  # seconds
    xy, _ = track(2.4 * around, noise, seed=seed)
    for number in (1, 2):
        line, closed, (note,) = rounds(Line(xy=xy), noise, number, "lap")
        assert closed
        assert len(line.xy) == pytest.approx(around, abs=2.0)
        assert note.startswith(f"round {number} of 2")
    if not noise:
        assert rounds(Line(xy=xy), noise, None, "lap")[2] == ["round 1 of 2: points 0 to 37, 53 others left out"]
    with pytest.raises(ValueError, match="lap 3, but it has 2 whole rounds"):
        rounds(Line(xy=xy), noise, 3, "lap")


def test_what_does_not_come_back_is_no_round() -> None:
    xy, _ = track(20.0)
    line, closed, notes = rounds(Line(xy=xy), 0.5, None, "lap")
    assert (len(line.xy), closed, notes) == (20, False, [])
    there_and_back = np.vstack((np.linspace((0, 0), (200, 0), 41), np.linspace((200, 4), (0, 4), 41)))
    assert not rounds(Line(xy=there_and_back), 0.5, None, "lap")[1], "it comes back the other way"


@pytest.mark.parametrize(
    ("step", "noise", "reach", "early"),
    [(1, 0.0, 5.0, 0), (1, 3.0, 12.0, 3), (5, 2.9, 11.6, 0), (5, 3.1, 12.4, 5), (5, 0.0, 7.5, 0)],
)
def test_a_round_ends_beside_its_beginning_or_not(step: int, noise: float, reach: float, early: int) -> None:
    for beside, comes_back, before in ((1.0, True, early), (reach - 0.01, True, 0), (reach + 0.01, False, 0)):
        corners = np.array([(0.0, 0.0), (60.0, 0.0), (60.0, 40.0), (-40.0, 40.0), (-40.0, beside), (60.0, beside)])
        xy = np.vstack([np.linspace(a, b, round(math.dist(a, b)) // step, False) for a, b in pairwise(corners)])
        line, closed, _ = rounds(Line(xy=xy), noise, None, "lap")
        assert closed == comes_back
        if closed:
            assert xy[len(line.xy)].tolist() == pytest.approx([-before, beside])


@pytest.mark.parametrize("legs", [(40.0, 40.0), (25.0, 55.0)])
def test_a_zigzag_drawn_by_hand_is_no_wrong_position(legs: tuple[float, float]) -> None:
    """Of equal legs and of others, and three corners between straights; the same, recorded, are wrong positions."""
    x = np.cumsum([0.0, *legs * 4])
    zigzag = np.column_stack((x, np.where(np.arange(9) % 2, 12.0, 0.0)))
    stairs = np.array([(-60, 0), (0, 0), (60, 0), (60, 40), (120, 40), (120, 100), (120, 160)], dtype=float)
    for xy in (zigzag, stairs):
        check_spikes(xy, 0.1, "way", drawn=True)
        with pytest.raises(ValueError, match="a wrong position"):
            check_spikes(xy, 0.1, "way")
    straight = np.column_stack((20.0 * np.arange(12), np.where(np.arange(12) == 6, 8.0, 0.0)))
    with pytest.raises(ValueError, match=r"point 6.* a wrong position"):
        check_spikes(straight, 0.1, "way", drawn=True)


LAP = np.column_stack((3.0 * np.arange(60.0), 15.0 * np.sin(np.arange(60.0) / 12.0)))


@pytest.mark.parametrize("end", [0, -1])
@pytest.mark.parametrize("kind", ["a.gpx", "a.geojson", "a.csv", "plain.csv", "timed.csv"])
def test_a_wrong_position_at_an_end_is_left_out_and_is_no_origin(kind: str, end: int, tmp_path: FilePath) -> None:
    file, off = tmp_path / kind, 30.0 if kind == "a.geojson" else 1.0
    write: dict[str, Callable[[np.ndarray], object]] = {
        ".gpx": lambda xy: road_files.gpx(xy, file),
        ".geojson": lambda xy: road_files.geojson(xy, file),
        ".csv": lambda xy: file.write_text("lat,lon\n" + "\n".join(f"{a:.9f},{b:.9f}" for a, b in zip(*positions(xy)))),
    }
    if kind == "timed.csv":
        write[".csv"] = lambda xy: file.write_text(
            "t,x,y\n" + "\n".join(f"{k},{x},{y}" for k, (x, y) in enumerate(xy.tolist()))
        )
    address = f"{file}{'' if kind == 'plain.csv' else '#noise=0.5'}"
    write[file.suffix](np.delete(LAP, end, axis=0))
    right = read_course(address)
    spoilt = LAP.copy()
    spoilt[end] += off * np.array([300.0, 900.0])
    write[file.suffix](spoilt)
    made = read_course(address)
    assert any("positions are left out, the first" in note and "as no car drives" in note for note in made.notes)
    assert made.path.origin_deg == right.path.origin_deg
    assert made.path.length == pytest.approx(right.path.length, abs=1e-6)
    if kind == "plain.csv":
        driven = Scenario(course=str(file)).path()
        assert (driven.length, driven.origin_deg) == (made.path.length, made.path.origin_deg)


def test_a_long_first_leg_is_no_wrong_position() -> None:
    """Straight on, of what is drawn round a corner too; of two that are alike in their jump the second is wrong."""
    bend = np.column_stack((np.sin(np.arange(30) / 10.0), 1.0 - np.cos(np.arange(30) / 10.0))) * 20.0
    for first, drawn in (((-500.0, 0.0), False), ((0.0, -500.0), True)):
        xy = np.vstack(([first], bend))
        assert stray_ends(*xy.T, flat=True, drawn=drawn) == {}
    assert [*stray_ends(*np.vstack(([(0.0, -500.0)], bend)).T, flat=True)] == [0]
    assert [*stray_ends(*np.vstack(([(0.0, -1000.0)], bend)).T, flat=True, drawn=True)] == [0]
    assert stray_ends(*np.vstack(([(0.0, -500.0)], bend[:8])).T, flat=True) == {}, "of few points nobody knows"
    xy = np.vstack((bend[:1], [(0.0, -500.0)], bend[1:]))
    assert stray_ends(*xy.T, np.arange(31.0), flat=True) == {}
    t = np.arange(31.0)
    xy = np.vstack(([(0.0, -131.0)], bend))
    xy[10:] += 20.0  # a longer step elsewhere
    assert [*stray_ends(*xy.T, t, flat=True)] == [0], "131 m in a second"
    t[0] = -1.0
    assert stray_ends(*xy.T, t, flat=True) == {}
