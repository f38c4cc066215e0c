"""The recorded laps have their positions, and both foresee a car on a circle."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import laps
from steerkit.estimators.vehicle_state import VehicleState
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.vehicles import VW_PASSAT


@pytest.mark.parametrize("name", sorted(laps.LAPS))
def test_a_lap_moves_as_its_speed_and_heading_say(name: str) -> None:
    lap = laps.lap(name)
    dx, dy = np.diff(lap["x"]), np.diff(lap["y"])
    fast = (lap["v"][1:] > laps.SLOWEST) & (np.diff(lap["t"]) < 0.03)
    speed = np.hypot(dx, dy)[fast] / np.diff(lap["t"])[fast]
    assert np.median(speed / lap["v"][1:][fast]) == pytest.approx(1.0, abs=0.01)
    off = np.angle(np.exp(1j * (np.arctan2(dy, dx) - lap["psi"][1:])))[fast]
    assert abs(np.median(off)) < 0.02
    assert np.isfinite(lap["r"]).all() == (name == "genesis")


def test_who_drives_on_a_circle_is_foreseen_by_both_and_worse_by_dead_reckoning_with_a_bias() -> None:
    t = np.arange(0.0, 25.0, 0.02)
    v, r = 6.0, 0.12
    delta = np.full(len(t), VW_PASSAT.steer_ratio * r * (VW_PASSAT.wheelbase / v + VW_PASSAT.understeer_gradient * v))
    slip = (VW_PASSAT.l_r - VW_PASSAT.m * VW_PASSAT.l_f * v**2 / (VW_PASSAT.c_r * VW_PASSAT.wheelbase)) * r / v
    course = r * t + slip
    columns = {
        "t": t,
        "v": np.full(len(t), v),
        "r": np.full(len(t), r),
        "psi": r * t + 0.02,
        "delta_sw": delta,
        "x": v / r * np.sin(course),
        "y": -v / r * np.cos(course),
    }
    block = VehicleState.of(NonlinearSingleTrack(vehicle=VW_PASSAT), horizon=0.0, **laps.UNIT)
    ours, theirs = laps._foreseen(block, columns, 20.0)
    assert ours < 0.03
    assert theirs == pytest.approx(v * laps.AHEAD * abs(0.02 - slip), rel=0.1)
