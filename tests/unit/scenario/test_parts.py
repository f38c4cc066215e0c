"""What a scenario is made of, when its steering is worn and its sensors are poor."""

import contextlib
import math
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.paths.courses import straight
from steerkit.scenario import Scenario
from steerkit.scenario.drive import assembled, controller, drive
from steerkit.scenario.parts import Course, Driver, drawn_course
from steerkit.vehicles import VW_PASSAT as PASSAT
from steerkit.vehicles import G

PLAIN = Scenario()
COURSE = PLAIN.path()
STANLEY = controller("stanley", PLAIN)


WORN = Scenario(
    steering={"play_deg": 2.0, "friction_deg": 1.0, "dead_band_deg": 0.5, "quantum_deg": 0.1, "delay_jitter": 0.03}
)
OFF = Scenario.under("hard", steering={"wheel_zero_deg": 3.0}, sensors={"gyro_zero_deg": -0.2})
REAL = Scenario.under("real")
NO_SIDESLIP = Scenario.under(
    "hard", sensors={"kind": "no sideslip", "estimator": "vehicle-state", "noise": 2.0}, steering={"delay": 0.1}
)
ESTIMATED = Scenario.under("real", sensors={"estimator": "vehicle-state"})
ADAPTS = Scenario.under("real", sensors={"estimator": "adaptive-state", "noise": 2.0}, steering={"delay": 0.1})
TORQUE = Scenario(
    steering={
        "command": "torque",
        "gain": 0.8,
        "slew": 4.0,
        "a_y_limit": 2.5,
        "delay": 0.35,
        "lag": 0.0,
        "offset_deg": 1,
    }
)
PUSHED = Scenario(disturbances={"bank_deg": 2.0, "wind": 0.3, "gust": 0.1})
RIGHT = {"age_jitter": 0.0, "lost": 0.0, "jump": 0.0, "heading_drift": 0.0, "rear": None}
POOR = {"age_jitter": 0.02, "lost": 0.01, "jump": 0.02, "heading_drift": radians_of(0.2), "rear": PASSAT.l_r}
ZERO = {"r_bias": radians_of(-0.2)}


@pytest.mark.parametrize(
    ("scenario", "name", "numbers"),
    [
        (WORN, "link", {"quantum": radians_of(0.1), "dead_band": radians_of(0.5), "jitter": 0.03, "seed": 3}),
        (WORN, "column", {"play": radians_of(2.0), "friction": radians_of(1.0)}),
        (OFF, "column", {"zero": radians_of(3.0), "play": 0.0}),
        (OFF, "sensors", ZERO | RIGHT),
        (OFF.with_(sensors={"kind": "no sideslip", "noise": 1.0, "latency": 0.0}), "sensors", ZERO),
        (OFF.with_(sensors={"kind": "real", "noise": 1.0, "latency": 0.0}), "sensors", ZERO),
        (Scenario(sensors={"bias": 0.1}), "sensors", {"x_bias": 0.1, "y_bias": 0.0, "r_bias": 0.0}),
        (REAL, "sensors", POOR | {"seed": 3, "latency": 0.05}),
        (REAL.with_(sensors={"noise": 2.0, "latency": 0.1}), "sensors", {"v_noise": 0.1, "latency": 0.1, "jump": 0.04}),
        (NO_SIDESLIP, "sensors", {"rear": PASSAT.l_r, "seed": 3}),
        (NO_SIDESLIP, "estimator", {"position_drift": 0.02, "psi_drift": radians_of(0.2), "heading_drift": 0.0}),
        (NO_SIDESLIP, "estimator", {"horizon": 0.1, "steering": None}),
        (ESTIMATED, "estimator", {"heading_drift": radians_of(0.2), "v_noise": 0.05}),
        (TORQUE, "actuator", {"delay": 0.35, "lag": 0.0, "slew": 4.0, "a_y_limit": 2.5, "gain": 0.8}),
        (TORQUE, "actuator", {"steer_ratio": PASSAT.steer_ratio, "offset": radians_of(1.0)}),
        (PUSHED, "car", {"bank": G * math.sin(radians_of(2.0)), "wind": 0.3, "gust": 0.1, "seed": 3}),
    ],
)
def test_fields_become_blocks(scenario: Scenario, name: str, numbers: dict[str, Any]) -> None:
    block = scenario.blocks(COURSE, seed=3)[name]
    assert {number: getattr(block, number) for number in numbers} == pytest.approx(numbers)


@pytest.mark.parametrize(
    ("scenario", "name", "wires"),
    [
        (WORN, "stanley", {"link.delta_sw_cmd": "controller.delta_sw", "actuator.delta_sw_cmd": "link.delta_sw"}),
        (WORN, "stanley", {"column.delta_sw_in": "actuator.delta_sw", "car.delta_sw_cmd": "column.delta_sw"}),
        (OFF, "mpc", {"controller.delta_sw_meas": "column.delta_sw_meas"}),
        (NO_SIDESLIP, "mpc", {"estimator.age_in": "sensors.age", "estimator.motion_age_in": "sensors.age"}),
        (NO_SIDESLIP, "mpc", {"estimator.delta_sw_meas": "actuator.delta_sw", "controller_path.x": "estimator.x"}),
        (NO_SIDESLIP, "mpc", {"controller.beta": "estimator.beta"}),
        (TORQUE, "stanley-delay", {"actuator.delta_sw_cmd": "controller.delta_sw", "actuator.v": "car.v"}),
    ],
)
def test_blocks_stand_where_they_belong(scenario: Scenario, name: str, wires: dict[str, str]) -> None:
    loop = assembled(scenario, controller(name, scenario), seed=3)
    for end, signal in wires.items():
        block, _, port = end.partition(".")
        assert loop.inputs_of(block)[port] == signal


def test_an_estimator_takes_the_age_of_what_is_measured_off_the_delay() -> None:
    assert NO_SIDESLIP.design_model().delay == ADAPTS.design_model().delay == pytest.approx(0.1)
    assert NO_SIDESLIP.with_(sensors={"estimator": "none"}).design_model().delay == pytest.approx(0.15)
    assert Scenario(sensors={"estimator": "vehicle-state"}).blocks(COURSE)["sensors"] is not None


def test_one_that_adapts_has_the_same_numbers_and_a_filter_of_the_steering() -> None:
    plain: Any = ADAPTS.with_(sensors={"estimator": "vehicle-state"}).blocks(COURSE)["estimator"]
    block: Any = ADAPTS.blocks(COURSE)["estimator"]
    for name in ("horizon", "steer_ratio", "position_drift", "r_noise", "heading_drift"):
        assert getattr(block, name) == getattr(plain, name)
    assert block.steering.vehicle == PASSAT


def test_controllers_believe_the_data_sheet_or_know_the_truth() -> None:
    heavy = Scenario(vehicle={"mass": 1.4})
    assert (heavy.vehicle.true.m, heavy.vehicle.true.i_z) == (1.4 * heavy.nominal.m, 1.4 * heavy.nominal.i_z)
    wrong = Scenario(vehicle={"tyres": 0.7, "ratio": 1.2, "friction": 0.8}, steering={"offset_deg": 2.0, "gain": 0.8})
    told = wrong.design_model()
    assert (told.vehicle, told.offset, told.gain) == (wrong.nominal, 0.0, 1.0)
    truth = wrong.with_(knowledge={"oracle": True}).design_model()
    assert (truth.vehicle, truth.offset, truth.gain) == (wrong.vehicle.true, radians_of(2.0), 1.0)
    assert (truth.delay, truth.lag, truth.slew, truth.a_y_limit) == (told.delay, told.lag, None, None)


def test_who_is_told_of_the_gain_of_torque_knows_that_slew_and_limit_come_out_of_it_too() -> None:
    told, truth = TORQUE.design_model(), TORQUE.with_(knowledge={"oracle": True}).design_model()
    assert (told.slew, told.a_y_limit, told.gain) == (4.0, 2.5, 1.0)
    assert (truth.slew, truth.a_y_limit, truth.gain) == (pytest.approx(3.2), 2.0, 0.8)


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
