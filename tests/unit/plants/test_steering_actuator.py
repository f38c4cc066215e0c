"""The steering: lag, delay, rate limit and stops are exact; a link's quanta and delays; the loops of a worn column."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.diagram.units import radians_of
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.steering_actuator import (
    SteeringActuator,
    SteeringColumn,
    SteeringLink,
    TorqueSteering,
    steering_of,
)
from steerkit.vehicles import VW_PASSAT, vehicle_text
from tests.support.stepped import run


def test_first_order_lag_is_exact():
    actuator = SteeringActuator(lag=0.13, rate_limit=200.0)
    ys, _ = run(actuator, [(1.0,)] * 60)
    exact = 1.0 - np.exp(-np.arange(60) * actuator.dt / 0.13)
    assert [y.delta_sw for y in ys] == pytest.approx(exact, abs=1e-14)
    assert ys[-1].rate == pytest.approx((exact[-1] - exact[-2]) / actuator.dt, rel=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.13])
def test_delay_is_exact(delay):
    commands = np.random.default_rng(0).normal(0.0, 0.3, 50).tolist()
    ys, x = run(SteeringActuator(lag=0.0, delay=delay, rate_limit=200.0), [(c,) for c in commands])
    n = round(delay / 0.01) + 1  # one sample more: a command acts from its sample to the next
    assert [y.delta_sw for y in ys] == pytest.approx([0.0] * n + commands[: 50 - n], abs=1e-12)
    assert len(x) == 2 + n - 1


def test_rate_limit_and_stops_are_exact():
    actuator = SteeringActuator(lag=0.0)
    ys, _ = run(actuator, [(99.0,)] * 120)
    turned, _ = run(SteeringActuator(offset=0.3, gain=1.2), [(-99.0,)] * 300)
    assert turned[-1].delta_sw == pytest.approx(radians_of(-520.0), rel=1e-9)
    ramp = np.minimum(radians_of(550.0) * 0.01 * np.arange(120), radians_of(520.0))
    assert [y.delta_sw for y in ys] == pytest.approx(ramp, rel=1e-12)
    assert max(y.rate for y in ys) == pytest.approx(radians_of(550.0), rel=1e-12)


@given(commands=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60), lag=st.floats(0.0, 1.0))
def test_limits_hold_for_every_command(commands, lag):
    ys, _ = run(SteeringActuator(lag=lag, delay=0.02, gain=1.2, offset=-0.3), [(c,) for c in commands])
    assert all(abs(y.delta_sw) <= radians_of(520.0) * (1.0 + 1e-12) for y in ys)
    assert all(abs(y.rate) <= radians_of(550.0) * (1.0 + 1e-12) for y in ys)


@pytest.mark.parametrize(
    ("kind", "field", "value", "message"),
    [
        (SteeringActuator, "delay", np.array([0.01, 0.02]), "delay .* expected one number for all cars"),
        (TorqueSteering, "delay", 0.355, "delay = 0.355"),
        (SteeringLink, "jitter", 0.015, "jitter .*multiple of dt"),
    ],
)
def test_teaching_errors(kind: Any, field: str, value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"{kind.__name__}: {message}"):
        kind(**{field: value})
    with pytest.raises(ValueError, match="seed = -1"):
        SteeringLink(seed=-1)


@pytest.mark.parametrize(
    ("delay", "lag", "samples", "rest"),
    [
        (0.037, 0.08, 2, 0.087),
        (0.06, 0.1, 5, 0.1),
        (0.0, 0.1, 0, 0.09),
        (0.004, 0.1, 0, 0.094),
        (0.0, 0.005, 0, 0.0),
        (-0.1, 0.05, 0, 0.0),
    ],
)
def test_a_files_delay_and_lag_keep_their_sum_less_a_sample(
    delay: float, lag: float, samples: int, rest: float, tmp_path: Path
) -> None:
    """Holding the angle for dt delays by dt/2, in the motor and in the car: 10 ms less for the motor."""
    file = tmp_path / "car.toml"
    file.write_text(f"{vehicle_text(VW_PASSAT)}\n[steering]\ndelay = {delay}\nlag = {lag}\noffset = 0.02\n")
    motor = steering_of(file)
    assert motor.delay == pytest.approx(0.01 * samples)
    assert motor.lag == pytest.approx(rest)
    assert motor.offset == 0.02


commands = st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=50)


def sent(link: SteeringLink, given: list[float]) -> np.ndarray:
    return np.array([y.delta_sw for y in run(link, [(command,) for command in given])[0]])


@given(given=commands, quantum=st.sampled_from([0.001, 0.1, 0.7]))
def test_a_command_is_rounded_to_the_nearest_quantum(given: list[float], quantum: float) -> None:
    out = sent(SteeringLink(quantum=quantum), given)
    assert (abs(out - given) <= 0.5 * quantum * (1.0 + 1e-9)).all()
    np.testing.assert_allclose(out / quantum, np.round(out / quantum), atol=1e-6)


@given(given=commands, dead_band=st.floats(0.0, 0.9))
def test_what_is_kept_is_within_the_dead_band_and_what_is_new_is_the_command(given, dead_band) -> None:
    out = sent(SteeringLink(dead_band=dead_band), given)
    assert (abs(out - given) <= dead_band).all()
    changed = np.flatnonzero(np.diff(out)) + 1
    assert (out[changed] == np.array(given)[changed]).all()
    assert (abs(np.diff(out))[changed - 1] > dead_band).all()


@pytest.mark.parametrize("block", [SteeringLink(), SteeringColumn()])
@given(given=commands)
def test_off_it_is_not_there(block: SteeringLink | SteeringColumn, given: list[float]) -> None:
    assert [set(y) for y in run(block, [(command,) for command in given])[0]] == [{command} for command in given]


def arrivals(link: SteeringLink, count: int) -> np.ndarray:
    """How many samples after it was given each of `count` commands arrives: command k is k, given for 50 ms."""
    hold = 5
    out = sent(link, np.repeat(np.arange(count, dtype=float), hold).tolist())
    assert (np.diff(out) >= 0.0).all(), "a command overtook another"
    return np.array([np.argmax(out >= k) - k * hold for k in range(1, count - 10)])


def test_each_command_takes_a_time_of_its_own() -> None:
    """Uniform over 0 to 4 samples where that is less than the time between commands."""
    found = np.bincount(arrivals(SteeringLink(jitter=0.04, seed=5), 2000), minlength=5)
    assert len(found) == 5
    assert found == pytest.approx([398] * 5, abs=4.0 * np.sqrt(400))


def test_none_is_overtaken_where_the_jitter_is_longer_than_the_time_between_commands() -> None:
    late = arrivals(SteeringLink(jitter=0.1, seed=5), 1000)
    assert late.min() == 0
    assert 5 < late.max() <= 10  # later than the next command was given


angles = st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=40)
gaps = st.floats(0.0, 0.5)


def outputs(column: SteeringColumn, motor: list[float]) -> np.ndarray:
    """delta_sw and delta_sw_meas, a row a sample."""
    return np.array(run(column, [(angle,) for angle in motor])[0])


def test_a_loop_is_as_wide_as_twice_the_friction_and_once_the_play() -> None:
    friction, play = 0.05, 0.08
    fall = np.linspace(1.0, -1.0, 401)
    motor = np.concatenate((-fall, fall[1:], -fall[1:], fall[1:]))
    road, wheel = outputs(SteeringColumn(friction=friction, play=play), motor.tolist()).T
    for front, behind, width in ((motor, wheel, 2 * friction), (wheel, road, play), (motor, road, 2 * friction + play)):
        rising, falling = (
            np.interp([-0.4, 0.0, 0.5], behind[part][::side], front[part][::side])
            for part, side in ((slice(900, 1200), 1), (slice(1300, 1600), -1))
        )
        assert rising - falling == pytest.approx([width] * 3, abs=1e-12)


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


def test_a_sensors_zero_is_shown_and_moves_nothing() -> None:
    motor = [0.0, 1.0, 0.9, 0.5, 0.7]
    right, off = (outputs(SteeringColumn(friction=0.1, play=0.2, zero=zero), motor) for zero in (0.0, 0.05))
    assert (off[:, 0] == right[:, 0]).all()
    assert off[:, 1] == pytest.approx(right[:, 1] + 0.05, abs=1e-15)


def test_it_starts_in_the_middle_where_it_stands() -> None:
    road, wheel = outputs(SteeringColumn(friction=0.1, play=0.2), [0.7, 0.75, 0.65]).T
    assert (wheel.tolist(), road.tolist()) == ([0.7] * 3, [0.7] * 3)


# ---- by torque

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
