"""CommonRoad scenarios, Lanelet2 maps and plain ways of OSM."""

from pathlib import Path as FilePath
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from steerkit.paths.importers import contents, read_course
from steerkit.paths.importers.lanelets import _chained, commonroad, osm
from tests.support import road_files


def bound(side: str, y: float, x0: float, x1: float) -> str:
    rows = "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x in np.linspace(x0, x1, 6))
    return f"<{side}Bound>{rows}</{side}Bound>"


def lanelet(name: int, x0: float, x1: float, *, after: int | None = None, y: float = 0.0, more: str = "") -> str:
    bounds = bound("left", y + 2.0, x0, x1) + bound("right", y - 1.0, x0, x1)
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
        ('<lanelet id="1"/>', "leftBound of 0 points, expected 2 or more"),
        (
            f'<lanelet id="1">{bound("left", 30, 0, 9)}{bound("right", 0, 0, 9)}</lanelet>',
            "30 m apart, expected at most 20",
        ),
        (
            f'<lanelet id="1">{bound("left", 0, 0, 9)}{bound("right", 3, 0, 9)}</lanelet>',
            "its left bound is on the right",
        ),
        ("", "holds no lanelets"),
    ],
)
def test_scenarios_that_contradict_themselves_are_refused(text: str, message: str, tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match=message):
        commonroad(str(scenario(tmp_path / "a.xml", text)))


NODES = {1: (0, 2), 2: (30, 2), 3: (60, 2), 4: (0, -2), 5: (30, -2), 6: (60, -2), 7: (90, 8), 8: (90, 4)}


def nodes() -> str:
    lat, lon = road_files.positions(np.array([*NODES.values()], dtype=float))
    return "".join(f'<node id="{k}" lat="{a!r}" lon="{b!r}"/>' for k, a, b in zip(NODES, lat.tolist(), lon.tolist()))


def way(name: int, *refs: int, **tags: str) -> str:
    inside = "".join(f'<nd ref="{r}"/>' for r in refs) + "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
    return f'<way id="{name}">{inside}</way>'


def relation(name: int, left: int, right: int, **tags: str) -> str:
    members = f'<member type="way" ref="{left}" role="left"/><member type="way" ref="{right}" role="right"/>'
    inside = "".join(f'<tag k="{k}" v="{v}"/>' for k, v in ({"type": "lanelet", "subtype": "road"} | tags).items())
    return f'<relation id="{name}">{members}{inside}</relation>'


def osm_file(file: FilePath, *parts: str) -> FilePath:
    file.write_text(f'<osm version="0.6">{nodes()}{"".join(parts)}</osm>')
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
        ((way(11, 1, 2), way(12, 4, 5), relation(21, 11, 99)), "its bound, way 99, is not in the file"),
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
    moved = {**NODES, 5: (12, -2), 6: (42, -2)}
    places = np.array([*moved.values()], dtype=float)
    lat, lon = road_files.positions(places)
    rows = "".join(f'<node id="{k}" lat="{a!r}" lon="{b!r}"/>' for k, a, b in zip(moved, lat.tolist(), lon.tolist()))
    (tmp_path / "a.osm").write_text(f'<osm version="0.6">{rows}{"".join(ways)}{relation(21, 11, 12)}</osm>')
    line = osm(str(tmp_path / "a.osm")).pieces["21"].line().xy
    assert np.diff(line[:, 0]).min() > 0.0
    assert line[:, 0] == pytest.approx(np.linspace(6.0, 36.0, len(line)), abs=0.1)
    assert np.ptp(line[:, 1]) < 1e-3
