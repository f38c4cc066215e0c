"""OpenDRIVE maps: lanes beside a reference line, links, junctions, both hands, and what is told and not used."""

import contextlib
import math
import tracemalloc
from functools import partial
from itertools import pairwise
from pathlib import Path as FilePath
from typing import Any

import mpmath
import numpy as np
import pytest

from steerkit.paths.importers import Line, contents, read_course
from steerkit.paths.importers.opendrive import param_poly3, poly3, read, spiral
from tests.support import road_files

STRAIGHT = '<geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry>'
ARC = '<geometry s="0" x="0" y="0" hdg="0" length="60"><arc curvature="0.02"/></geometry>'


def lane(number: int, a: float = 3.0, *, b: float = 0.0, kind: str = "driving", more: str = "", links: str = "") -> str:
    width = f'<width sOffset="0" a="{a}" b="{b}" c="0" d="0"/>'
    return f'<lane id="{number}" type="{kind}"><link>{links}</link>{width}{more}</lane>'


def section(s: float, *, left: str = "", right: str = "") -> str:
    centre = '<center><lane id="0" type="none"/></center>'
    return f'<laneSection s="{s}"><left>{left}</left>{centre}<right>{right}</right></laneSection>'


def centre(file: FilePath, road: str, number: int) -> Line:
    pieces = [p for p in contents(str(file)).pieces.values() if (p.group, p.lane) == (road, str(number))]
    (piece,) = pieces
    return piece.line()


@pytest.mark.parametrize("name", road_files.ROADS)
def test_roads_of_the_formats_writer_join_up(name: str, tmp_path: FilePath) -> None:
    """The writer has reckoned where each piece begins: ours end there."""
    file = road_files.opendrive(road_files.ROADS[name](), tmp_path / "road.xodr")
    roads, *_ = read(str(file))
    shapes = roads["1"].shapes
    assert len(shapes) == len(road_files.ROADS[name]())
    for before, after in pairwise(shapes):
        x, y, psi = (a[0] for a in before.at(np.array([before.length])))
        assert math.hypot(x - after.x0, y - after.y0) < 1e-6
        assert abs(math.remainder(psi - after.psi0, 2.0 * math.pi)) < 1e-6


def test_lanes_lie_beside_the_line_and_run_as_traffic_does(tmp_path: FilePath) -> None:
    lanes = section(0.0, left=lane(1, 3.0) + lane(2, 2.0), right=lane(-1, 3.5) + lane(-2, 4.0))
    file = road_files.by_hand(tmp_path / "a.xodr", ARC, length=60.0, lanes=lanes)
    for number, radius in ((1, 48.5), (2, 46.0), (-1, 51.75), (-2, 55.5)):
        line = centre(file, "1", number)
        assert np.abs(np.hypot(line.xy[:, 0], line.xy[:, 1] - 50.0) - radius).max() < 1e-9
        forward = line.xy[-1, 0] > line.xy[0, 0]
        assert forward == (number < 0), "on the right is driven along the line"


def test_in_left_hand_traffic_it_is_the_other_way_round(tmp_path: FilePath) -> None:
    file = road_files.by_hand(tmp_path / "a.xodr", STRAIGHT, length=100.0, rule="LHT")
    left, right = centre(file, "1", 1), centre(file, "1", -1)
    assert left.xy[[0, -1]] == pytest.approx(np.array([[0.0, 1.75], [100.0, 1.75]]), abs=1e-9)
    assert right.xy[0] == pytest.approx([100.0, -1.75], abs=1e-9)
    turned = section(0.0, right=lane(-1).replace("<lane ", '<lane direction="reversed" '))
    assert centre(road_files.by_hand(file, STRAIGHT, length=100.0, lanes=turned), "1", -1).xy[0, 0] > 99.9


def test_offset_and_widths_that_change(tmp_path: FilePath) -> None:
    offset = '<laneOffset s="0" a="0.5" b="0" c="0" d="0"/><laneOffset s="40" a="0.5" b="0.02" c="0" d="0"/>'
    lanes = offset + section(0.0, right=lane(-1, 3.0, b=0.01) + lane(-2, 2.0))
    file = road_files.by_hand(tmp_path / "a.xodr", STRAIGHT, length=100.0, lanes=lanes)
    x, y = centre(file, "1", -2).xy.T
    exact = 0.5 + 0.02 * np.maximum(x - 40.0, 0.0) - (3.0 + 0.01 * x) - 1.0
    assert np.abs(y - exact).max() < 1e-9


def test_borders_instead_of_widths(tmp_path: FilePath) -> None:
    border = '<lane id="{}" type="driving"><border sOffset="0" a="{}" b="0" c="0" d="0"/></lane>'
    lanes = section(0.0, right=border.format(-1, -3.0) + border.format(-2, -5.0))
    file = road_files.by_hand(tmp_path / "a.xodr", STRAIGHT, length=100.0, lanes=lanes)
    assert centre(file, "1", -2).xy[:, 1] == pytest.approx(-4.0, abs=1e-12)


def test_a_lane_goes_on_through_sections_under_another_number(tmp_path: FilePath) -> None:
    back, to = '<predecessor id="1"/>', '<successor id="-2"/>'
    lanes = section(0.0, left=lane(1), right=lane(-1, 3.0, links=to)) + section(
        50.0, left=lane(1, links=back), right=lane(-1, 0.0, b=0.06) + lane(-2, 3.0, links='<predecessor id="-1"/>')
    )
    file = road_files.by_hand(tmp_path / "a.xodr", STRAIGHT, length=100.0, lanes=lanes)
    made = read_course(f"{file}#road=1,lane=-1,noise=0")
    assert made.path.length == pytest.approx(100.0, abs=0.2)
    assert made.path.point(25.0)[1] == pytest.approx(-1.5, abs=0.02)
    assert made.path.point(made.path.length)[1] == pytest.approx(-4.5, abs=0.02)
    assert read_course(f"{file}#road=1,lane=1").path.length == pytest.approx(100.0, abs=0.2)


def test_speeds_of_road_and_lane(tmp_path: FilePath) -> None:
    road = '<type s="0" type="town"><speed max="50" unit="km/h"/></type>'
    road += '<type s="60" type="rural"><speed max="no limit"/></type>'
    speeds = '<speed sOffset="20" max="5" unit="m/s"/><speed sOffset="60" max="4"/>'
    lanes = section(0.0, right=lane(-1, more=speeds) + lane(-2))
    file = road_files.by_hand(tmp_path / "a.xodr", STRAIGHT, length=100.0, lanes=lanes, more=road)
    limit = centre(file, "1", -1).v_limit
    assert limit is not None
    assert (limit[0], limit[80], limit[-1]) == (pytest.approx(50.0 / 3.6), 5.0, 4.0)
    limit = centre(file, "1", -2).v_limit
    assert limit is not None
    assert limit[100] == pytest.approx(50.0 / 3.6)
    assert math.isnan(limit[-1])


def test_routes_through_a_junction(tmp_path: FilePath) -> None:
    file = road_files.junction(tmp_path / "town.xodr")
    made = read_course(f"{file}#road=1,lane=-1,to=2")
    assert made.path.length == pytest.approx(60.0 + 26.3 + 60.0, abs=0.2)
    assert "road 1, 100, 2" in made.notes[0]
    assert made.v_limit is not None
    inside = np.isnan(made.v_limit)
    assert np.allclose(made.v_limit[~inside], 50.0 / 3.6)
    assert 20 < inside.sum() < 32, "nobody says how fast the junction's own road is"
    assert abs(made.path.samples.kappa).max() < 1.0 / 14.0


def two(s: str = "100", x: str = "100", heading: str = "0") -> str:
    return STRAIGHT + STRAIGHT.replace('s="0" x="0" y="0" hdg="0"', f's="{s}" x="{x}" y="0" hdg="{heading}"')


def test_small_gaps_are_driven(tmp_path: FilePath) -> None:
    file = road_files.by_hand(tmp_path / "a.xodr", two("100.2", "100.19", "0.09"), length=200.1)
    assert [*contents(str(file)).groups] == ["1"]


@pytest.mark.parametrize(
    ("geometry", "length", "message"),
    [
        (STRAIGHT, 150.0, "its geometry is 100.000 m long, the road 150.000 m"),
        (two("100", "100.21"), 200.0, "torn by 0.21 m at s = 100.0 m"),
        (two("100", "100", "0.11"), 200.0, "kink of 0.11"),
        (two("100.22"), 200.0, "its geometry leaves out 0.22 m at s = 100.2 m"),
        (STRAIGHT, 100.12, "its geometry is 100.000 m long"),
        (STRAIGHT.replace("<line/>", "<curve/>"), 100.0, "holds curve; known: line, arc, spiral"),
        (STRAIGHT.replace('length="100"', 'length="1e"'), 100.0, "length: is '1e', expected a number"),
        (STRAIGHT.replace('length="100"', 'length="-1"'), 100.0, "is -1.0 m long"),
        (ARC.replace("0.02", "9.9"), 60.0, "turns by 594 rad, which no road does"),
    ],
)
def test_what_contradicts_itself_is_refused(geometry: str, length: float, message: str, tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match=message):
        contents(str(road_files.by_hand(tmp_path / "a.xodr", geometry, length=length)))


def test_a_faulty_road_leaves_the_others_and_lanes_without_links_go_on(tmp_path: FilePath) -> None:
    whole = "".join(section(s, right=lane(-1)) for s in (0.0, 50.0, 100.0))
    file = road_files.by_hand(
        tmp_path / "a.xodr", STRAIGHT.replace('length="100"', 'length="150"'), length=150.0, lanes=whole
    )
    made = read_course(f"{file}#road=1,lane=-1")
    assert made.path.length == pytest.approx(150.0, abs=1e-3)
    told = [note for note in made.notes if "no link at s" in note]
    assert told == [f"road 1, lane -1: no link at s = {s:.1f} m; it is taken as going on" for s in (50.0, 100.0)]
    text = file.read_text()
    torn = (
        text[text.index("<road ") : text.index("</road>") + 7]
        .replace('id="1"', 'id="2"', 1)
        .replace("<line/>", "<curve/>")
    )
    file.write_text(text.replace("</OpenDRIVE>", f"{torn}</OpenDRIVE>"))
    made = read_course(f"{file}#road=1,lane=-1")
    assert made.path.length == pytest.approx(150.0, abs=1e-3)
    assert any(note.startswith("1 faulty roads are left out: 2 (") for note in made.notes)
    with pytest.raises(ValueError, match=r"road 2 is faulty: .* holds curve; known: line, arc"):
        read_course(f"{file}#road=2,lane=-1")


def test_lanes_that_cannot_be_driven_are_no_choice(tmp_path: FilePath) -> None:
    lanes = section(0.0, right=lane(-1) + lane(-2, kind="sidewalk"))
    file = road_files.by_hand(tmp_path / "a.xodr", STRAIGHT, length=100.0, lanes=lanes)
    with pytest.raises(ValueError, match="has no lane -2 to drive on; lanes: -1"):
        read_course(f"{file}#road=1,lane=-2")
    assert read_course(str(file)).path.length == pytest.approx(100.0, abs=1e-3)
    for number, fits in (("-999", True), ("1000", False), ("-1.5", False)):
        lanes = section(0.0, right=lane(-1, links=f'<successor id="{number}"/>'))
        with contextlib.nullcontext() if fits else pytest.raises(ValueError, match="expected a lane's number"):
            contents(str(road_files.by_hand(file, STRAIGHT, length=100.0, lanes=lanes)))


EXACT = 1e-9


@pytest.mark.parametrize("k", [0.1, -0.02, 1e-7, 0.0])
def test_an_arc_is_a_part_of_a_circle(k: float) -> None:
    d = np.linspace(0.0, 90.0, 37)
    u, v, heading = spiral(90.0, k, k, d)
    assert np.allclose(heading, k * d, atol=1e-12)
    exact_u = np.sin(k * d) / k if k else d
    exact_v = 2.0 * np.sin(0.5 * k * d) ** 2 / k if k else 0.0 * d
    assert np.abs(u - exact_u).max() < EXACT
    assert np.abs(v - exact_v).max() < EXACT


def test_a_long_spiral_takes_no_more_memory_for_its_turns() -> None:
    d, k = np.linspace(0.0, 2e5, 2001), 9e-4
    tracemalloc.start()
    u, _, _ = spiral(2e5, k, k, d)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()
    assert np.abs(u - np.sin(k * d) / k).max() < 1e-8


@pytest.mark.parametrize(("k0", "k1"), [(0.0, 0.2), (0.1, -0.1), (0.05, 0.05 + 1e-9), (-0.02, 0.3), (1e-9, -1e-9)])
def test_a_spiral_between_any_curvatures(k0: float, k1: float) -> None:
    """Also where curvature hardly changes, and Fresnel integrals would lose all digits."""
    length = 80.0
    u, v, _ = spiral(length, k0, k1, np.array([length]))
    with mpmath.workdps(25):
        integral = mpmath.quad(lambda t: mpmath.expj(k0 * t + (k1 - k0) * t * t / (2 * length)), [0, 20, 40, 60, 80])
    assert abs(u[0] - float(integral.real)) < EXACT
    assert abs(v[0] - float(integral.imag)) < EXACT


def test_a_cubics_distance_is_its_arc_length() -> None:
    for d in (5.0, 31.7, 50.0):
        (u,), _, _ = poly3(50.0, np.array([0.0, 0.1, -0.02, 4e-4]), np.array([d]))
        with mpmath.workdps(20):
            along = mpmath.quad(lambda p: mpmath.sqrt(1 + (0.1 - 0.04 * p + 1.2e-3 * p * p) ** 2), [0, u / 2, u])
        assert float(along) == pytest.approx(d, abs=EXACT)


def test_two_cubics_of_a_parameter_in_both_ranges(tmp_path: FilePath) -> None:
    length, d = 40.0, np.linspace(0.0, 40.0, 11)
    cubics = {"U": (0.0, 1.0, 0.0, -1e-5), "V": (0.0, 0.0, 5e-3, -1e-4)}
    by_range = []
    for name, scale in (("arcLength", 1.0), ("normalized", length)):
        numbers = {
            f"{c}{axis}": a * scale**k for axis, row in cubics.items() for k, (c, a) in enumerate(zip("abcd", row))
        }
        written = " ".join(f'{key}="{number!r}"' for key, number in numbers.items())
        piece = STRAIGHT.replace("<line/>", f'<paramPoly3 {written} pRange="{name}"/>').replace('"100"', '"40"')
        roads, *_ = read(str(road_files.by_hand(tmp_path / "a.xodr", piece, length=length)))
        by_range.append(roads["1"].reference(d))
    for one, other in zip(*by_range):
        assert np.abs(one - other).max() < EXACT
    x, y, heading = by_range[0]
    assert np.abs(x - (d - 1e-5 * d**3)).max() < EXACT
    assert np.abs(y - (5e-3 * d**2 - 1e-4 * d**3)).max() < EXACT
    assert np.abs(heading - np.arctan2(1e-2 * d - 3e-4 * d**2, 1.0 - 3e-5 * d**2)).max() < EXACT


@pytest.mark.parametrize(
    "local",
    [
        partial(spiral, 60.0, -0.03, 0.08),
        partial(poly3, 60.0, np.array([0.0, 0.0, 0.01, -1e-4])),
        partial(param_poly3, 1.0, np.array([0.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1e-3, 1e-5])),
    ],
)
def test_the_heading_is_that_of_the_line(local: Any) -> None:
    d = np.linspace(1.0, 59.0, 59)
    (u0, v0, _), (u1, v1, _) = local(d - 1e-4), local(d + 1e-4)
    assert np.abs(np.arctan2(v1 - v0, u1 - u0) - local(d)[2]).max() < 1e-7
