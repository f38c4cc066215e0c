"""Targets of lateral acceleration, the loop that follows one, and what it costs, in closed forms."""

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.foreign_cars import CARS
from steerkit.controllers.lateral import ChallengeController, LateralMpc
from steerkit.controllers.stanley import Stanley
from steerkit.scenario import Scenario
from steerkit.scenario.lateral import LateralTarget, lateral_controller, lateral_cost_of, lateral_drive, lateral_loop
from steerkit.vehicles import VW_PASSAT


class Steady:
    """Asks for 0.8 m/s^2 all along."""

    def update(self, *_: object) -> float:
        return 0.8


STEADY = ChallengeController(make=Steady)


@pytest.mark.parametrize("plant", ["linear", "nonlinear"])
def test_a_command_is_what_the_data_sheet_says_of_the_steady_car(plant: str) -> None:
    """So the cost of a constant target is nothing once it is reached; the road's roll comes on top."""
    scenario = Scenario(vehicle={"name": "vw-passat", "plant": plant})
    target = LateralTarget.of(np.full(150, 0.8), 15.0)
    log = lateral_drive(scenario, target, STEADY)
    assert log["target.a_y"][-20:] == pytest.approx(0.8, abs=0.012 if plant == "nonlinear" else 1e-4)
    banked = lateral_drive(scenario, LateralTarget.of(np.full(150, 0.8), 15.0, -0.3), STEADY)
    assert banked["target.a_y"] == pytest.approx(log["target.a_y"] - 0.3)


def test_the_command_is_cut() -> None:
    class Wild:
        def update(self, *_: object) -> float:
            return -50.0

    log = lateral_drive(Scenario(), LateralTarget.of(np.zeros(9), 15.0), ChallengeController(make=Wild))
    per_a = VW_PASSAT.wheelbase / 15.0**2 + VW_PASSAT.understeer_gradient
    assert log["target.delta_sw"] == pytest.approx(-VW_PASSAT.steer_ratio * math.atan(2.0 * per_a))


def test_the_cost_is_that_of_what_was_driven() -> None:
    t = 0.1 * np.arange(600)
    log = lateral_drive(
        Scenario(), LateralTarget.of(np.sin(0.5 * t) * np.clip(t, 0, 1), 12.0), lateral_controller("mpc", Scenario())
    )
    cost = lateral_cost_of(log)
    off = log["target.a_y"] - log["target.a_y_target"]
    assert cost["lataccel_cost"] == pytest.approx(100.0 * np.mean(off**2))
    assert cost["total_cost"] == pytest.approx(50.0 * cost["lataccel_cost"] + cost["jerk_cost"])
    assert cost["jerk_cost"] == pytest.approx(100.0 * 0.5 * 0.5**2, rel=0.05)  # the sine's own
    assert cost["lataccel_cost"] < 0.1


@pytest.mark.parametrize(("times", "q_step"), [(0.5, 1000.0), (1.5, 1000.0), (0.75, 100.0), (1.25, 100.0)])
def test_a_wrong_dead_time_within_what_the_step_cost_holds_does_not_swing(times: float, q_step: float) -> None:
    """Hardly steering costs 1,360 on such targets; that of the right dead time is 150."""
    torque = CARS["torque"]
    scenario = Scenario(vehicle={**torque.vehicle, "plant": torque.plant}, steering=dict(torque.steering))
    told = scenario.design_model()
    block = LateralMpc(response=LateralMpc.told(times * told.delay, told.lag), q_step=q_step)
    log = lateral_drive(scenario, LateralTarget.drawn(7001), block, seed=7001)
    assert lateral_cost_of(log)["total_cost"] < 600.0


def test_a_drawn_target_is_its_seeds_and_drivable() -> None:
    for seed in range(20):
        rows = LateralTarget.drawn(seed).table.rows
        assert np.array_equal(rows, LateralTarget.drawn(seed).table.rows)
        a_y, a_roll, v, a_x = rows.T
        assert 0.3 < np.abs(a_y).max() <= 1.8
        assert a_y[0] == a_roll[0] == 0.0
        assert 8.5 < v.min() < v.max() < 30.0
        assert np.abs(a_roll).max() <= 0.3
        assert np.abs(np.diff(a_y) / 0.1).max() < 3.0
        assert a_x[1:-1] == pytest.approx((v[2:] - v[:-2]) / 0.2)
    assert not np.array_equal(rows, LateralTarget.drawn(3).table.rows)


def test_what_is_ahead_stays_at_the_end() -> None:
    target = LateralTarget.of(np.arange(60.0) / 10.0, 10.0)
    y = target.output(0.0, (15.0,), target.D(answer=0.0, a_y_cmd=0.0))
    assert (y.a_y_target, y.preview[0], y.preview[43], y.preview[-1]) == pytest.approx((1.5, 1.6, 5.9, 5.9))


def test_a_csv_file_is_read_at_its_times(tmp_path: Path) -> None:
    file = tmp_path / "target.csv"
    file.write_text("t,a_y,v\n0,0,10\n1,1,12\n")
    rows = LateralTarget.read(str(file)).table.rows
    assert rows[:, 0] == pytest.approx(np.arange(11) / 10.0)
    assert rows[:, 2] == pytest.approx(10.0 + np.arange(11) / 5.0)
    file.write_text("a_y,v,a_roll\n0,10,0.1\n0.5,10,0.2\n")
    assert LateralTarget.read(str(file)).table.rows[:, 1] == pytest.approx([0.1, 0.2])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("t,v\n0,1\n1,1\n", "no column a_y; expected a_y, v"),
        ("a_y,v\n0,10\n", "expected 2 or more samples"),
        ("a_y,v\n0,10\nnan,10\n", r"at 0.1 s: a_y = nan \[m/s\^2\], expected -20 to 20"),
        ("a_y,v\n0,10\n0,10\n0,0.2\n", r"at 0.2 s: v = 0.2 \[m/s\], expected 1 to 100"),
        ("a_y,v\n0,10\nleft,10\n", r"at 0.1 s: a_y = nan \[m/s\^2\], expected -20 to 20"),
        ("t,a_y,v\n0,0,10\n1,0,10\n1e12,0,10\n", r"no row for 1e\+12 s from t = 1 s on, expected one in 10 s"),
        ("t,a_y,v\n0,0,10\n0,0,10\n", r"t \[s\] does not rise"),
        ("", "no rows"),
    ],
)
def test_a_wrong_file_is_refused_in_words(text: str, fault: str, tmp_path: Path) -> None:
    file = tmp_path / "target.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match=f"target .*target.csv.*{fault}"):
        LateralTarget.read(str(file))


def test_unknown_names_and_blocks_are_refused() -> None:
    with pytest.raises(ValueError, match=r"target drawn: is not known; valid: drawn-7 \(a seed\), lap, FILE.csv"):
        LateralTarget.read("drawn")
    with pytest.raises(ValueError, match=r"controller of lateral acceleration 'stanley' is not known.*valid: lqr, mpc"):
        lateral_controller("stanley", Scenario())
    with pytest.raises(AttributeError, match="Stanley has no port or parameter 'a_y_cmd'"):
        lateral_loop(Scenario(), LateralTarget.drawn(1), Stanley.of(VW_PASSAT))
