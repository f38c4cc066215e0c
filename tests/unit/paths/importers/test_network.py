"""Routes through pieces that are connected, and those that are not."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit.paths.importers import Line, Map, Piece


def piece(group: str, a: tuple[float, float], b: tuple[float, float], *after: str, **more: Any) -> Piece:
    xy = np.linspace(a, b, 11)
    return Piece(group=group, length=math.dist(a, b), next=after, line=lambda: Line(xy=xy), **more)


def town(**changes: Piece) -> Map:
    """A block of four streets that is driven round, a longer way from a to c, and a street apart."""
    pieces = {
        "a": piece("a", (0, 0), (40, 0), "far", "b"),
        "b": piece("b", (40, 0), (60, 10), "c"),
        "far": piece("far", (40, 0), (200, 0), "home"),
        "home": piece("home", (200, 0), (60, 10), "c"),
        "c": piece("c", (60, 10), (20, 60), "d"),
        "d": piece("d", (20, 60), (0, 0), "a"),
        "apart": piece("apart", (0, 500), (10, 500)),
    }
    return Map(kind="way", pieces=pieces | changes, noise=1.0, drawn=True)


def test_the_shortest_route_is_taken() -> None:
    line, closed, notes = town().route({"way": "a", "to": "c"}, "town")
    assert not closed
    assert notes[0] == "way a, b, c"
    assert line.xy[0].tolist() == [0.0, 0.0]
    assert line.xy[-1].tolist() == [20.0, 60.0]
    assert len(line.xy) == 31, "where pieces meet there is one point"


def test_back_to_its_beginning_it_is_a_round() -> None:
    line, closed, notes = town().route({"way": "b", "to": "b"}, "town")
    assert closed
    assert notes[0] == "way b, c, d, a"
    assert np.hypot(*(line.xy[-1] - line.xy[0])) < 1e-9


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({}, r"which way\? choose one, FILE#way=...: way a \(40 m\); way b \(22 m\)"),
        ({"way": "x"}, "there is no way x; there is way a"),
        ({"way": "a", "to": "x"}, "town: to: there is no way x"),
        ({"way": "a", "to": "apart"}, "no route leads to way apart: not connected; what can be reached: a, b, c, d, f"),
        ({"way": "a", "lane": "1"}, "lane is no key here"),
        ({"lanelet": "1"}, "lanelet is no key here; it holds way a"),
        ({"way": "a", "to": "b:7"}, "way b has no lane 7"),
    ],
)
def test_other_choices_are_refused(choice: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        town().route(choice, "town")


def test_pieces_that_do_not_meet_are_refused_and_small_gaps_told() -> None:
    gap = town(b=piece("b", (41, 0), (60, 10), "c"))
    told = r"a gap of 1 m between way a and way b, at \(41.0, 0.0\) \[m\]: not connected"
    with pytest.raises(ValueError, match=told):
        gap.route({"way": "a", "to": "c"}, "town")
    small = town(b=piece("b", (40.5, 0), (60, 10), "c"))
    _, _, notes = small.route({"way": "a", "to": "c"}, "town")
    assert notes[1] == "a gap of 0.50 m between way a and way b is bridged"


def test_a_kink_between_lanes_is_refused() -> None:
    lanes = Map(kind="lanelet", pieces=town().pieces, noise=0.1, drawn=True)
    with pytest.raises(ValueError, match=r"a kink of 1.8 rad between lanelet b and lanelet c, at \(60.0, 10.0\) \[m\]"):
        lanes.route({"lanelet": "a", "to": "c"}, "town")


def test_lanes_are_asked_for_where_there_are_several() -> None:
    pieces = {f"1/{k}": piece("1", (0, -k), (40, -k), lane=str(-k)) for k in (1, 2)}
    road = Map(kind="road", pieces=pieces, noise=0.0, drawn=False)
    with pytest.raises(ValueError, match=r"which lane of road 1\? choose lane=: -1, -2"):
        road.route({"road": "1"}, "town")
    line, _, notes = road.route({"road": "1", "lane": "-2"}, "town")
    assert line.xy[0].tolist() == [0.0, -2.0]
    assert notes[0] == "road 1, lane -2 at its beginning"
    assert road.length_of("1") == 40.0
