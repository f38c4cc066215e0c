"""Maps as lanelet2 and commonroad-io write them, whole and with one defect each: the way lies where their own readers
see it, and the defect is named. tests/support/maps_of_others/make_maps.py made them."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from steerkit.paths.importers import contents, read_course
from steerkit.paths.waypoints import east_north
from tests.support.command_lines import run
from tests.support.places import SUPPORT

ORIGIN = (52.28, 8.02)
PLACE = SUPPORT / "maps_of_others"
MIDDLES = json.loads((PLACE / "middles.json").read_text(encoding="utf-8"))
OF_5 = r'(<lanelet id="5">.*?)'
RELATION_5 = r'(<relation id="5".*?)'
WAY_OF_5 = r'(<way id="1111".*?)'
"""The left bound of lanelet 5 of lanelet2.osm."""

DEFECTS: list[tuple[str, str, str, str, str]] = [
    # file, what, pattern, replacement, what the notes say; "" where nothing is lost
    ("lanelet2.osm", "whole", "^", "", ""),
    ("lanelet2.osm", "no left bound", RELATION_5 + r'<member [^>]*role="left"[^>]*/>', r"\1", "5"),
    ("lanelet2.osm", "no right bound", RELATION_5 + r'<member [^>]*role="right"[^>]*/>', r"\1", "5"),
    ("lanelet2.osm", "a bound that is not there", RELATION_5 + r'ref="\d+"', r'\1ref="77777"', "5"),
    ("lanelet2.osm", "a bound of a word", RELATION_5 + r'ref="\d+"', r'\1ref="left"', "5"),
    ("lanelet2.osm", "one bound twice", RELATION_5 + r'ref="(\d+)"(.*?)ref="\d+"', r'\1ref="\2"\3ref="\2"', "5"),
    ("lanelet2.osm", "bounds exchanged", RELATION_5 + r'"left"(.*?)"right"', r'\1"right"\2"left"', ""),
    ("lanelet2.osm", "a bound of one point", WAY_OF_5 + r"(<nd [^>]*/>\s*)(?:<nd [^>]*/>\s*)+", r"\1\2", "5"),
    ("lanelet2.osm", "a point that is not there", WAY_OF_5 + r'<nd ref="\d+"', r'\1<nd ref="77777"', "5"),
    ("lanelet2.osm", "a point twice", WAY_OF_5 + r"(<nd [^>]*/>)", r"\1\2\2", ""),
    ("lanelet2.osm", "a kind of its own", RELATION_5 + r'v="road"', r'\1v="runway"', ""),
    (
        "lanelet2.osm",
        "a rule without lanelets",
        "</osm>",
        '<relation id="9"><tag k="type" v="regulatory_element"/></relation></osm>',
        "",
    ),
    ("commonroad.xml", "whole", "^", "", ""),
    ("commonroad.xml", "no left bound", OF_5 + r"<leftBound>.*?</leftBound>", r"\1", "5"),
    ("commonroad.xml", "no right bound", OF_5 + r"<rightBound>.*?</rightBound>", r"\1", "5"),
    (
        "commonroad.xml",
        "a bound of one point",
        OF_5 + r"(<leftBound>\s*<point>.*?</point>).*?</leftBound>",
        r"\1\2</leftBound>",
        "5",
    ),
    ("commonroad.xml", "a word for a number", OF_5 + r"<x>[^<]*</x>", r"\1<x>left</x>", "5"),
    ("commonroad.xml", "no number", OF_5 + r"<x>[^<]*</x>", r"\1<x>nan</x>", "5"),
    ("commonroad.xml", "a point without y", OF_5 + r"<y>[^<]*</y>", r"\1", "5"),
    (
        "commonroad.xml",
        "bounds exchanged",
        OF_5 + r"leftBound>(.*?)</leftBound>(.*?)<rightBound>(.*?)</rightBound>",
        r"\1leftBound>\4</leftBound>\3<rightBound>\2</rightBound>",
        "5",
    ),
    (
        "commonroad.xml",
        "a successor that is not there",
        OF_5 + r"</lanelet>",
        r'\1<successor ref="77777"/></lanelet>',
        "",
    ),
    (
        "commonroad.xml",
        "a goal that names a lanelet",
        "</commonRoad>",
        '<planningProblem id="99"><goalState><position><lanelet ref="4"/></position></goalState></planningProblem>'
        "</commonRoad>",
        "",
    ),
    (
        "commonroad.xml",
        "an obstacle",
        "</commonRoad>",
        '<staticObstacle id="98"><type>parkedVehicle</type></staticObstacle></commonRoad>',
        "",
    ),
    ("commonroad.xml", "an element of nobody", OF_5 + r"</lanelet>", r"\1<colour>red</colour></lanelet>", ""),
]


@pytest.mark.parametrize(("name", "what", "pattern", "new", "said"), DEFECTS, ids=[f"{d[0]}, {d[1]}" for d in DEFECTS])
def test_a_map_with_one_defect_opens_in_its_good_part(
    name: str, what: str, pattern: str, new: str, said: str, tmp_path: Path
) -> None:
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
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (PLACE / "commonroad.xml").read_text(encoding="utf-8")
    (tmp_path / "a.xml").write_text(re.sub(OF_5 + "<x>[^<]*</x>", r"\1<x>left</x>", text, count=1, flags=re.DOTALL))
    assert run("courses", str(tmp_path / "a.xml"), monkeypatch=monkeypatch) == 0
    assert "1 faulty lanelets are left out: 5 (" in capsys.readouterr().out
