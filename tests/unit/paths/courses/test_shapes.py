"""Manoeuvres ask of the car what they are made for."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.paths.courses import curvature_step, lane_change, slalom


@pytest.mark.parametrize("part", [1, 2])
@pytest.mark.parametrize("speed", [4.0, 9.0])
def test_lane_changes_ask_the_lateral_acceleration_they_are_made_for(part: int, speed: float) -> None:
    path = lane_change(part, speed=speed, a_y=3.0)
    s = np.linspace(0.0, path.length, 4000)
    assert speed**2 * np.abs(path.kappa(s)).max() == pytest.approx(3.0, rel=0.1)
    x, y = path.point(s).T
    offset = {1: 3.5, 2: 1.0 + 0.5 * (1.1 * 1.82 + 0.25 + 1.82 + 1.0)}[part]
    assert (y.min(), y.max()) == (pytest.approx(0.0, abs=1e-3), pytest.approx(offset, abs=1e-3))
    sections = {1: (15.0, 30.0, 25.0, 25.0, 30.0), 2: (12.0, 13.5, 11.0, 12.5, 12.0)}[part]
    whole = x.max() - x.min() - 60.0
    there = x[y > offset - 1e-6]
    assert (there.max() - there.min()) / whole == pytest.approx(sections[2] / sum(sections), rel=0.15)


def test_a_slalom_swings_by_its_offset() -> None:
    path = slalom(5, spacing=20.0, offset=1.5)
    _, y = path.point(np.linspace(0.0, path.length, 4000)).T
    assert (y.min(), y.max()) == (pytest.approx(-1.5, abs=1e-3), pytest.approx(1.5, abs=1e-3))


@pytest.mark.parametrize(
    "make",
    [
        lambda: lane_change(3),
        lambda: lane_change(1, speed=0.0),
        lambda: slalom(0),
        lambda: slalom(spacing=-1.0),
        lambda: curvature_step(0.1),
        lambda: curvature_step(turn_deg=350.0),
    ],
)
def test_bad_courses(make) -> None:
    with pytest.raises(ValueError, match=r"expected|valid|> 0"):
        make()
