"""A drive: held, caught, or lost; and those of learned policies, compiled."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import steerkit
from steerkit.compiled import TraceError
from steerkit.diagram.simulation import Log
from steerkit.learning.learner_state import untrained
from steerkit.learning.settings import DEFAULT
from steerkit.metrics import measures_of_log
from steerkit.plants.speed_driver import ConstantSpeed, SpeedDriver
from steerkit.scenario import Scenario
from steerkit.scenario.drive import SignCheck, comparison, controller, drive, drive_loop, held_all_along, row_of, sweep


def log_of(e: Any, learning: Any = None) -> Log:
    signals = {"path.e": np.array(e, dtype=float)}
    if learning is not None:
        signals["supervisor.learning"] = np.array(learning, dtype=float)
    return Log(0.05 * np.arange(len(e)), signals, dict.fromkeys(signals, "1"))


@pytest.mark.parametrize(
    ("e", "learning", "held"),
    [
        ([0.1, -0.5, 0.5], None, True),
        ([0.1, -0.51, 0.1], None, False),
        ([0.1, math.nan, 0.1], None, False),
        ([0.1, 0.1, 0.1], [1, 1, 1], True),
        ([0.1, 0.1, 0.1], [1, 0, 1], False),
        ([0.1, 0.1, 0.1], [0, 1, 1], False),
        ([0.1, 0.1, 0.1], [1, 1, 0], False),
        ([0.1, 0.6, 0.1], [1, 1, 1], False),
        ([0.1, math.nan, 0.1], [1, 1, 1], False),
    ],
)
def test_a_drive_is_held_by_who_kept_the_lane_and_the_wheel(e: list[float], learning: Any, held: bool) -> None:
    assert held_all_along(log_of(e, learning)) is held


def test_a_learned_controller_is_caught_where_an_analytic_one_is_alone() -> None:
    scenario = Scenario(course="circle")
    assert "recovery" in drive_loop(scenario, untrained(DEFAULT, 0), doe=DEFAULT.element(scenario.nominal)).blocks
    assert "recovery" not in drive_loop(scenario, controller("stanley", scenario)).blocks
    log = drive(scenario, untrained(DEFAULT, 0), doe=DEFAULT.element(scenario.nominal))
    assert not held_all_along(log)
    assert log["supervisor.learning"].min() == 0.0


def test_the_table_says_of_each_drive_what_its_figures_are() -> None:
    scenario = Scenario(course="circle")
    logs = {"stanley": drive(scenario, controller("stanley", scenario), rounds=0.2)}
    row = row_of("stanley", logs["stanley"])
    (name,), (held,), *figures = (list(column.cells) for column in comparison("one", logs).columns)
    assert (name, held, row["controller"], row["held"]) == ("stanley", "yes", "stanley", True)
    expected = [row[key] for key in ("rms_e", "max_e", "rms_wheel_rate_deg", "max_a_y")]
    expected += [100.0 * row["share_within_5cm"], row["max_jerk"]]
    digits = (3, 3, 0, 2, 1, 1)
    *figures, iso, r79 = figures
    assert [cell for (cell,) in figures] == [f"{value:.{n}f}" for value, n in zip(expected, digits, strict=True)]
    assert (*iso, *r79) == ("kept", "kept")
    assert row["iso_11270"]
    assert row["un_r79"]
    log = logs["stanley"]
    beyond = {"path.e": np.full(len(log.t), 0.6), "car.a_y": np.full(len(log.t), 3.1)}
    lost = Log(log.t, log.signals | beyond, log.units)
    assert [next(iter(column.cells)) for column in comparison("lost", {"a": lost}).columns][1] == "no"
    row = row_of("lost", lost)
    assert not row["iso_11270"]
    assert not row["un_r79"]


@pytest.mark.parametrize(
    ("plant", "said"), [("TurnsRight", "the car turns against its wheel"), ("YawsRight", "the yaw rate goes")]
)
@pytest.mark.parametrize(("name", "course", "v"), [("stanley", "genesis", 8.0), ("lqr-adaptive", "sweeping-7", 15.0)])
def test_a_plant_that_turns_the_other_way_is_stopped(plant: str, said: str, name: str, course: str, v: float) -> None:
    """At once: within 2 s and 1 m."""
    vehicle = {"plant": f"tests.support.wrong_signs:{plant}"}
    scenario = Scenario(course=course, vehicle=vehicle, driver={"v_min": v, "v_max": v}, steering={"delay": 0.2})
    e: list[float] = []
    with pytest.raises(ValueError, match=rf"steered the wrong way round.*{said}.*check the sign"):
        drive(scenario, controller(name, scenario), each=lambda sample: e.append(abs(sample["path.e"])))
    assert max(e) < 0.5
    assert len(e) < 2.0 / 0.05


@pytest.mark.parametrize("told", [None, 0.0])
def test_a_car_that_swings_is_not_taken_for_one_that_turns_the_other_way(told: float | None) -> None:
    """Under torque, 0.5 s late, a gain of up to 2.3, pushed about."""
    car, steering = {"plant": "benchmarks.plants.torque_car:TorqueCar"}, {"command": "torque", "delay": 0.5}
    steady, knowledge = {"v_min": 12.0, "v_max": 12.0}, {"delay": told}
    scenario = Scenario(course="sweeping-7", vehicle=car, steering=steering, driver=steady, knowledge=knowledge)
    log = drive(scenario, controller("stanley", scenario), seed=3, rounds=0.1)
    assert abs(log["path.e"]).max() > 2.0


@pytest.mark.parametrize("begins", [0.0, 17.0])
def test_where_a_run_goes_on_the_answer_to_commands_from_before_is_no_wrong_sign(begins: float) -> None:
    """The wheel still turns left under commands that nobody has seen, while the new ones ask for the right."""
    scenario = Scenario(course="circle")
    check = SignCheck(scenario, drive_loop(scenario, controller("stanley", scenario)), 0.05)

    class Now(dict[str, float]):
        t = 0.0

        def __missing__(self, name: str) -> float:
            return self["wheel"] if "actuator" in name else self["command"]

    def drive_on() -> None:
        for k in range(30):
            wheel = 2.0 * math.sin(0.2 * k)
            now = Now(command=-wheel - 0.1, wheel=wheel, **{"car.v": 6.0, "car.r": 0.1 * wheel, "car.psi": 0.0})
            now.t = begins + 0.05 * k
            check.look(now)  # type: ignore[arg-type]

    if begins:
        drive_on()
    else:
        with pytest.raises(ValueError, match="steered the wrong way round"):
            drive_on()


PASSAT, PATH = steerkit.vehicle("vw-passat"), steerkit.course("circle")


def loop_of(**gains: float) -> steerkit.Loop:
    return steerkit.steering_loop(
        car=steerkit.placed(steerkit.NonlinearSingleTrack(vehicle=PASSAT, v0=5.0), PATH, e=0.3),
        path=PATH,
        driver=ConstantSpeed(speed=5.0),
        actuator=steerkit.SteeringActuator(),
        controller=replace(steerkit.Stanley.of(PASSAT), **gains),
        reference=PASSAT.l_f,
    )


METRICS = ("p95_e", "rms_wheel_rate_deg")


def test_every_combination_is_the_drive_of_a_loop_of_its_own() -> None:
    values = {"controller.k": [0.5, 1.0, 4.0], "controller.k_d_yaw": [0.0, 0.3]}
    found = sweep(loop_of(), values, 3.0, METRICS)
    assert [*found.columns] == [*values, *METRICS]
    for drawn in zip(*found.columns.values(), strict=True):
        row = dict(zip(found.columns, map(float, drawn), strict=True))
        gains = {name.split(".")[1]: row[name] for name in values}
        log = steerkit.simulate(loop_of(**gains), 3.0, every=5)
        assert [row[name] for name in METRICS] == pytest.approx([measures_of_log(log)[name] for name in METRICS])
    assert found.best("p95_e")["p95_e"] == found["p95_e"].min()
    assert len(found.plot().axes) == 4  # two maps and their scales


def test_a_car_that_is_lost_has_gaps_and_is_never_the_best() -> None:
    found = sweep(loop_of(), {"controller.k": np.geomspace(1.0, 4.0, 5)}, 1.0, ["rms_e"])
    panel = found.plot().axes[0]
    assert (panel.get_xscale(), panel.get_ylabel()) == ("log", "rms_e [m]")
    columns = found.columns | {"rms_e": np.array([np.nan, 0.2, np.nan, 0.1, 0.3])}
    assert replace(found, columns=columns).best("rms_e")["controller.k"] == found["controller.k"][3]
    with pytest.raises(ValueError, match="rms_e is NaN for all 5 drives"):
        replace(found, columns=columns | {"rms_e": np.full(5, np.nan)}).best("rms_e")


def test_a_drive_is_over_when_it_has_gone_the_distance() -> None:
    whole = steerkit.simulate(loop_of(), 10.0, every=5)
    there = int((whole["path.progress"] >= 20.0).argmax())
    found = sweep(loop_of(), {"controller.k": [2.5, 3.0]}, 10.0, METRICS, distance=20.0)
    part = Log(whole.t[: there + 1], {name: values[: there + 1] for name, values in whole.items()}, whole.units)
    for name in METRICS:
        assert found[name][0] == pytest.approx(measures_of_log(part)[name])
        assert found[name][0] != pytest.approx(measures_of_log(whole)[name], rel=1e-3)


@pytest.mark.parametrize(
    ("values", "metrics", "says"),
    [
        ({}, ["rms_e"], "no parameters"),
        ({"controller.k": [1.0, np.nan]}, ["rms_e"], r"expected finite numbers \(n,\)"),
        ({"controller.k": [1.0]}, [], "no metrics"),
        ({"controller.k": [1.0]}, ["rms_f"], "metric 'rms_f' is not known"),
    ],
)
def test_what_cannot_be_swept_is_refused(values: Any, metrics: Any, says: str) -> None:
    with pytest.raises((ValueError, TraceError), match=says):
        sweep(loop_of(), values, 1.0, metrics)


def test_a_parameter_of_the_start_alone_is_swept_too() -> None:
    loop = loop_of()
    found = sweep(loop, {"car.v0": [4.0, 6.0]}, 1.0, ["rms_e"])
    for v0, rms_e in zip(found["car.v0"].tolist(), found["rms_e"]):
        car = replace(loop.blocks["car"], v0=v0)  # type: ignore[call-arg]
        log = steerkit.simulate(loop.with_block("car", car), 1.0, every=5)
        assert rms_e == pytest.approx(measures_of_log(log)["rms_e"])
    assert np.ptp(found["rms_e"]) > 1e-4


def test_three_parameters_have_a_table_and_no_picture() -> None:
    values = {f"controller.{name}": [0.1, 0.2] for name in ("k", "k_d_yaw", "k_d_steer")}
    found = sweep(loop_of(), values, 1.0, ["rms_e"])
    assert {len(column) for column in found.columns.values()} == {8}
    with pytest.raises(ValueError, match="expected one or two"):
        found.plot()


def test_speeds_that_bound_each_other_are_swept_together() -> None:
    """Above the speeds of the loop that is swept; a slowest speed above the fastest is refused."""
    loop = loop_of().with_block("driver", SpeedDriver(v_min=4.0, v_max=8.0))
    found = sweep(loop, {"driver.v_min": [9.0], "driver.v_max": [9.0, 10.0]}, 1.0, ["rms_e"])
    assert np.isfinite(found["rms_e"]).all()
    with pytest.raises(ValueError, match=r"v_max = 8.0 .*expected 9 to"):
        sweep(loop, {"driver.v_min": [9.0], "driver.v_max": [8.0]}, 1.0, ["rms_e"])
