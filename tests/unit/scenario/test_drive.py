"""A drive: held, caught, or lost; and those of learned policies, compiled."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.simulation import Log
from steerkit.learning.learner_state import untrained
from steerkit.learning.settings import DEFAULT
from steerkit.scenario import Scenario
from steerkit.scenario.drive import SignCheck, comparison, controller, drive, drive_loop, held_all_along, row_of


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
    assert row["max_a_y"] <= 3.0
    fast = drive(
        Scenario(course="circle", driver={"v_min": 10.0, "v_max": 10.0}), controller("stanley", scenario), rounds=0.3
    )
    row = row_of("fast", fast)
    assert row["max_a_y"] > 3.0
    assert not row["iso_11270"]
    assert not row["un_r79"]
    log = logs["stanley"]
    lost = Log(log.t, {**log.signals, "path.e": np.full(len(log.t), 0.6)}, log.units)
    assert [next(iter(column.cells)) for column in comparison("lost", {"a": lost}).columns][1] == "no"


@pytest.mark.parametrize(
    ("plant", "said"), [("TurnsRight", "the car turns against its wheel"), ("YawsRight", "the yaw rate goes")]
)
@pytest.mark.parametrize(("name", "course", "v"), [("stanley", "genesis", 8.0), ("lqr-adaptive", "sweeping-7", 15.0)])
def test_a_plant_that_turns_the_other_way_ends_the_drive(
    plant: str, said: str, name: str, course: str, v: float
) -> None:
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
    vehicle, steering = {"plant": "benchmarks.plants.torque_car:TorqueCar"}, {"command": "torque", "delay": 0.5}
    scenario = Scenario(
        course="sweeping-7",
        vehicle=vehicle,
        steering=steering,
        driver={"v_min": 12.0, "v_max": 12.0},
        knowledge={"delay": told},
    )
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
