"""Manoeuvres in simulation: any plant, repeats that differ where something is drawn, and a fleet as single cars."""

from dataclasses import replace

import numpy as np
import pytest

from steerkit import Scenario
from steerkit.compiled import TraceError
from steerkit.proving import runs
from steerkit.proving.evaluate import evaluate
from steerkit.proving.manoeuvre import manoeuvre
from steerkit.proving.runs import differing, of_fleet, on_course, simulated
from steerkit.vehicles import VW_PASSAT as PASSAT
from steerkit.vehicles import fleet


@pytest.mark.parametrize("plant", ["linear", "nonlinear"])
def test_a_run_is_straight_before_and_of_the_size_that_was_asked(plant: str) -> None:
    one = manoeuvre("step-steer")
    left, right = simulated(one, Scenario(vehicle={"plant": plant}))
    assert np.abs(left["r"][left.t < 0.0]).max() < 1e-9
    assert left["a_y"][-1] == pytest.approx(4.0, rel=0.02 if plant == "linear" else 0.2)
    assert right["r"] == pytest.approx(-left["r"], abs=1e-9)
    assert left.t[0] == pytest.approx(-3.0)
    assert left.t[-1] >= one.seconds - 0.02


def test_repeats_differ_where_something_is_drawn_by_lot() -> None:
    one = replace(manoeuvre("sine"), repeats=2)
    assert len(simulated(one, Scenario())) == 2
    gusts = Scenario(disturbances={"gust": 1.5})
    runs = simulated(one, gusts)
    assert [(run.side, run.number) for run in runs] == [(s, k) for s in ("left", "right") for k in (1, 2)]
    assert np.abs(runs[0]["r"] - runs[1]["r"]).max() > 1e-4
    left = replace(one, sides=("left",))
    again = simulated(left, gusts)
    assert np.array_equal(again[1]["r"], runs[1]["r"])
    other = simulated(left, gusts, seed=1)
    assert not np.array_equal(other[1]["r"], runs[1]["r"])
    found = evaluate(one, runs, PASSAT)
    assert found["yaw_lag"].high > found["yaw_lag"].low


def test_what_cannot_be_compiled_is_interpreted_with_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    one = replace(manoeuvre("step-steer"), sides=("left",))
    (compiled,) = simulated(one, Scenario())

    def refused(*_: object, **__: object) -> None:
        raise TraceError("a block that looks at its numbers")

    monkeypatch.setattr(runs, "compile", refused)
    (interpreted,) = simulated(one, Scenario())
    assert all(np.array_equal(interpreted[name], compiled[name]) for name in ("r", "a_y", "delta_sw", "v"))


def test_a_controller_that_loses_the_course_is_no_valid_run() -> None:
    one = manoeuvre("lane-change-1")
    lost = simulated(one, Scenario(vehicle={"plant": "nonlinear", "friction": 0.15}), controller="stanley")
    found = evaluate(one, lost, PASSAT)
    assert found.passed is not True


@pytest.mark.parametrize("name", ["step-steer", "lane-change-2"])
def test_a_fleet_drives_as_its_cars_do_alone(name: str) -> None:
    one, cars = manoeuvre(name), list(fleet().values())[20:23]
    for car, (run,) in of_fleet(one, cars):
        steering = {"delay": round(car.steer_delay, 2), "lag": 0.12, "rate_limit_deg": 5000.0}
        alone = Scenario(vehicle={"name": car.vehicle.name, "plant": "linear"}, steering=steering)
        single = simulated(one, alone, controller="stanley-delay")[0]
        batched, by_itself = (evaluate(one, [each], car.vehicle) for each in (run, single))
        for a, b in zip(batched.results, by_itself.results, strict=True):
            assert a.value == pytest.approx(b.value, rel=0.02, abs=0.012, nan_ok=True), (car.vehicle.name, a.quantity)


def test_loops_that_differ_in_a_table_are_no_batch() -> None:
    one = manoeuvre("lane-change-2")
    loops = [
        on_course(one, Scenario(vehicle={"name": name, "plant": "linear"}), "lqr")[0]
        for name in ("vw-passat", "fleet-7")
    ]
    with pytest.raises(ValueError, match="differs from car to car and is no number"):
        differing(loops)
