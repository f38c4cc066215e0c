"""Good maps and tracks of others' writers with one defect each open in their good part, with the defect named."""

import json
import math
from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from steerkit.paths.importers import contents, course_of, read_course
from steerkit.scenario import Scenario
from tests.support import road_files

T = np.arange(0.0, 60.0, 1.0)
XY = np.column_stack((5.0 * T, 20.0 * np.sin(T / 15.0)))


def changed(old: str, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return change


def without(first: int, last: int) -> Callable[[str], str]:
    """Without some of the track's points."""

    def change(text: str) -> str:
        head, *points = text.split("<trkpt")
        return "<trkpt".join([head, *points[:first], *points[last:]])

    return change


def elsewhere(text: str) -> str:
    head, *points = text.split('<trkpt lat="52.')
    points[20] = f"3{points[20]}"
    return '<trkpt lat="52.'.join([head, *points])


def swapped(text: str) -> str:
    head, *points = text.split("<trkpt")
    return "<trkpt".join([head, *points[40:-1], *points[:40], points[-1]])


TRACKS: dict[str, tuple[Callable[[str], str], str]] = {
    "a gap": (without(25, 37), "a gap of 13 s and"),
    "cut off": (lambda text: text[: 3 * len(text) // 4], "all that follows"),
    "time runs back": (swapped, "time runs back after"),
    "a time that is none": (changed(":07Z", ":7xZ"), "positions are left out, the first: time is"),
    "a time twice": (changed(":07Z", ":06Z"), "points without a time of their own"),
    "a latitude that is none": (changed('lat="5', 'lat="x5'), "1 positions are left out, the first: <trkpt lat="),
    "a latitude off Earth": (changed('lat="5', 'lat="95'), "1 positions are left out, the first: <trkpt lat="),
    "a position elsewhere": (elsewhere, "wrong positions, which no car reaches"),
}


@pytest.mark.parametrize("defect", TRACKS)
def test_a_track_with_one_defect_opens_in_its_good_part(defect: str, tmp_path: FilePath) -> None:
    """gpxpy's files."""
    change, says = TRACKS[defect]
    turn = 0.7
    xy = XY @ np.array([(math.cos(turn), math.sin(turn)), (-math.sin(turn), math.cos(turn))])
    file = road_files.gpx(xy, tmp_path / "a.gpx")
    whole = read_course(str(file)).path
    file.write_text(change(file.read_text()))
    made = read_course(str(file))
    assert says in " ".join(made.notes), made.notes
    assert made.v is not None
    assert np.isfinite(made.v).all()
    assert made.v == pytest.approx(float(np.median(made.v)), rel=0.4)
    assert 0.35 * whole.length < made.path.length < 1.02 * whole.length


def savetxt(file: FilePath) -> None:
    np.savetxt(file, XY, delimiter=",", header="x_m,y_m")


def pandas(file: FilePath, **options: object) -> None:
    pd.DataFrame({"x": XY[:, 0], "y": XY[:, 1], "note": "a"}).to_csv(file, **options)  # type: ignore[call-overload]


TABLES: dict[str, Callable[[FilePath], None]] = {
    "savetxt with a comment header": savetxt,
    "pandas with its index": pandas,
    "pandas with ;": lambda file: pandas(file, sep=";", index=False),
    "pandas with decimal commas": lambda file: pandas(file, sep=";", decimal=",", index=False),
    "pandas in UTF-16": lambda file: pandas(file, encoding="utf-16", index=False),
    "pandas with Windows' line ends": lambda file: pandas(file, lineterminator="\r\n", index=False),
    "pandas with quotes": lambda file: pandas(file, quoting=1, index=False),
    "pandas with tabs": lambda file: pandas(file, sep="\t", index=False),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_numpy_and_pandas_are_courses(name: str, tmp_path: FilePath) -> None:
    file = tmp_path / "a.csv"
    TABLES[name](file)
    path = read_course(str(file)).path
    assert np.hypot(*(np.asarray(path.point(np.asarray(path.samples.s))) - path.samples.xy).T).max() < 1e-6
    assert path.samples.xy[0] == pytest.approx(XY[0], abs=1e-6)
    assert path.samples.xy[-1] == pytest.approx(XY[-1], abs=1e-6)


@pytest.mark.parametrize(
    ("defect", "road"), [("no length", "1"), ("a length that is no number", "2"), ("a heading that is no number", "3")]
)
def test_a_map_with_one_faulty_road_opens_without_it(defect: str, road: str, tmp_path: FilePath) -> None:
    """scenariogeneration's crossing: an arm is faulty, and the others stay as they were."""
    file = road_files.junction(tmp_path / "a.xodr")
    before = contents(str(file))
    tree = ElementTree.parse(file)
    (bad,) = (node for node in tree.iter("road") if node.get("id") == road)
    geometry = next(bad.iter("geometry"))
    key, value = {"no length": ("length", None), "a length that is no number": ("length", "x6")}.get(
        defect, ("hdg", "nan")
    )
    geometry.attrib.pop(key)
    if value is not None:
        geometry.set(key, value)
    tree.write(file)
    found = contents(str(file))
    assert [*found.faulty] == [road]
    assert key in found.left_out[0]
    for name in found.groups:
        assert found.length_of(name) == before.length_of(name)
    assert found.groups.keys() == before.groups.keys() - {road}


ROWS = {"text": "12,x", "NaN": "nan,2", "too few columns": "12", "too many": "1,2,3", "infinite": "1e309,2"}


@pytest.mark.parametrize(("defect", "key"), [(defect, "#noise=0.1" * (k % 2)) for k, defect in enumerate(ROWS)])
def test_a_bad_row_is_left_out_and_named_and_many_refuse(defect: str, key: str, tmp_path: FilePath) -> None:
    file = tmp_path / "a.csv"
    good = [f"{x:.9f},{y:.9f}" for x, y in XY.tolist()]
    right = "x,y\n" + "\n".join(good[:20] + good[21:]) + "\n"
    file.write_text(right)
    before = read_course(f"{file}{key}").path
    for bad, spoilt in ((1, [ROWS[defect]]), (6, [ROWS[defect]] * 6)):
        file.write_text("x,y\n" + "\n".join(good[:20] + spoilt + good[21:]) + "\n")
        made = read_course(f"{file}{key}")
        (note,) = (one for one in made.notes if "left out" in one)
        assert note.startswith(
            f"{bad} positions are left out, the first: line 22 is '{ROWS[defect]}', expected 2 numbers"
        )
        assert made.path.length == before.length
    scenario = Scenario(course=f"{file}{key}")
    assert scenario.path().length == pytest.approx(before.length, abs=1e-6)
    assert "left out: line 22 is" in (scenario.course.text or "") or key
    file.write_text("x,y\n" + "\n".join(good[:20] + [ROWS[defect]] * 7 + good[21:]) + "\n")
    for read in (read_course, lambda address: Scenario(course=address).path()):
        with pytest.raises(ValueError, match=r"line 22 is .*; and so are 7 of 66 rows"):
            read(f"{file}{key}")


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
