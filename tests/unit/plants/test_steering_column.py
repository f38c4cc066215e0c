"""Friction and free play: the loops they leave have the width that they are said to have."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.plants.steering_column import SteeringColumn
from tests.support.stepped import run

angles = st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=40)
gaps = st.floats(0.0, 0.5)


def outputs(column: SteeringColumn, motor: list[float]) -> np.ndarray:
    """delta_sw and delta_sw_meas, a row a sample."""
    return np.array(run(column, [(angle,) for angle in motor])[0])


def width(front: np.ndarray, behind: np.ndarray, at: float) -> float:
    """How far apart a loop's two branches are at one height of `behind`, along `front`; the second round of it."""
    half = len(front) // 2
    front, behind = front[half:], behind[half:]
    rising = np.diff(behind, prepend=behind[0]) > 0.0
    falling = np.diff(behind, prepend=behind[0]) < 0.0
    up = np.interp(at, behind[rising], front[rising])
    down = np.interp(at, behind[falling][::-1], front[falling][::-1])
    return float(up - down)


@pytest.mark.parametrize("at", [-0.4, 0.0, 0.5])
def test_a_loop_is_as_wide_as_twice_the_friction_and_once_the_play(at: float) -> None:
    friction, play = 0.05, 0.08
    fall = np.linspace(1.0, -1.0, 401)
    there = np.concatenate((np.linspace(0.0, 1.0, 201), fall[1:], -fall[1:]))
    motor = np.concatenate((there, there[201:]))
    road, wheel = outputs(SteeringColumn(friction=friction, play=play), motor.tolist()).T
    second = motor[600:], road[600:], wheel[600:]
    turns = [np.concatenate([signal[:400][::-1][::-1], signal[400:801]]) for signal in second]
    motor, road, wheel = (np.concatenate((turn, turn)) for turn in turns)
    assert width(motor, wheel, at) == pytest.approx(2.0 * friction, abs=1e-12)
    assert width(wheel, road, at) == pytest.approx(play, abs=1e-12)
    assert width(motor, road, at) == pytest.approx(2.0 * friction + play, abs=1e-12)


def test_a_reversal_is_answered_after_the_gaps_and_in_the_same_sample() -> None:
    road, wheel = outputs(SteeringColumn(friction=0.1, play=0.2), [0.0, 1.0, 0.9, 0.81, 0.7, 0.61, 0.5]).T
    assert wheel == pytest.approx([0.0, 0.9, 0.9, 0.9, 0.8, 0.71, 0.6])
    assert road == pytest.approx([0.0, 0.8, 0.8, 0.8, 0.8, 0.8, 0.7])


@given(motor=angles, friction=gaps, play=gaps)
def test_nothing_leaves_its_gap_and_what_is_held_stays(motor: list[float], friction: float, play: float) -> None:
    column = SteeringColumn(friction=friction, play=play)
    road, wheel = outputs(column, motor).T
    assert (abs(wheel - motor) <= friction + 1e-12).all()
    assert (abs(road - wheel) <= 0.5 * play + 1e-12).all()
    twice = outputs(column, [angle for angle in motor for _ in range(3)])
    np.testing.assert_allclose(twice[::3], np.column_stack((road, wheel)), atol=1e-12)  # how fast does not matter
    np.testing.assert_allclose(twice[2::3], twice[::3], atol=1e-12)


@given(motor=angles, friction=gaps, play=gaps)
def test_left_and_right_are_the_same(motor: list[float], friction: float, play: float) -> None:
    column = SteeringColumn(friction=friction, play=play)
    np.testing.assert_array_equal(outputs(column, [-angle for angle in motor]), -outputs(column, motor))


@given(motor=angles)
def test_off_it_is_not_there(motor: list[float]) -> None:
    assert (outputs(SteeringColumn(), motor) == np.array(motor)[:, None]).all()


def test_a_sensors_zero_is_shown_and_moves_nothing() -> None:
    motor = [0.0, 1.0, 0.9, 0.5, 0.7]
    right, off = (outputs(SteeringColumn(friction=0.1, play=0.2, zero=zero), motor) for zero in (0.0, 0.05))
    assert (off[:, 0] == right[:, 0]).all()
    assert off[:, 1] == pytest.approx(right[:, 1] + 0.05, abs=1e-15)


def test_it_starts_in_the_middle_where_it_stands() -> None:
    road, wheel = outputs(SteeringColumn(friction=0.1, play=0.2), [0.7, 0.75, 0.65]).T
    assert (wheel.tolist(), road.tolist()) == ([0.7] * 3, [0.7] * 3)


@pytest.mark.parametrize(("field", "value"), [("friction", -0.1), ("play", 2.0), ("play", float("nan"))])
def test_parameters_out_of_range(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"SteeringColumn: {field} = {value} \[rad\], expected 0 to 1"):
        SteeringColumn(**{field: value})


def test_a_zero_that_no_sensor_has() -> None:
    with pytest.raises(ValueError, match=r"SteeringColumn: zero = 3.0 \[rad\], expected -1 to 1"):
        SteeringColumn(zero=3.0)
