"""Tracks that were recorded: stops, gaps, wrong positions, rounds and speeds."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.paths.courses import course
from steerkit.paths.importers import Line
from steerkit.paths.importers.recorded import cleaned, rounds

PATH = course("circle")


def track(seconds: float, noise: float = 0.0, v: float = 5.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(0.0, seconds, 1.0)
    xy = np.asarray(PATH.point(v * t))
    return xy + noise * np.random.default_rng(seed).normal(size=xy.shape), t


def test_speed_is_the_slope_of_the_way() -> None:
    xy, t = track(36.0)
    line, notes = cleaned(xy, t, None, 0.0, "lap")
    assert notes == ()
    assert line.v is not None
    assert line.v[5:-5] == pytest.approx(5.0, rel=0.12), "a chord of nine seconds is shorter than its arc"
    told, _ = cleaned(xy, t, np.full(len(t), 4.9), 0.0, "lap")
    assert told.v is not None
    assert (told.v == 4.9).all(), "what the receiver says goes before"


def test_of_a_stop_one_point_is_left() -> None:
    xy, _ = track(30.0)
    rng = np.random.default_rng(1)
    stood = xy[12] + 0.3 * rng.normal(size=(40, 2))
    all_xy = np.vstack((xy[:13], stood, xy[13:]))
    all_t = np.arange(len(all_xy)) * 1.0
    line, (note,) = cleaned(all_xy, all_t, None, 0.5, "lap")
    assert note == "left out 40 of 70 points, recorded while the car stood"
    assert np.array_equal(line.xy, xy)


def test_a_gap_is_refused_with_what_to_record() -> None:
    xy, t = track(36.0)
    keep = (t < 10.0) | (t > 20.0)
    with pytest.raises(ValueError, match=r"a gap of 13 s and 50 m after point 9 .9 s .*: .* record that stretch again"):
        cleaned(xy[keep], t[keep] + (t[keep] > 20.0), None, 0.5, "lap")
    on_standby = t + 600.0 * (t > 10.0)  # ten minutes without a word, but not a metre further
    cleaned(xy, on_standby, None, 0.5, "lap")


@pytest.mark.parametrize(("by", "message"), [((900.0, 0.0), "a wrong position"), ((0.0, 80.0), "a wrong position")])
def test_a_wrong_position_is_refused(by: tuple[float, float], message: str) -> None:
    xy, t = track(36.0)
    xy[14] += by
    with pytest.raises(ValueError, match=message):
        cleaned(xy, t, None, 0.5, "lap")
    with pytest.raises(ValueError, match=message):
        cleaned(xy, None, None, 0.5, "lap")


def test_time_that_runs_back_is_refused() -> None:
    xy, t = track(36.0)
    t[20:] -= 15.0
    with pytest.raises(ValueError, match="time runs back after point 19: two drives in one track"):
        cleaned(xy, t, None, 0.5, "lap")


@pytest.mark.parametrize(("noise", "seed"), [(0.0, 0), (1.0, 0), (1.0, 1), (1.0, 2)])
def test_a_round_ends_where_it_began(noise: float, seed: int) -> None:
    around = 2.0 * np.pi * 30.0 / 5.0  # seconds
    xy, _ = track(2.4 * around, noise, seed=seed)
    for number in (1, 2):
        line, closed, (note,) = rounds(Line(xy=xy), noise, number, "lap")
        assert closed
        assert len(line.xy) == pytest.approx(around, abs=2.0)
        assert note.startswith(f"round {number} of 2")
    with pytest.raises(ValueError, match="lap 3, but it has 2 whole rounds"):
        rounds(Line(xy=xy), noise, 3, "lap")


def test_what_does_not_come_back_is_no_round() -> None:
    xy, _ = track(20.0)
    line, closed, notes = rounds(Line(xy=xy), 0.5, None, "lap")
    assert (len(line.xy), closed, notes) == (20, False, ())
    there_and_back = np.vstack((np.linspace((0, 0), (200, 0), 41), np.linspace((200, 4), (0, 4), 41)))
    assert not rounds(Line(xy=there_and_back), 0.5, None, "lap")[1], "it comes back the other way"
