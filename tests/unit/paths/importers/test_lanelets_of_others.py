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
def test_a_map_with_one_defect_opens_in_its_good_part(name: str, what: str, tmp_path: Path) -> None:
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
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (PLACE / "commonroad.xml").read_text(encoding="utf-8")
    (tmp_path / "a.xml").write_text(re.sub(OF_5 + "<x>[^<]*</x>", r"\1<x>left</x>", text, count=1, flags=re.DOTALL))
    assert run("courses", str(tmp_path / "a.xml"), monkeypatch=monkeypatch) == 0
    assert "1 faulty lanelets are left out: 5 (" in capsys.readouterr().out
