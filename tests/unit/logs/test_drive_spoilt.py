"""What can be told of spoilt values where no check sum does."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.logs.drive import lone, odd_values, standing_off

T = np.arange(0.0, 20.0, 0.02)
RNG = np.random.default_rng(1)


def test_a_value_that_stands_off_is_found_where_it_is() -> None:
    for noise in (0.0, 1e-3):
        values = np.sin(T) + noise * RNG.normal(size=len(T))
        assert odd_values({"v": values}, {"v": T}) == []
        values[437] += 0.1
        assert standing_off(values, 0.0).tolist() == [437]
        (told,) = odd_values({"v": values}, {"v": T})
        assert told == f"v stands off from all around in 1 samples, the first {T[437]:.6g} s from its start: spoilt?"


def test_noise_steps_and_a_kink_are_nothing_odd() -> None:
    rough = RNG.normal(size=5000)
    steps = np.round(np.sin(T), 2)
    flickering = np.where(np.arange(len(T)) == 500, 0.01, 0.0)
    kink = np.maximum(T - 10.0, 0.0)
    jump = np.where(T < 10.0, 0.0, 5.0)
    assert odd_values({"v": rough}, {"v": np.arange(5000.0)}) == []
    for values in (steps, flickering, kink, jump):
        assert odd_values({"v": values}, {"v": T}) == []


@pytest.mark.parametrize(("by", "told"), [(0.015, 1), (-0.015, 1), (0.004, 0)])
def test_a_time_that_is_not_that_of_its_sample_is_told_and_a_late_one_is_not(by: float, told: int) -> None:
    t = T.copy()
    t[300] += by
    found = odd_values({"r": np.sin(T)}, {"r": t})
    assert [one for one in found if one.startswith("the time of r stands off")] == found[:told]
    assert len([one for one in found if "time" in one]) == told


def test_a_lost_sample_and_a_pause_are_no_wrong_times() -> None:
    there = np.ones(len(T), dtype=bool)
    there[[100, *range(500, 560)]] = False
    assert odd_values({"r": np.sin(T[there])}, {"r": T[there]}) == []


def test_values_that_are_none_and_short_channels_are_passed_over() -> None:
    values = np.sin(T)
    values[::7] = np.nan
    assert odd_values({"r": values}, {"r": T}) == []
    assert odd_values({"r": T[:10]}, {"r": T[:10]}) == []


def test_a_lone_value_is_found_where_it_is() -> None:
    values = np.sin(T)
    values[200] = 9.0
    assert lone(values, np.full(len(T) - 2, 0.5)).tolist() == [200]
    values[200:202] = 9.0
    assert lone(values, np.full(len(T) - 2, 0.5)).tolist() == []
