"""Steering by torque: dead time, slew, limit and gain of the lateral acceleration are exact."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.torque_steering import TorqueSteering
from steerkit.vehicles import VW_PASSAT
from tests.support.stepped import run

FREE = dict(slew=1e4, a_y_limit=1e3, rate_limit=200.0, limit=30.0)


def wheel_of(a_y: float, v: float) -> float:
    """The Passat's steering-wheel angle in a steady bend."""
    p = VW_PASSAT
    return p.steer_ratio * math.atan((p.wheelbase / v**2 + p.understeer_gradient) * a_y)


def accelerations(block: TorqueSteering, angles: np.ndarray, v: float) -> np.ndarray:
    """What lateral acceleration these angles are in steady bends."""
    per_a = block.wheelbase / v**2 + block.understeer
    return np.tan(angles / block.steer_ratio) / per_a


@pytest.mark.parametrize(("v", "side"), [(8.0, 1.0), (16.0, -1.0), (25.0, 1.0)])
def test_a_step_is_answered_after_the_dead_time_with_the_slew_up_to_the_limit_times_the_gain(
    v: float, side: float
) -> None:
    block = TorqueSteering.of(VW_PASSAT, gain=0.8)
    ys, x = run(block, [(wheel_of(9.0 * side, v), v)] * 150)
    t = block.dt * np.arange(150)
    ramp = np.clip(5.0 * (t - 0.35), 0.0, 3.0)
    found = accelerations(block, np.array([y.delta_sw for y in ys]), v)
    assert found == pytest.approx(0.8 * side * ramp, abs=1e-9)
    assert len(x) == 3 + 35


@pytest.mark.parametrize("a_y", [1.0, -2.5])
def test_a_car_gets_the_acceleration_that_was_asked_for(a_y: float) -> None:
    """Through the single track in a steady bend: what the angle stands for is what the car does with it."""
    v = 15.0
    block = TorqueSteering.of(VW_PASSAT, delay=0.1)
    ys, _ = run(block, [(wheel_of(a_y, v), v)] * 200)
    car = LinearSingleTrack(vehicle=VW_PASSAT, v0=v)
    motion, _ = run(car, [(ys[-1].delta_sw, v)] * 400)
    assert motion[-1].a_y == pytest.approx(a_y, rel=0.01)  # the tangent of 2 degrees is no angle


def test_a_command_within_all_bounds_arrives_as_it_was_given() -> None:
    block = TorqueSteering.of(VW_PASSAT, delay=0.2, **FREE)
    given = np.cumsum(np.random.default_rng(0).normal(0.0, 0.001, 200))
    ys, _ = run(block, [(command, 15.0) for command in given.tolist()])
    n = 20 + 1  # a command acts from its sample to the next
    assert [y.delta_sw for y in ys] == pytest.approx([0.0] * n + given[:-n].tolist(), abs=1e-9)


def test_a_lag_is_exact() -> None:
    block = TorqueSteering.of(VW_PASSAT, delay=0.0, lag=0.2, **FREE)
    ys, _ = run(block, [(wheel_of(0.5, 12.0), 12.0)] * 60)
    exact = 0.5 * (1.0 - np.exp(-block.dt * np.arange(60) / 0.2))
    assert accelerations(block, np.array([y.delta_sw for y in ys]), 12.0) == pytest.approx(exact, abs=1e-9)


def test_offset_and_wheel_limits() -> None:
    ys, _ = run(TorqueSteering.of(VW_PASSAT, offset=0.1, rate_limit=2.0), [(0.0, 12.0)] * 60)
    assert ys[-1].delta_sw == pytest.approx(0.1)
    assert max(y.rate for y in ys) == pytest.approx(2.0)
    ys, _ = run(TorqueSteering.of(VW_PASSAT, limit=1.0), [(9.0, 4.0)] * 100)
    assert ys[-1].delta_sw == pytest.approx(1.0)


@given(commands=st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=40), v=st.floats(-2.0, 40.0))
def test_slew_and_limit_hold_for_every_command(commands: list[float], v: float) -> None:
    block = TorqueSteering.of(VW_PASSAT, delay=0.02, slew=4.0, a_y_limit=2.0)
    x = block.init()
    for command in commands:
        before = x[2]
        x = block.update(0.0, x, block.U(command, v), block.output(0.0, x, ()))
        assert abs(x[2]) <= 2.0
        assert abs(x[2] - before) <= 4.0 * block.dt * (1.0 + 1e-9)
        assert abs(x[0]) <= block.limit
        assert math.isfinite(x[0])


def test_a_car_that_holds_an_angle_goes_on_holding_it() -> None:
    block = TorqueSteering.of(VW_PASSAT)
    angle, v = wheel_of(2.0, 12.0), 12.0
    ys, x = run(block, [(angle, v)] * 50, x=block.holding(angle, v))
    assert [y.delta_sw for y in ys] == pytest.approx([angle] * 50)
    assert len(x) == len(block.init())


@pytest.mark.parametrize(
    ("field", "value"), [("slew", 0.0), ("a_y_limit", -3.0), ("gain", 0.0), ("delay", 0.355), ("lag", -1.0)]
)
def test_parameters_out_of_range(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"TorqueSteering: {field} = {value}"):
        TorqueSteering(**{field: value})
