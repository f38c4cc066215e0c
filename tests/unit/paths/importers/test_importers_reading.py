"""From a file to a drive, and what becomes of files that are damaged."""

import contextlib
import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest

from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.paths.courses import course
from steerkit.paths.importers import Address, chosen, contents, course_of, is_road, read_course
from steerkit.scenario import Scenario, read_scenario
from steerkit.scenario.drive import controller, drive
from tests.support import road_files
from tests.support.command_lines import run
from tests.unit.paths.importers.test_lanelets import lanelet, osm_file, relation, scenario, way


def test_a_noisy_lap_becomes_a_course_that_stanley_drives(tmp_path: FilePath) -> None:
    """One metre of noise, once a second, at 5 m/s; after 5 s, as a start in a bend is none of the course's fault."""
    truth = Scenario(course="random-7").path()
    file = road_files.gpx(road_files.driven(truth, seed=0, further=30.0), tmp_path / "lap.gpx")
    where = Scenario(course=str(file), driver={"v_min": 5.0, "v_max": 5.0})
    path = where.path()
    assert path.closed
    assert path.length == pytest.approx(truth.length, rel=0.02)
    log = drive(where, controller("stanley", where))
    assert np.abs(log["path.e"][log.t > 5.0]).max() < 0.3
    assert log["path.progress"][-1] >= path.length


def test_speeds_go_with_the_course(tmp_path: FilePath) -> None:
    lap = road_files.gpx(road_files.driven(course("genesis-rfs"), v=6.0, noise=0.3), tmp_path / "lap.gpx")
    where = Scenario(course=f"{lap}#noise=0.3", driver={"speed": "recorded", "v_max": 9.0})
    s, v = where.driver.profile(where.course, where.path())
    assert np.median(v) == pytest.approx(6.0, abs=0.3)
    assert where.seconds == pytest.approx(where.path().length / 6.0, rel=0.3)
    town = road_files.junction(tmp_path / "town.xodr")
    allowed = Scenario(course=f"{town}#road=1,lane=-1,to=2", driver={"speed": "limit", "v_max": 15.0})
    s, v = allowed.driver.profile(allowed.course, allowed.path())
    assert v[s < 20.0].max() == pytest.approx(50.0 / 3.6), "as fast as is allowed"
    with pytest.raises(ValueError, match=r"speed recorded: town-.*: no column v \[m/s\]; columns: s, x, y, psi"):
        Scenario(course=f"{town}#road=1,lane=-1,to=2", driver={"speed": "recorded"})


def test_a_course_that_the_car_cannot_drive_is_refused(tmp_path: FilePath) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    file = tmp_path / "ring.csv"
    file.write_text("x,y\n" + "\n".join(f"{3 * np.cos(a)},{3 * np.sin(a)}" for a in angle))
    with pytest.raises(ValueError, match=r"ring: bends to a radius of 3 m .*; the car's wheel does 4"):
        Scenario(course=f"{file}#noise=0")


def csv(file: FilePath) -> FilePath:
    """A course as this package writes it."""
    lap = road_files.gpx(road_files.driven(course("circle"), noise=0.0), file.with_suffix(".gpx"))
    file.write_text(read_course(f"{lap}#noise=0.1").text())
    return file


def drawn(file: FilePath) -> FilePath:
    return road_files.geojson(road_files.driven(course("circle"), noise=0.0), file)


FILES: dict[str, tuple[Callable[[FilePath], FilePath], str]] = {
    "a.gpx": (lambda f: road_files.gpx(road_files.driven(course("circle"), noise=0.3), f), "noise=0.5,closed=no"),
    "a.geojson": (drawn, "noise=0.2,closed=no"),
    "a.xodr": (road_files.junction, "road=1,lane=-1,to=2"),
    "a.xml": (lambda f: scenario(f, lanelet(1, 0, 40, after=2), lanelet(2, 40, 90)), "lanelet=1,to=2"),
    "a.osm": (lambda f: osm_file(f, way(11, 1, 2, 3), way(12, 4, 5, 6), relation(21, 11, 12)), "lanelet=21"),
    "a.csv": (csv, "noise=0.1,closed=no"),
}


def points(file: FilePath, choice: str) -> np.ndarray:
    """The points of what is chosen, before they are smoothed."""
    where = Address.parsed(f"{file}#{choice}")
    return chosen(contents(str(file)), where)[0].xy


@pytest.mark.parametrize("name", FILES)
def test_files_cut_off_are_refused_or_hold_what_comes_before(name: str, tmp_path: FilePath) -> None:
    make, choice = FILES[name]
    file = make(tmp_path / name)
    data, right = file.read_bytes(), points(file, choice)
    for cut in np.linspace(0, len(data) - 2, 12).astype(int):
        file.write_bytes(data[:cut])
        with contextlib.suppress(ValueError):
            apart = np.hypot(*(points(file, choice)[:, None] - right).transpose(2, 0, 1)).min(axis=1)
            assert apart.max() < 0.01, f"cut at {cut} of {len(data)}"
    file.write_bytes(data[: len(data) // 2])
    if name == "a.gpx":
        assert any("all that follows" in note and "cut off" in note for note in read_course(f"{file}#{choice}").notes)
        return
    with pytest.raises(ValueError, match=r"cut off|cut short|expected 6 numbers"):
        points(file, choice)


def test_a_table_takes_no_more_memory_than_four_times_its_file(tmp_path: FilePath) -> None:
    file = tmp_path / "large.csv"
    angle = np.linspace(0.0, 6.0, 4_000)
    xy = 200.0 * np.column_stack((np.cos(angle), np.sin(angle)))
    file.write_text("x,y\n" + "".join(f"{x:.4f},{y:.4f}\n" for x, y in xy.tolist()))
    contents(str(file))
    tracemalloc.start()
    contents(str(file))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4 * file.stat().st_size


def test_an_address_names_a_file_and_what_of_it() -> None:
    one = Address.parsed("maps/town.xodr#road=1,lane=-1,noise=0.05,closed=no,reverse=yes")
    assert (one.file, dict(one.choice)) == ("maps/town.xodr", {"road": "1", "lane": "-1"})
    assert (one.noise, one.closed, one.reverse) == (0.05, False, True)
    assert one.name == "town-road1-lane-1-reversed"
    assert "--" not in Address.parsed("a--b.xodr#road=-1,lane=-1").name
    assert "/" not in Address.parsed("x.gpx#track=a/b c").name
    plain = Address.parsed("lap.gpx")
    assert (plain.noise, plain.closed, plain.reverse, plain.name) == (None, None, False, "lap")
    names = ("yard.csv", "paper", "yard.csv#noise=0.5", "LAP.GPX")
    assert [is_road(name) for name in names] == [False, False, True, True], "a CSV file without keys is exact"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lap.shp", r"ending '.shp' is not known.*valid: .csv, .gpx, .kml, .tcx, .geojson, .json, .xodr, .xml, .osm"),
        ("lap.gpx#noise=", "expected KEY=VALUE"),
        ("lap.gpx#noise=-1", r"noise = -1 \[m\], expected 0 to 10"),
        ("lap.gpx#noise=nan", r"noise = nan \[m\], expected 0 to 10"),
        ("lap.gpx#noise=1,noise=2", "noise stands twice"),
        ("lap.gpx#closed=maybe", "closed 'maybe' is not known.*valid: yes, no"),
        ("lap.gpx#road=1", "GPX key 'road' is not known.*valid: track, lap, from, to, noise, closed, reverse"),
    ],
)
def test_other_addresses_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Address.parsed(text)


FIGURES = {"YARD.CSV": ("X [m];pos_y [m]", False), "ring.csv": ("x,y", True), "gps.csv": ("Latitude\tlng", False)}
"""Files to their first row, and whether their course is closed."""


@pytest.mark.parametrize("name", FIGURES)
def test_preview_drive_learning_and_scenario_files_have_one_course(
    name: str, tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sampled along it, to the bit: what `steerkit courses` writes down of a file, and where cars are put."""
    monkeypatch.chdir(tmp_path)
    head, closed = FIGURES[name]
    u = np.linspace(0.0, (2.0 if closed else 1.7) * np.pi, 120)[: -1 if closed else None]
    points = np.column_stack((40.0 * np.cos(u), 25.0 * np.sin(u)))
    points = np.array([52.28, 8.02]) + points / 1e5 if "Lat" in head else points
    mark = next(sign for sign in ";\t," if sign in head)
    FilePath(name).write_text("\n".join([head, *(f"{a:.7f}{mark}{b:.7f}" for a, b in points)]) + "\n")
    FilePath("mine.toml").write_text(f'format = "steerkit scenario 2"\n[course]\nname = "{name}"\n')
    assert run("courses", name, "--json", monkeypatch=monkeypatch) == 0
    shown = json.loads(capsys.readouterr().out)
    paths = {
        "drive": Scenario(course=name).path(),
        "learn": LearningRun(Experiment(scenario=Scenario(course=name))).path,
        "file": read_scenario("mine.toml").path(),
        "python": course(name),
    }
    s = np.linspace(0.0, shown["length_m"], 50)
    for user, path in paths.items():
        assert (path.length, path.closed) == (shown["length_m"], closed), user
        assert np.array_equal(path.point(s), paths["drive"].point(s)), user
        assert 1.0 / np.abs(path.samples.kappa).max() == shown["tightest_radius_m"], user


XY = np.column_stack((np.arange(0.0, 300.0, 5.0), 20.0 * np.sin(np.arange(60.0) / 15.0)))
ROWS = ["12,x", "nan,2", "12", "1,2,3", "1e309,2"]


@pytest.mark.parametrize(("row", "key"), [(row, "#noise=0.1" * (k % 2)) for k, row in enumerate(ROWS)])
def test_a_bad_row_is_left_out_and_named_and_many_refuse(row: str, key: str, tmp_path: FilePath) -> None:
    file, address = tmp_path / "a.csv", f"{tmp_path}/a.csv{key}"
    good = [f"{x:.9f},{y:.9f}" for x, y in XY.tolist()]

    def write(count: int) -> None:
        """So many bad rows instead of a good one."""
        file.write_text("\n".join(["x,y", *good[:20], *[row] * count, *good[21:], ""]))

    write(0)
    before = read_course(address).path
    for count in (1, 6):
        write(count)
        made = read_course(address)
        (note,) = (one for one in made.notes if "left out" in one)
        assert note.startswith(f"{count} positions are left out, the first: line 22 is '{row}', expected 2 numbers")
        assert made.path.length == before.length
    scenario = Scenario(course=address)
    assert scenario.path().length == pytest.approx(before.length, abs=1e-6)
    assert "left out: line 22 is" in (scenario.course.text or "") or key
    write(7)
    for read in (read_course, lambda address: Scenario(course=address).path()):
        with pytest.raises(ValueError, match=r"line 22 is .*; and so are 7 of 66 rows"):
            read(address)


def test_a_car_takes_no_course_with_a_bad_row_and_words_that_nothing_reads_are_none() -> None:
    rows = [f"{x},{y},{'' if k else 'a'}" for k, (x, y) in enumerate(XY.tolist())]
    with pytest.raises(ValueError, match="line 3 is 'x,1,a', expected 3 numbers"):
        course_of("\n".join(["x,y,note", rows[0], "x,1,a", *rows[1:]]), "a.csv", closed=False)
    assert course_of("\n".join(["x,y,note", *rows]), "a.csv", closed=False).length > 290.0


BROKEN: dict[str, Any] = {
    "no geometry": {"type": "Feature", "geometry": "x"},
    "coordinates that are none": {"type": "Feature", "geometry": {"type": "LineString", "coordinates": 7}},
    "no coordinates": {"type": "Feature", "geometry": {"type": "LineString"}},
    "no feature": 7,
    "positions that are none": {
        "type": "Feature",
        "id": "b",
        "geometry": {"type": "LineString", "coordinates": [7, None, [999, 1]]},
    },
}


@pytest.mark.parametrize(("defect", "at"), [(defect, k % 2) for k, defect in enumerate(BROKEN)])
def test_a_broken_feature_of_a_geojson_file_is_left_out(defect: str, at: int, tmp_path: FilePath) -> None:
    file = road_files.geojson(XY, tmp_path / "a.geojson")
    whole = json.loads(file.read_text())
    before = read_course(str(file)).path
    whole["features"].insert(at, BROKEN[defect])
    whole["features"][1 - at]["geometry"]["coordinates"][30] = [8.02, "52"]
    whole["features"][1 - at]["geometry"]["coordinates"][31] = None
    file.write_text(json.dumps(whole))
    found, made = contents(str(file)), read_course(str(file))
    assert [*found.groups] == ["yard"]
    assert [*found.faulty] == ["b" if "positions" in defect else f"number {at}"]
    said = " ".join(made.notes)
    assert "1 faulty features are left out" in said
    assert "2 positions are left out, the first: coordinates: a position [8.02, '52']" in said
    assert made.path.length == pytest.approx(before.length, rel=0.01)
