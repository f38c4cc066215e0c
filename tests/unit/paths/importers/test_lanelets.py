"""CommonRoad scenarios, Lanelet2 maps and plain ways of OSM."""

import json
import re
from pathlib import Path as FilePath
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from steerkit.paths.importers import contents, read_course
from steerkit.paths.importers.lanelets import _chained, commonroad, osm
from steerkit.paths.waypoints import east_north
from tests.support import road_files
from tests.support.command_lines import run
from tests.support.places import SUPPORT


def bound(side: str, y: float, x0: float, x1: float) -> str:
    rows = "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x in np.linspace(x0, x1, 6))
    return f"<{side}Bound>{rows}</{side}Bound>"


def lanelet(name: int, x0: float, x1: float, *, after: int | None = None, more: str = "") -> str:
    bounds = bound("left", 2.0, x0, x1) + bound("right", -1.0, x0, x1)
    follows = "" if after is None else f'<successor ref="{after}"/>'
    return f'<lanelet id="{name}">{bounds}{follows}{more}</lanelet>'


SIGN = """<trafficSign id="90"><trafficSignElement><trafficSignID>274</trafficSignID>
<additionalValue>13.5</additionalValue></trafficSignElement></trafficSign>"""


def scenario(file: FilePath, *lanelets: str) -> FilePath:
    file.write_text(f'<commonRoad commonRoadVersion="2020a">{"".join(lanelets)}</commonRoad>')
    return file


def test_commonroads_lanelets_and_routes(tmp_path: FilePath) -> None:
    sign = '<trafficSignRef ref="90"/>'
    parts = lanelet(1, 0, 40, after=2, more=sign), lanelet(2, 40, 90, after=3), lanelet(3, 90, 120), SIGN
    file = scenario(tmp_path / "a.xml", *parts)
    found = commonroad(str(file))
    assert found.pieces["1"].line().xy[:, 1] == pytest.approx(0.5)
    made = read_course(f"{file}#lanelet=1,to=3")
    assert made.path.length == pytest.approx(120.0, abs=1e-6)
    assert made.v_limit is not None
    assert made.v_limit[0] == 13.5
    assert np.isnan(made.v_limit[-1])
    with pytest.raises(ValueError, match="no route leads to lanelet 1: not connected"):
        read_course(f"{file}#lanelet=2,to=1")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (lanelet(1, 0, 40) + lanelet(1, 0, 40), "two lanelets of the name 1"),
        (f'<lanelet id="1">{bound("left", 30, 0, 9)}{bound("right", 0, 0, 9)}</lanelet>', "30 m apart, expected at mo"),
        (f'<lanelet id="1">{bound("left", 0, 0, 9)}{bound("right", 3, 0, 9)}</lanelet>', "left bound is on the right"),
        ("", "holds no lanelets"),
    ],
)
def test_scenarios_that_contradict_themselves_are_refused(text: str, message: str, tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match=message):
        commonroad(str(scenario(tmp_path / "a.xml", text)))


NODES = {1: (0, 2), 2: (30, 2), 3: (60, 2), 4: (0, -2), 5: (30, -2), 6: (60, -2), 7: (90, 8), 8: (90, 4)}


def nodes(moved: dict[int, tuple[int, int]]) -> str:
    places = NODES | moved
    lat, lon = road_files.positions(np.array([*places.values()], dtype=float))
    return "".join(f'<node id="{k}" lat="{a!r}" lon="{b!r}"/>' for k, a, b in zip(places, lat.tolist(), lon.tolist()))


def way(name: int, *refs: int, **tags: str) -> str:
    inside = "".join(f'<nd ref="{r}"/>' for r in refs) + "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
    return f'<way id="{name}">{inside}</way>'


def relation(name: int, left: int, right: int, **tags: str) -> str:
    members = f'<member type="way" ref="{left}" role="left"/><member type="way" ref="{right}" role="right"/>'
    inside = "".join(f'<tag k="{k}" v="{v}"/>' for k, v in ({"type": "lanelet", "subtype": "road"} | tags).items())
    return f'<relation id="{name}">{members}{inside}</relation>'


def osm_file(file: FilePath, *parts: str, moved: dict[int, tuple[int, int]] = {}) -> FilePath:  # noqa: B006
    file.write_text(f'<osm version="0.6">{nodes(moved)}{"".join(parts)}</osm>')
    return file


def test_lanelets_follow_each_other_where_both_bounds_do(tmp_path: FilePath) -> None:
    """However their ways are drawn: here one of the bounds runs against the lane."""
    ways = way(11, 1, 2, 3), way(12, 6, 5, 4), way(13, 3, 7), way(14, 6, 8)
    lanes = relation(21, 11, 12, speed_limit="30 km/h"), relation(22, 13, 14)
    file = osm_file(tmp_path / "a.osm", *ways, *lanes)
    found = osm(str(file))
    assert (found.kind, found.drawn) == ("lanelet", True)
    assert found.pieces["21"].next == ("22",)
    first = found.pieces["21"].line()
    assert first.v_limit is not None
    assert first.v_limit[0] == pytest.approx(30.0 / 3.6)
    assert np.ptp(first.xy[:, 1]) < 1e-3
    assert np.diff(first.xy[:, 0]).min() > 0.0
    made = read_course(f"{file}#lanelet=21,to=22,noise=0.3")
    assert made.path.length == pytest.approx(60.0 + np.hypot(30.0, 6.0), abs=0.3)
    assert made.path.origin_deg is not None
    assert made.path.origin_deg[0] == pytest.approx(road_files.CENTRE[0], abs=1e-3)


def test_ways_meet_at_nodes_and_run_both_ways_unless_told(tmp_path: FilePath) -> None:
    main = way(11, 1, 2, 3, highway="residential", maxspeed="20 mph")
    ways = main, way(12, 2, 5, highway="service"), way(13, 3, 7, highway="residential", oneway="yes"), way(14, 1, 4)
    file = osm_file(tmp_path / "a.osm", *ways)
    found = osm(str(file))
    assert sorted(found.groups) == ["11", "12", "13"]
    assert found.length_of("11") == pytest.approx(60.0, abs=1e-3)
    assert set(found.pieces) == {"11/0", "11/1", "11/0-", "11/1-", "12/0", "12/0-", "13/0"}
    assert set(found.pieces["11/0"].next) == {"11/1", "12/0"}, "no turning round"
    made = read_course(f"{file}#way=11,to=13,noise=0.5")
    assert made.v_limit is not None
    assert made.v_limit[0] == pytest.approx(20 * 0.44704)
    with pytest.raises(ValueError, match="no route leads to way 11: not connected; what can be reached: 13"):
        read_course(f"{file}#way=13,to=11")
    two = osm(str(osm_file(file, way(11, 1, 2, 3, highway="road"), way(12, 5, 2, highway="road"))))
    line, *_ = two.route({"way": "12", "to": "11"}, "")  # both ways are as near: as it was drawn
    assert line.xy[-1, 0] > 59.0


def test_a_way_is_driven_as_its_tags_say(tmp_path: FilePath) -> None:
    for key, tag, driven in (("oneway", "-1", "11/0-"), ("junction", "roundabout", "11/0"), ("oneway", "yes", "11/0")):
        file = osm_file(tmp_path / "a.osm", way(11, 1, 2, highway="road", **{key: tag}))
        assert list(osm(str(file)).pieces) == [driven]


@pytest.mark.parametrize("ways", ["12 23 37", "21 23 73", "23 12 37", "23 73 21", "73 21 32"])
def test_the_ways_of_a_bound_are_put_in_line(ways: str) -> None:
    data: Any = SimpleNamespace(ways={name: (np.array([*map(int, name)]), {}) for name in (*ways.split(), "45")})
    assert _chained(ways.split(), data) in ([1, 2, 3, 7], [7, 3, 2, 1])
    with pytest.raises(ValueError, match="the ways of its bound do not meet"):
        _chained([*ways.split(), "45"], data)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((way(11, 1, 99, highway="road"),), "node 99 is not in the file"),
        ((way(11, 1, 2, highway="footway"),), "holds no lanelets or ways for cars"),
        ((relation(21, 11, 12),), "its bound, way 11, is not in the file"),
        ((way(11, 1, 2), way(12), way(13, 4, 5), relation(21, 11, 12)), "its bound, way 12, has no nodes"),
        (('<node id="x" lat="1" lon="2"/>',), "id = 'x', expected a whole number"),
        (('<node id="9" lat="91" lon="2"/>', way(11, 1, 9, highway="road")), "expected -90..90"),
    ],
)
def test_maps_that_lack_something_are_refused(parts: tuple[str, ...], message: str, tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match=message):
        contents(str(osm_file(tmp_path / "a.osm", *parts)))


@pytest.mark.parametrize("flipped", [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_bounds_may_begin_far_apart_and_run_either_way(flipped: tuple[int, int], tmp_path: FilePath) -> None:
    """As in Autoware's maps: a short lanelet whose left bound and right bound begin 12 m apart along the road."""
    left, right = (1, 2), (5, 6)  # x from 0 to 30 at y = 2, 30 to 60 at y = -2
    ways = way(11, *left[:: -1 if flipped[0] else 1]), way(12, *right[:: -1 if flipped[1] else 1])
    file = osm_file(tmp_path / "a.osm", *ways, relation(21, 11, 12), moved={5: (12, -2), 6: (42, -2)})
    line = osm(str(file)).pieces["21"].line().xy
    assert np.diff(line[:, 0]).min() > 0.0
    assert line[:, 0] == pytest.approx(np.linspace(6.0, 36.0, len(line)), abs=0.1)
    assert np.ptp(line[:, 1]) < 1e-3


ORIGIN = (52.28, 8.02)
PLACE = SUPPORT / "maps_of_others"
MIDDLES = json.loads((PLACE / "middles.json").read_text(encoding="utf-8"))
OF_5 = r'(<lanelet id="5">.*?)'
RELATION_5 = r'(<relation id="5".*?)'
WAY_OF_5 = r'(<way id="1111".*?)'
"""The left bound of lanelet 5 of lanelet2.osm."""

GOAL = '<planningProblem id="99"><goalState><position><lanelet ref="4"/></position></goalState></planningProblem>'
PARKED = '<staticObstacle id="98"><type>parkedVehicle</type></staticObstacle>'
RULE = '<relation id="9"><tag k="type" v="regulatory_element"/></relation>'
SIDES = r"leftBound>(.*?)</leftBound>(.*?)<rightBound>(.*?)</rightBound>"
DEFECTS: dict[str, dict[str, tuple[str, str, str]]] = {
    "lanelet2.osm": {
        "whole": ("^", "", ""),
        "no left bound": (RELATION_5 + r'<member [^>]*role="left"[^>]*/>', r"\1", "5"),
        "no right bound": (RELATION_5 + r'<member [^>]*role="right"[^>]*/>', r"\1", "5"),
        "a bound that is not there": (RELATION_5 + r'ref="\d+"', r'\1ref="77777"', "5"),
        "a bound of a word": (RELATION_5 + r'ref="\d+"', r'\1ref="left"', "5"),
        "one bound twice": (RELATION_5 + r'ref="(\d+)"(.*?)ref="\d+"', r'\1ref="\2"\3ref="\2"', "5"),
        "bounds exchanged": (RELATION_5 + r'"left"(.*?)"right"', r'\1"right"\2"left"', ""),
        "a bound of one point": (WAY_OF_5 + r"(<nd [^>]*/>\s*)(?:<nd [^>]*/>\s*)+", r"\1\2", "5"),
        "a point that is not there": (WAY_OF_5 + r'<nd ref="\d+"', r'\1<nd ref="77777"', "5"),
        "a point twice": (WAY_OF_5 + r"(<nd [^>]*/>)", r"\1\2\2", ""),
        "a kind of its own": (RELATION_5 + r'v="road"', r'\1v="runway"', ""),
        "a rule without lanelets": ("</osm>", f"{RULE}</osm>", ""),
    },
    "commonroad.xml": {
        "whole": ("^", "", ""),
        "no left bound": (OF_5 + r"<leftBound>.*?</leftBound>", r"\1", "5"),
        "no right bound": (OF_5 + r"<rightBound>.*?</rightBound>", r"\1", "5"),
        "a bound of one point": (OF_5 + r"(<leftBound>\s*<point>.*?</point>).*?</left", r"\1\2</left", "5"),
        "a word for a number": (OF_5 + r"<x>[^<]*</x>", r"\1<x>left</x>", "5"),
        "no number": (OF_5 + r"<x>[^<]*</x>", r"\1<x>nan</x>", "5"),
        "a point without y": (OF_5 + r"<y>[^<]*</y>", r"\1", "5"),
        "bounds exchanged": (OF_5 + SIDES, r"\1leftBound>\4</leftBound>\3<rightBound>\2</rightBound>", "5"),
        "a successor that is not there": (OF_5 + r"</lanelet>", r'\1<successor ref="77777"/></lanelet>', ""),
        "a goal that names a lanelet": ("</commonRoad>", f"{GOAL}</commonRoad>", ""),
        "an obstacle": ("</commonRoad>", f"{PARKED}</commonRoad>", ""),
        "an element of nobody": (OF_5 + r"</lanelet>", r"\1<colour>red</colour></lanelet>", ""),
    },
}
"""What is wrong with a file: a pattern, what replaces it, and the lanelet that the notes name; "": nothing is lost."""


@pytest.mark.parametrize(("name", "what"), [(name, what) for name in DEFECTS for what in DEFECTS[name]])
def test_a_map_with_one_defect_opens_in_its_good_part(name: str, what: str, tmp_path: FilePath) -> None:
    pattern, new, said = DEFECTS[name][what]
    whole = (PLACE / name).read_text(encoding="utf-8")
    text, count = re.subn(pattern, new, whole, count=1, flags=re.DOTALL)
    assert count == 1
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    assert sorted(contents(str(file)).faulty) == [said] * bool(said)
    made = read_course(f"{file}#lanelet=1,to=4")
    assert not said or re.search(rf"1 faulty lanelets are left out: {said} \(", " ".join(made.notes))
    path, seen = made.path, np.array(MIDDLES[name])
    if path.origin_deg is not None:  # x = y = 0 of the other reader
        seen = seen + east_north(*np.array([ORIGIN]).T, path.origin_deg)
    way = path.point(np.arange(0.0, path.length, 0.1))
    apart = np.linalg.norm(seen[:, None] - way[None], axis=2).min(axis=1)
    assert apart.max() < 0.25


def test_the_list_of_a_map_names_what_is_left_out(
    tmp_path: FilePath, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (PLACE / "commonroad.xml").read_text(encoding="utf-8")
    (tmp_path / "a.xml").write_text(re.sub(OF_5 + "<x>[^<]*</x>", r"\1<x>left</x>", text, count=1, flags=re.DOTALL))
    assert run("courses", str(tmp_path / "a.xml"), monkeypatch=monkeypatch) == 0
    assert "1 faulty lanelets are left out: 5 (" in capsys.readouterr().out
