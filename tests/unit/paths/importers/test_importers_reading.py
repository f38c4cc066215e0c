"""From a file to a drive, and what becomes of files that are damaged."""

import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path as FilePath

import numpy as np
import pytest

from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.paths.courses import course
from steerkit.paths.importers import Address, Line, chosen, contents, is_road, read_course
from steerkit.paths.path import Path
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


def test_a_lap_too_coarse_for_its_bends_is_refused(tmp_path: FilePath) -> None:
    """A hairpin between two fixes: what is left of it is no bend that a wheel does."""
    xy = np.array([(5.0 * k, 0.0) for k in range(20)] + [(100.0 - 5.0 * k, 3.0) for k in range(20)])
    file = road_files.gpx(xy, tmp_path / "a.gpx")
    with pytest.raises(
        ValueError,
        match=r"wheel does .*record more often|cannot be driven as it is.*record more often|beside its neighbours",
    ):
        read_course(f"{file}#noise=0.2")


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
    at = float(abs(allowed.path().kappa(s)).argmax())
    assert v[int(at)] ** 2 * abs(allowed.path().samples.kappa).max() < 3.1, "slower in the bend"
    with pytest.raises(
        ValueError, match=r"speed recorded: town-.*: no column v \[m/s\]; columns: s, x, y, psi, kappa, v_limit"
    ):
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


def wrong_by(file: FilePath, choice: str, right: np.ndarray) -> float:
    """How far the course lies from where it was at most [m]; 0 where it is refused."""
    try:
        there = points(file, choice)
        if there.shape == right.shape and np.abs(there - right).max() < 0.01:
            return 0.0
        made = read_course(f"{file}#{choice}")
    except ValueError:
        return 0.0
    if any("left out, the first" in note for note in made.notes):  # a part: its points are as they were
        return float(np.hypot(*(there[:, None] - right[None]).transpose(2, 0, 1)).min(axis=1).max())
    return off(made.path, right)


def off(path: Path, right: np.ndarray) -> float:
    """How far a course lies from points at most, and they from it [m]."""
    one = np.asarray(path.point(np.linspace(0.0, path.length, 300)))
    at = Line(xy=right).dense(0.5).xy
    gaps = np.hypot(*(one[:, None] - at[None]).transpose(2, 0, 1))
    return float(max(gaps.min(axis=0).max(), gaps.min(axis=1).max()))


@pytest.mark.parametrize("name", FILES)
def test_files_cut_off_are_refused(name: str, tmp_path: FilePath) -> None:
    make, choice = FILES[name]
    file = make(tmp_path / name)
    data, right = file.read_bytes(), points(file, choice)
    for cut in np.linspace(0, len(data) - 2, 12).astype(int):
        file.write_bytes(data[:cut])
        assert wrong_by(file, choice, right) < 0.6, f"cut at {cut} of {len(data)}"
    file.write_bytes(data[: len(data) // 2])
    if name == "a.gpx":
        assert any("all that follows" in note and "cut off" in note for note in read_course(f"{file}#{choice}").notes)
        return
    with pytest.raises(ValueError, match=r"cut off|cut short|expected 6 numbers"):
        points(file, choice)


@pytest.mark.parametrize("name", FILES)
def test_files_with_a_bit_flipped_are_refused_or_read_right(name: str, tmp_path: FilePath) -> None:
    """But for a digit that makes another plausible map: nobody can know that; it is one in thirty at most."""
    make, choice = FILES[name]
    file = make(tmp_path / name)
    data, right = bytearray(file.read_bytes()), points(file, choice)
    before = off(read_course(f"{file}#{choice}").path, right)  # an end that is smoothed is a little off
    wrong = []
    for place in np.random.default_rng(5).integers(0, 8 * len(data), 12).tolist():
        data[place // 8] ^= 1 << place % 8
        file.write_bytes(data)
        by = wrong_by(file, choice, right)
        if by > before + 0.75:
            wrong.append((place // 8, by))
        data[place // 8] ^= 1 << place % 8
    assert len(wrong) <= 1, wrong


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
    plain = Address.parsed("lap.gpx")
    assert (plain.noise, plain.closed, plain.reverse, plain.name) == (None, None, False, "lap")


def test_names_hold_nothing_that_parts_names_or_folders() -> None:
    assert "--" not in Address.parsed("a--b.xodr#road=-1,lane=-1").name
    assert "/" not in Address.parsed("x.gpx#track=a/b c").name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lap.shp", r"ending '.shp' is not known.*valid: .csv, .gpx, .kml, .tcx, .geojson, .json, .xodr, .xml, .osm"),
        ("lap", "ending 'none' is not known"),
        ("lap.gpx#noise", "'noise', expected KEY=VALUE"),
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


def test_a_csv_without_keys_is_exact() -> None:
    assert not is_road("yard.csv")
    assert not is_road("paper")
    assert is_road("yard.csv#noise=0.5")
    assert is_road("LAP.GPX")


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
