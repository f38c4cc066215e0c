"""Manoeuvres driven in simulation, by any plant and any fleet, and found in logs where they were driven."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit import Scenario
from steerkit.compiled import TraceError
from steerkit.logs import read_drive
from steerkit.logs.drive import Drive
from steerkit.proving import runs as module
from steerkit.proving.evaluate import evaluate
from steerkit.proving.manoeuvre import manoeuvre
from steerkit.proving.runs import _even, correlated, differing, found, of_fleet, on_course, simulated
from steerkit.vehicles import VW_PASSAT as PASSAT
from steerkit.vehicles import fleet
from tests.support.linear_car import linear


def drive_with(name: str, *, v: float, gaps: float = 20.0, seed: int = 0) -> tuple[Drive, list[float]]:
    """A log in which the manoeuvre's runs follow each other with straight driving between; and where they begin [s]."""
    one = manoeuvre(name).at(v=v)
    runs = simulated(one, linear("vw-passat"), controller="stanley")
    random, pieces, begins = np.random.default_rng(seed), [np.zeros((3, 500))], []
    t = 5.0
    for run in runs:
        use = run.t >= 0.0
        begins.append(t)
        pieces.append(np.array([run[key][use] - (v if key == "v" else 0.0) for key in ("delta_sw", "r", "v")]))
        pieces.append(np.zeros((3, round(100 * gaps))))
        t += (int(use.sum()) + round(100 * gaps)) * 0.01
    wheel, r, speed = np.concatenate(pieces, axis=1)
    noise = 2e-4 * random.standard_normal((2, len(wheel)))
    columns = {"t": 0.01 * np.arange(len(wheel)), "delta_sw": wheel + noise[0], "r": r + noise[1], "v": speed + v}
    return Drive.of(columns, trusted=True), begins


@pytest.mark.parametrize("name", ["step-steer", "sine", "pulse-steer", "sine-with-dwell", "weave", "openpilot-sine-30"])
def test_a_manoeuvre_is_found_where_it_was_driven(name: str) -> None:
    v = 15.0
    drive, begins = drive_with(name, v=v)
    driven, runs, notes = found(manoeuvre(name), drive)
    begun = [float(run.t[0]) for run in runs]
    assert len(runs) == len(begins)
    assert all(abs(t + manoeuvre(name).conditions.settle) < 0.02 for t in begun)
    assert [run.side for run in runs] == list(manoeuvre(name).sides)
    assert driven.conditions.v == pytest.approx(v, abs=0.1)
    assert any("driven at 15.0 m/s" in note for note in notes) is (abs(manoeuvre(name).conditions.v - v) > 0.8)
    told = evaluate(driven, runs, PASSAT, notes=notes)
    assert len(told.valid) == len(begins), [run.invalid for run in told.runs]
    truth = evaluate(driven, simulated(driven, linear("vw-passat")), PASSAT)
    for quantity in ("yaw_gain", "yaw_peak_gain", "yaw_lag", "bandwidth", "phase_1_hz"):
        if quantity in {r.quantity for r in truth.results}:
            assert told[quantity].value == pytest.approx(truth[quantity].value, rel=0.05, abs=0.004), quantity


@pytest.mark.parametrize("name", ["lane-change-1", "lane-change-2"])
def test_a_lane_change_is_found_by_the_yaw_rate(name: str) -> None:
    drive, begins = drive_with(name, v=15.0)
    _, runs, _ = found(manoeuvre(name), drive)
    assert len(runs) == 1
    assert runs[0].side == "left"
    other = {"lane-change-1": "lane-change-2", "lane-change-2": "lane-change-1"}[name]
    assert len(found(manoeuvre(other), drive)[1]) <= 1
    assert begins == [5.0]


@pytest.mark.parametrize("name", ["sine", "pulse-steer", "sine-with-dwell", "weave"])
def test_it_is_not_found_in_noise_nor_in_another_one(name: str) -> None:
    random = np.random.default_rng(1)
    n = 6000
    noise: Any = 0.05 * np.convolve(random.standard_normal(n + 49), np.ones(50) / 7.0, mode="valid")
    drive = Drive.of(
        {"t": 0.01 * np.arange(n), "delta_sw": noise, "r": 0.3 * noise, "v": np.full(n, 15.0)}, trusted=True
    )
    assert found(manoeuvre(name), drive)[1] == []
    steps, _ = drive_with("step-steer", v=15.0)
    assert found(manoeuvre(name), steps)[1] == []


def test_what_has_no_form_takes_the_whole_drive() -> None:
    drive = read_drive("genesis")
    one, runs, notes = found(manoeuvre("steady-state-circle"), drive)
    told = evaluate(one, runs, PASSAT, notes=notes)
    gradient = told["understeer_gradient"]
    assert len(runs) == 1
    assert runs[0].whole
    assert gradient.n > 30
    assert 0.0 < gradient.low < gradient.high < 0.006
    assert any("no sideslip" in note for note in told.notes)
    _, runs, notes = found(manoeuvre("random-steer"), drive)
    assert runs
    assert all(np.ptp(run["v"]) <= 3.5 and run.t[-1] >= 44.0 for run in runs)
    told = evaluate(one := manoeuvre("random-steer"), runs, PASSAT, notes=notes)
    assert told["natural_frequency"].note.startswith("not determined")
    assert 0.1 < told["yaw_gain"].value < 0.4
    assert not told["yaw_gain"].note
    assert one.name == "random-steer"


def test_a_gap_in_the_log_makes_a_run_invalid() -> None:
    drive, begins = drive_with("step-steer", v=15.0)
    measured = drive.measured.copy()
    measured[round(100 * begins[0]) + 50] = False
    _, runs, _ = found(manoeuvre("step-steer"), replace(drive, measured=measured))
    assert [run.invalid for run in runs] == ["samples are missing", ""]


def test_the_correlation_is_one_for_the_form_itself_whatever_its_size_and_offset() -> None:
    form = np.sin(np.linspace(0.0, 6.0, 50))
    signal = np.concatenate((np.zeros(30), -2.0 * form + 5.0, np.zeros(30)))
    rho, size = correlated(signal, form)
    k = int(np.argmin(rho))
    assert k == 30
    assert rho[k] == pytest.approx(-1.0)
    assert size[k] == pytest.approx(-2.0)
    assert np.abs(rho).max() <= 1.0 + 1e-9


def test_a_log_that_is_parked_for_long_is_cut_where_it_drives() -> None:
    """Each sample at rest once began a search of all that follows: 39 s for twenty minutes."""
    t = 0.01 * np.arange(60_000)
    drives = ((t >= 200.0) & (t < 260.0)) | ((t >= 300.0) & (t < 330.0)) | ((t >= 400.0) & (t < 500.0))
    v = np.where(drives, 15.0, 0.0)
    signals = {"v": v, "r": 0.0 * v, "delta_sw": 0.0 * v, "a_y": 0.0 * v}
    drive = Drive(name="parked", dt=0.01, delta_sw=v, v=v, r=v, measured=drives | True, calibrated=True)
    looked = [0]

    class Counted(np.ndarray):  # type: ignore[type-arg]
        def __getitem__(self, key: Any) -> Any:
            looked[0] += 1
            return super().__getitem__(key)

    runs = _even(replace(drive, v=v.view(Counted)), signals, 45.0)
    assert [len(run.t) for run in runs] == [6000, 10_000]
    assert looked[0] < 100


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
    told = evaluate(one, runs, PASSAT)
    assert told["yaw_lag"].high > told["yaw_lag"].low


def test_what_cannot_be_compiled_is_interpreted_with_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    one = replace(manoeuvre("step-steer"), sides=("left",))
    (compiled,) = simulated(one, Scenario())

    def refused(*_: object, **__: object) -> None:
        raise TraceError("a block that looks at its numbers")

    monkeypatch.setattr(module, "compile", refused)
    (interpreted,) = simulated(one, Scenario())
    assert all(np.array_equal(interpreted[name], compiled[name]) for name in ("r", "a_y", "delta_sw", "v"))


def test_a_controller_that_loses_the_course_is_no_valid_run() -> None:
    one = manoeuvre("lane-change-1")
    lost = simulated(one, Scenario(vehicle={"plant": "nonlinear", "friction": 0.15}), controller="stanley")
    assert evaluate(one, lost, PASSAT).passed is not True


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
