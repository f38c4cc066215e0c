"""Waypoints at exactly the bounds of what is taken, and what a file's first line says."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit.paths.waypoints import check_gps, check_metres, check_stated, checked, placed, ring, stated

HEXAGON = np.column_stack((np.cos(np.arange(6) * math.pi / 3.0), np.sin(np.arange(6) * math.pi / 3.0)))
STAIRS = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 1.0), (3.0, 1.0)]


def line(n: int, step: float) -> np.ndarray:
    return np.column_stack((step * np.arange(n), np.zeros(n)))


def turning(radius: float, angle: float) -> np.ndarray:
    a = np.linspace(0.0, angle, 4000)
    return radius * np.column_stack((np.cos(a), np.sin(a)))


@pytest.mark.parametrize(
    ("check", "taken", "refused"),
    [
        (checked, [line(2, 0.1)], [line(2, 0.0999)]),
        (checked, [np.vstack((line(3, 1.0), [[2.0, 1.1e-9]]))], [np.vstack((line(3, 1.0), [[2.0, 0.9e-9]]))]),
        (ring, [[*STAIRS, (3.0, 0.0)]], [[*STAIRS, (3.05, 0.0)]]),
        (ring, [HEXAGON], [HEXAGON[:5]]),
        (check_metres, [line(2, 5.0), line(1, 1.0), line(9, 101.0), line(10, 100.0)], [line(2, 4.99), line(10, 100.1)]),
        (check_metres, [turning(4990.0, 3.2), turning(5010.0, 3.1)], [turning(5010.0, 3.2)]),
    ],
)
def test_points_at_the_bounds(check: Any, taken: list[Any], refused: list[Any]) -> None:
    for points in taken:
        check(np.array(points, dtype=float), "lap")
    for points in refused:
        with pytest.raises(ValueError, match="lap: "):
            check(np.array(points, dtype=float), "lap")


def test_a_ring_is_closed_by_its_first_point_once() -> None:
    for shift, length in ((0.9e-3, 7), (1.1e-3, 8)):
        closed = ring(np.vstack((HEXAGON, HEXAGON[0] + np.array([shift, 0.0]))), "lap")
        assert (len(closed), closed[-1].tolist()) == (length, [1.0, 0.0])


def test_positions_at_the_bounds() -> None:
    for lat, lon in (([90.0, -90.0], [180.0, -180.0]), ([1.6, 0.0], [0.0, 0.0]), ([0.0, 1.5], [3.2, 0.0])):
        check_gps(np.array(lat), np.array(lon), "lap")
    for lat, lon, told in (
        ([math.pi / 2.0], [math.pi], "look like radians"),
        ([0.0], [180.01], "expected -90..90 and -180..180$"),
        ([-90.01], [0.0], r"position 0: lat -90.01, lon 0 .*swapped\?"),
        ([52.0, math.inf], [10.0, 10.001], "position 1 not finite"),
        ([52.0, 52.001], [10.0], r"lat of shape \(2,\), lon of shape \(1,\)"),
    ):
        with pytest.raises(ValueError, match=f"lap: .*{told}"):
            check_gps(np.array(lat), np.array(lon), "lap")
    xy, origin = placed({"lat": np.array([52.0, 52.001]), "lon": np.array([8.0, 8.001])}, "lap")
    assert origin == (52.0, 8.0)
    assert xy[0] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert placed({"x": np.zeros(2), "y": np.ones(2)}, "lap")[1] is None


def test_what_the_first_line_says() -> None:
    assert stated("# paper: closed path, 188.5 m\nx,y\n") == (True, 188.5)
    assert stated("# made by hand\n# paper: open path, 40 m\nx,y\n") == (False, 40.0)
    assert stated("x,y\n0,1\n") is None
    check_stated(10.0, 10.5, 0.5, "lap")
    for length in (10.51, 9.49):
        with pytest.raises(ValueError, match=rf"lap: its first line says 10 m, its points make {length:.1f} m: cut"):
            check_stated(10.0, length, 0.5, "lap")
