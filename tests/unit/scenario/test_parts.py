"""What a scenario is made of, when its steering is worn and its sensors are poor."""

import contextlib
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.estimators.vehicle_state import VehicleState
from steerkit.paths.courses import straight
from steerkit.plants.sensors import Sensors
from steerkit.plants.steering_actuator import SteeringColumn, SteeringLink, TorqueSteering
from steerkit.scenario import Scenario
from steerkit.scenario.drive import assembled, controller, drive
from steerkit.scenario.parts import Course, Driver, drawn_course

PLAIN = Scenario()
COURSE = PLAIN.path()
STANLEY = controller("stanley", PLAIN)


def measured(scenario: Scenario) -> Any:
    return scenario.sensors.sensors(scenario.nominal, 3)


def test_what_is_not_there_is_left_out() -> None:
    left_out = {name for name, block in PLAIN.blocks(PLAIN.path()).items() if block is None}
    assert left_out == {"link", "column", "sensors", "estimator"}
    loop = assembled(PLAIN, controller("stanley", PLAIN))
    assert not left_out & set(loop.names)


def test_fields_become_blocks() -> None:
    worn = Scenario(
        steering={"play_deg": 2.0, "friction_deg": 1.0, "dead_band_deg": 0.5, "quantum_deg": 0.1, "delay_jitter": 0.03}
    )
    link, column = worn.steering.link(seed=7), worn.steering.column()
    assert isinstance(link, SteeringLink)
    assert isinstance(column, SteeringColumn)
    assert (link.quantum, link.dead_band) == (radians_of(0.1), radians_of(0.5))
    assert (link.jitter, link.seed) == (0.03, 7)
    assert (column.play, column.friction) == (radians_of(2.0), radians_of(1.0))
    assert worn.random
    assert not worn.with_(steering={"delay_jitter": 0.0}, driver={"v_min": 5.0, "v_max": 5.0}).random
    loop = assembled(worn, controller("stanley", worn))
    assert loop.inputs_of("link")["delta_sw_cmd"] == "controller.delta_sw"
    assert loop.inputs_of("actuator")["delta_sw_cmd"] == "link.delta_sw"
    assert loop.inputs_of("column")["delta_sw_in"] == "actuator.delta_sw"
    assert loop.inputs_of("car")["delta_sw_cmd"] == "column.delta_sw"
    assert loop.inputs_of("controller")["delta_sw_meas"] == "column.delta_sw_meas"


def test_real_sensors() -> None:
    real, hard = Scenario.under("real"), Scenario.under("hard")
    assert real.with_(sensors={"kind": "hard"}) == hard
    ordinary, sensors = measured(hard), measured(real)
    assert isinstance(ordinary, Sensors)
    assert (ordinary.age_jitter, ordinary.lost, ordinary.jump, ordinary.heading_drift, ordinary.rear) == (
        0,
        0,
        0,
        0,
        None,
    )
    assert isinstance(sensors, Sensors)
    assert (sensors.seed, sensors.latency, sensors.rear) == (3, 0.05, real.nominal.l_r)
    assert (sensors.age_jitter, sensors.lost, sensors.jump, sensors.heading_drift) == (
        0.02,
        0.01,
        0.02,
        radians_of(0.2),
    )
    twice = measured(real.with_(sensors={"noise": 2.0, "latency": 0.1}))
    assert isinstance(twice, Sensors)
    assert (twice.v_noise, twice.latency, twice.jump) == (0.1, 0.1, 0.04)
    assert real.with_(sensors={"noise": 0.0}, driver={"v_min": 5.0, "v_max": 5.0}).random


def test_an_estimator_is_given_the_data_sheet_and_stands_between_sensors_and_controllers() -> None:
    hard = Scenario.under(
        "hard", sensors={"kind": "no sideslip", "estimator": "vehicle-state", "noise": 2.0}, steering={"delay": 0.1}
    )
    block, sensors = hard.blocks(COURSE)["estimator"], measured(hard)
    assert isinstance(block, VehicleState)
    assert isinstance(sensors, Sensors)
    assert (block.position_drift, block.psi_drift, block.heading_drift) == (0.02, radians_of(0.2), 0.0)
    assert (block.horizon, sensors.rear, sensors.seed) == (pytest.approx(0.1), hard.nominal.l_r, 3)
    assert hard.design_model().delay == pytest.approx(0.1)
    assert hard.with_(sensors={"estimator": "none"}).design_model().delay == pytest.approx(0.15)
    assert hard.with_(sensors={"estimator": "none"}).blocks(COURSE)["estimator"] is None
    real = Scenario.under("real", sensors={"estimator": "vehicle-state"}).blocks(COURSE)["estimator"]
    assert isinstance(real, VehicleState)
    assert (real.heading_drift, real.v_noise) == (radians_of(0.2), 0.05)
    loop = assembled(hard, controller("mpc", hard), seed=3)
    assert loop.inputs_of("estimator")["age_in"] == loop.inputs_of("estimator")["motion_age_in"] == "sensors.age"
    assert loop.inputs_of("estimator")["delta_sw_meas"] == "actuator.delta_sw"
    assert loop.inputs_of("controller")["beta"] == "estimator.beta"
    assert loop.inputs_of("controller_path")["x"] == "estimator.x"
    clean = Scenario().with_(sensors={"estimator": "vehicle-state"})
    assert isinstance(measured(clean), Sensors)


def test_one_that_adapts_has_the_same_numbers_and_a_filter_of_the_steering() -> None:
    adapts = Scenario.under("real", sensors={"estimator": "adaptive-state", "noise": 2.0}, steering={"delay": 0.1})
    plain: Any = adapts.with_(sensors={"estimator": "vehicle-state"}).blocks(COURSE)["estimator"]
    block: Any = adapts.blocks(COURSE)["estimator"]
    for name in ("horizon", "steer_ratio", "position_drift", "r_noise", "heading_drift"):
        assert getattr(block, name) == getattr(plain, name)
    assert (block.steering.vehicle, plain.steering) == (adapts.nominal, None)
    assert adapts.design_model().delay == pytest.approx(0.1)


def test_sensors_report_their_zeros() -> None:
    off = Scenario.under("hard", steering={"wheel_zero_deg": 3.0}, sensors={"gyro_zero_deg": -0.2})
    column = off.steering.column()
    assert isinstance(column, SteeringColumn)
    assert (column.zero, column.play) == (radians_of(3.0), 0.0)
    assert off.with_(steering={"wheel_zero_deg": 0.0}).steering.column() is None
    for sensing, clean in (("hard", 0.0), ("no sideslip", 1.0), ("real", 1.0)):
        sensors: Any = measured(off.with_(sensors={"kind": sensing, "noise": clean, "latency": 0.0}))
        assert getattr(sensors, "block", sensors).r_bias == radians_of(-0.2)
    biased: Any = measured(Scenario(sensors={"bias": 0.1}))
    assert (biased.x_bias, biased.y_bias, biased.r_bias) == (0.1, 0.0, 0.0)
    loop = assembled(off, controller("mpc", off), seed=3)
    assert loop.inputs_of("controller")["delta_sw_meas"] == "column.delta_sw_meas"
    assert loop.inputs_of("car")["delta_sw_cmd"] == "column.delta_sw"


def test_controllers_believe_the_data_sheet_or_know_the_truth() -> None:
    heavy = Scenario(vehicle={"mass": 1.4})
    assert (heavy.vehicle.true.m, heavy.vehicle.true.i_z) == (1.4 * heavy.nominal.m, 1.4 * heavy.nominal.i_z)
    wrong = Scenario(vehicle={"tyres": 0.7, "ratio": 1.2, "friction": 0.8}, steering={"offset_deg": 2.0, "gain": 0.8})
    told = wrong.design_model()
    assert (told.vehicle, told.offset, told.gain) == (wrong.nominal, 0.0, 1.0)
    truth = wrong.with_(knowledge={"oracle": True}).design_model()
    assert (truth.vehicle, truth.offset, truth.gain) == (wrong.vehicle.true, radians_of(2.0), 1.0)
    assert (truth.delay, truth.lag, truth.slew, truth.a_y_limit) == (told.delay, told.lag, None, None)


def test_steering_by_torque() -> None:
    """The gain acts on what is asked for, so who is told of it knows that slew and limit come out of it too."""
    lag = {"delay": 0.35, "lag": 0.0, "offset_deg": 1.0}
    scenario = Scenario(steering={"command": "torque", "gain": 0.8, "slew": 4.0, "a_y_limit": 2.5, **lag})
    motor = scenario.steering.actuator(scenario.nominal)
    assert isinstance(motor, TorqueSteering)
    assert (motor.delay, motor.lag, motor.slew, motor.a_y_limit, motor.gain) == (0.35, 0.0, 4.0, 2.5, 0.8)
    assert (motor.steer_ratio, motor.offset) == (scenario.nominal.steer_ratio, radians_of(1.0))
    told, truth = scenario.design_model(), scenario.with_(knowledge={"oracle": True}).design_model()
    assert (told.slew, told.a_y_limit, told.gain) == (4.0, 2.5, 1.0)
    assert (truth.slew, truth.a_y_limit, truth.gain) == (pytest.approx(3.2), 2.0, 0.8)
    loop = assembled(scenario, controller("stanley-delay", scenario))
    assert loop.inputs_of("actuator") == {"delta_sw_cmd": "controller.delta_sw", "v": "car.v"}


def test_sweeping_courses_have_bends_of_100_m_and_more() -> None:
    path = Scenario(course="sweeping-7").path()
    assert abs(path.samples.kappa).max() == pytest.approx(0.01, rel=0.05)
    assert abs(path.samples.kappa).max() < 0.01
    assert path.length == pytest.approx(2000.0)
    assert path.name == "sweeping-7"
    assert drawn_course("random-7") == (7, 500.0, 0.1)
    assert drawn_course("sweeping-x") is None


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (((0.0, 5.0), (100.99, 6.0)), ""),
        (((0.0, 5.0), (101.01, 6.0)), "s to 101.01 m, on a course of 100.0 m"),
        (((-0.01, 5.0), (100.0, 6.0)), "expected s from 0 to"),
        (((0.0, 4.99), (100.0, 6.0)), "4.99 to 6 m/s, expected v_min to v_max, 5 to 6"),
        (((0.0, 5.0), (100.0, 6.01)), "5 to 6.01 m/s, expected v_min to v_max"),
    ],
)
def test_a_files_speed_keeps_within_the_course_and_the_drivers_speeds(rows: Any, says: str) -> None:
    text = "\n".join(["s,v", *(f"{s},{v}" for s, v in rows)])
    driver, on = Driver(speed="a.csv", v_min=5.0, v_max=6.0, text=text), (Course(name="straight"), straight(100.0))
    with contextlib.nullcontext() if not says else pytest.raises(ValueError, match=says):
        s, v = driver.profile(*on)
        assert (s, v) == (pytest.approx(np.arange(101.0)), pytest.approx(5.0 + s / 100.99))


def test_a_maps_limit_holds_from_where_it_stands_and_is_braked_for() -> None:
    """10 m/s at first, none from 40 m on, 12 m/s in the last metre: v^2 changes by 3 m^2/s^2 a metre."""
    rows = [f"{s},0,{s},{v}" for s, v in ((0, 10), (40, "nan"), (98.5, 12), (100, 5))]
    map_ = Course(name="a.csv", text="\n".join(["x,y,s,v_limit", *rows]))
    s, v = Driver(speed="limit", v_min=4.0, v_max=20.0).profile(map_, straight(100.0))
    exact = np.sqrt(np.minimum(100.0 + 3.0 * np.maximum(s - 39.0, 0.0), 144.0 + 3.0 * (99.0 - s)))
    assert (s, v) == (pytest.approx(np.arange(101.0)), pytest.approx(np.append(exact[:-1], 12.0)))


def test_the_driver_slows_down_to_a_y_max() -> None:
    log = drive(
        Scenario(course={"name": "circle", "rounds": 0.1}, driver={"v_min": 20.0, "v_max": 20.0, "a_y_max": 1.5}),
        STANLEY,
    )
    assert log["driver.v"] == pytest.approx(np.full(len(log.t), np.sqrt(1.5 * 30.0)), rel=0.01)
