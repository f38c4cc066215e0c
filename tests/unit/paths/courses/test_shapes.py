"""Manoeuvres ask of the car what they are made for."""

import numpy as np
import pytest

from steerkit.paths.courses import lane_change, slalom


@pytest.mark.parametrize("part", [1, 2])
@pytest.mark.parametrize("speed", [4.0, 9.0])
def test_lane_changes_ask_the_lateral_acceleration_they_are_made_for(part: int, speed: float) -> None:
    path = lane_change(part, speed=speed)
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
    path = slalom()
    s = np.linspace(0.0, path.length, 4000)
    _, y = path.point(s).T
    assert (y.min(), y.max()) == (pytest.approx(-1.0, abs=1e-3), pytest.approx(1.0, abs=1e-3))
    assert np.abs(path.kappa(s)).max() == pytest.approx(0.036, abs=1e-3)


@pytest.mark.parametrize(("part", "speed"), [(3, 9.0), (1, 0.0)])
def test_another_lane_change_is_refused(part: int, speed: float) -> None:
    with pytest.raises(ValueError, match=r"valid: 1, 2|expected > 0"):
        lane_change(part, speed=speed)
