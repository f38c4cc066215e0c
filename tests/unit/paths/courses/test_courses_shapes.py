"""Manoeuvres ask of the car what they are made for, and all courses are those written down."""

import json

import numpy as np
import pytest

from steerkit.paths.courses import bends, circle, course, figure_eight, lane_change, names, random_course, straight
from tests.support.places import ROOT


@pytest.mark.parametrize("part", [1, 2])
@pytest.mark.parametrize("speed", [4.0, 9.0])
def test_lane_changes_ask_the_lateral_acceleration_they_are_made_for(part: int, speed: float) -> None:
    path = lane_change(part, speed=speed)
    s = np.linspace(0.0, path.length, 4000)
    assert speed**2 * np.abs(path.kappa(s)).max() == pytest.approx(3.0, rel=0.1)
    _, y = path.point(s).T
    offset = {1: 3.5, 2: 1.0 + 0.5 * (1.1 * 1.82 + 0.25 + 1.82 + 1.0)}[part]
    assert (y.min(), y.max()) == (pytest.approx(0.0, abs=1e-3), pytest.approx(offset, abs=1e-3))


def test_courses_are_those_written_down() -> None:
    """Length, number of knots, weighted sums of their numbers; whoever changes one on purpose replaces its line."""
    plan = [(20.0, 90.0, 9.0, 5.0), (30.0, 180.0, 12.0, 0.0), (5.0, 0.0, 1.0, 0.0), (30.0, 90.0, 8.0, 7.5)]
    paths = {name: course(name) for name in names()} | {
        "circle 3": circle(3.0),
        "straight 2.5": straight(2.5),
        "eight 20": figure_eight(20.0),
        "lane change 4": lane_change(2, speed=4.0),
        "bends": bends(plan),
        "random 3": random_course(3),
        "random 4": random_course(4, length=90.0, max_kappa=0.2),
    }
    found = {}
    for name, path in paths.items():
        rows = path.table.rows
        sums = np.cos(np.arange(len(rows))) @ rows / len(rows)
        found[name] = [float(f"{number:.12g}") for number in (path.length, len(rows), *np.round(sums, 12))]
    expected = json.loads((ROOT / "tests/golden/courses.json").read_text(encoding="utf-8"))
    for name, numbers in found.items():
        line = f'"{name}": {json.dumps(numbers)}'
        assert numbers == pytest.approx(expected.pop(name, []), rel=1e-9, abs=1e-9), line
    assert not expected
