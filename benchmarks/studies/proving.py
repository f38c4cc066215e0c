"""Manoeuvres of vehicle testing: against closed forms, their intervals under noise, the whole fleet, logs, a car.

    python -m benchmarks study proving [--quick] [--json]

`closed_form_error_pct`: the largest difference of understeer gradient, yaw-rate gain, natural frequency, damping and
static margin, from simulated manoeuvres of linear single tracks, from their closed forms. `interval_coverage_pct`: how
often a 95 % interval holds the closed form, over --draws measurements with noise of the steady and the random
manoeuvre (gyro 0.1 deg/s, acceleration 0.05 m/s^2, wheel 0.1 deg, sideslip 0.1 deg). `cars`, `manoeuvres`, `minutes`:
all production cars through all manoeuvres. `openpilot_report_samples_off`: delay at 50 % and crossing time beside a
re-implementation of openpilot's report, from what its documentation says. `logs`: what the recorded drives that ship
tell. `car`: on simulated cars behind the bus, see `benchmarks.run.proving_car`.
"""

import argparse
import math
import time
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from benchmarks.tables import show_figures
from steerkit import LinearSingleTrack, Scenario, vehicle
from steerkit.logs import read_drive
from steerkit.proving.evaluate import evaluate
from steerkit.proving.manoeuvre import manoeuvre, names
from steerkit.proving.runs import Run, found, of_fleet, simulated
from steerkit.vehicles import FleetCar, Vehicle, fleet

NOISE = {"r": math.radians(0.1), "a_y": 0.05, "delta_sw": math.radians(0.1), "beta": math.radians(0.1), "v": 0.02}
"""Standard deviation of each signal's white noise at 100 Hz, in SI."""
NOISY = ("steady-state-circle", "random-steer")
"""Manoeuvres whose intervals are tried."""
CARS = ("vw-passat", "fleet-3", "fleet-17", "fleet-40", "fleet-71")
"""Cars that understeer; those of CommonRoad are neutral: a gradient of 0 has no relative error, and a pole of the yaw
rate is on its zero."""


def closed_forms(car: Vehicle, v: float) -> dict[str, float]:
    """What a linear single track's steady and frequency-domain figures are, by theory."""
    a, _ = (np.array(part) for part in LinearSingleTrack(vehicle=car).matrices(v))
    natural = math.sqrt(np.linalg.det(a))
    margin = (car.c_r * car.l_r - car.c_f * car.l_f) / ((car.c_f + car.c_r) * car.wheelbase)
    return {
        "understeer_gradient": float(car.understeer_gradient),
        "yaw_gain": float(v / (car.wheelbase + car.understeer_gradient * v * v) / car.steer_ratio),
        "natural_frequency": natural / (2.0 * math.pi),
        "damping": float(-np.trace(a) / (2.0 * natural)),
        "static_margin": float(margin),
    }


def linear(name: str) -> Scenario:
    """A car as a linear single track, steered without lag."""
    return Scenario(vehicle={"name": name, "plant": "linear"}, steering={"lag": 0.0})


@cache
def clean(which: str, car: str) -> list[Run]:
    """The runs of a manoeuvre by that car, as nobody measures them."""
    return simulated(manoeuvre(which), linear(car))


def against_theory(cars: tuple[str, ...], manoeuvres: tuple[str, ...]) -> dict[str, float]:
    """The largest error of each quantity [%], over cars and manoeuvres."""
    worst: dict[str, float] = {}
    for name in cars:
        scenario = linear(name)
        for which in manoeuvres:
            one = manoeuvre(which)
            truth = closed_forms(scenario.nominal, one.conditions.v)
            for result in evaluate(one, clean(which, name), scenario.nominal).results:
                if result.quantity in truth:
                    error = 100.0 * abs(result.value / truth[result.quantity] - 1.0)
                    worst[f"{which}: {result.quantity}"] = max(worst.get(f"{which}: {result.quantity}", 0.0), error)
    return worst


def noisy(run: Run, random: np.random.Generator) -> Run:
    """The run as instruments would have it."""
    signals = {
        name: values + NOISE.get(name, 0.0) * random.standard_normal(len(values))
        for name, values in run.signals.items()
    }
    return replace(run, signals=signals)


def coverage(draws: int, seed: int = 0) -> dict[str, float]:
    """How often the intervals hold the closed form [%], by manoeuvre and quantity."""
    hits: dict[str, list[bool]] = {}
    random = np.random.default_rng(seed)
    for which in NOISY:
        one, scenario = manoeuvre(which), linear(CARS[0])
        truth = closed_forms(scenario.nominal, one.conditions.v)
        for _ in range(draws):
            for result in evaluate(
                one, [noisy(run, random) for run in clean(which, CARS[0])], scenario.nominal
            ).results:
                if result.quantity in truth:
                    held = result.low <= truth[result.quantity] <= result.high
                    hits.setdefault(f"{which}: {result.quantity}", []).append(held)
    return {name: 100.0 * float(np.mean(held)) for name, held in hits.items()}


def whole_fleet(cars: list[FleetCar], which: tuple[str, ...]) -> dict[str, int]:
    """Every car through every manoeuvre: how many were evaluated, and how many keep their limits."""
    counts = {"evaluated": 0, "invalid": 0, "passed": 0, "failed": 0}
    for name in which:
        one = manoeuvre(name)
        for car, runs in of_fleet(one, cars):
            evaluation = evaluate(one, runs, car.vehicle, who=car.vehicle.name)
            counts["evaluated" if evaluation.valid else "invalid"] += 1
            if evaluation.passed is not None:
                counts["passed" if evaluation.passed else "failed"] += 1
    return counts


def report_of_openpilot(t: Any, requested: Any, actual: Any) -> tuple[float, float]:
    """Delay at 50 % and crossing time, as openpilot's report has them: sample by sample, from the run's beginning.

    The delay is the time of the first sample at which the actual lateral acceleration has reached half of the first
    peak of the requested one, in its direction; the crossing that of the first one that has reached the peak itself.
    Written from the description of tools/lateral_maneuvers, not from its code.
    """
    peak, k = 0.0, 0
    while k < len(t) and abs(requested[k]) >= abs(peak) and requested[k] * peak >= 0.0:
        peak, k = requested[k], k + 1
    times = [math.nan, math.nan]
    for which, share in enumerate((0.5, 1.0)):
        for when, value in zip(t, actual):
            if math.copysign(1.0, peak) * value >= share * abs(peak):
                times[which] = float(when)
                break
    return times[0], times[1]


def beside_openpilot(manoeuvres: list[str], delays: tuple[float, ...]) -> float:
    """The largest difference to that report, in samples, over its manoeuvres and cars of several delays."""
    worst = 0.0
    for name in manoeuvres:
        for delay in delays:
            one = manoeuvre(name)
            scenario = Scenario(vehicle={"plant": "linear"}, steering={"delay": delay, "lag": 0.15})
            for run in simulated(one, scenario):
                use = run.between(0.0, one.seconds)
                sign = 1.0 if run.side == "left" else -1.0
                wave = sign * one.required.a_y * one.required.wave[: int(use.sum())]
                theirs = report_of_openpilot(run.t[use], wave, run["a_y"][use])
                ours = evaluate(one, [run], scenario.nominal)
                for quantity, time_of in zip(("delay_50", "crossing"), theirs):
                    value = ours[quantity].value
                    if math.isnan(value) and math.isnan(time_of):
                        continue
                    worst = max(worst, abs(value - time_of) / run.dt)
    return worst


def of_logs(logs: tuple[str, ...] = ("genesis", "genesis-rfs")) -> dict[str, dict[str, Any]]:
    """What the recorded drives that ship tell, by manoeuvre: quantities with their intervals, or why none."""
    car = vehicle("vw-passat")
    told: dict[str, dict[str, Any]] = {}
    for log in logs:
        drive = read_drive(log)
        for name in names():
            one, runs, notes = found(manoeuvre(name), drive)
            evaluation = evaluate(one, runs, car, notes=notes)
            row: dict[str, Any] = {
                r.quantity: [r.value, r.low, r.high] for r in evaluation.results if not r.note.startswith("not")
            }
            told[f"{log}: {name}"] = row or {"none": list(evaluation.notes)[-2:]}
    return told


def add_options(parser: argparse.ArgumentParser) -> None:
    """How much."""
    parser.add_argument("--draws", type=int, default=500, help="measurements with noise")
    parser.add_argument("--no-car", action="store_true", help="leave out the simulated cars behind the bus")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure, and print."""
    quick = options.quick
    theory = against_theory(CARS[:1], NOISY) if quick else against_theory(CARS, (*NOISY, "pulse-steer", "step-steer"))
    print("error from closed forms [%]")
    show_figures(theory)
    covered = coverage(6 if quick else options.draws)
    print("intervals that hold the truth [%]")
    show_figures(covered)
    cars, which = list(fleet().values()), names()
    if quick:
        cars, which = cars[:5], ("step-steer", "lane-change-2")
    begin = time.perf_counter()
    counts = whole_fleet(cars, which)
    minutes = (time.perf_counter() - begin) / 60.0
    print(f"{len(cars)} cars, {len(which)} manoeuvres: {minutes:.2f} min, {counts}")
    theirs = [each for each in names() if each.startswith("openpilot")]
    off = beside_openpilot(theirs[-1:], (0.1,)) if quick else beside_openpilot(theirs, (0.0, 0.1, 0.2, 0.4))
    print(f"beside openpilot's report: {off:.2f} samples off")
    logs = of_logs(("genesis",)) if quick else of_logs()
    for name, row in logs.items():
        print(f"{name}: {row}")
    figures: dict[str, Any] = {
        "closed_form_error_pct": max(theory.values()),
        "interval_coverage_pct": float(np.mean(list(covered.values()))),
        "coverage": covered,
        "cars": len(cars),
        "manoeuvres": len(which),
        "minutes": minutes,
        "fleet": counts,
        "openpilot_report_samples_off": off,
        "logs": logs,
    }
    if not options.no_car:
        from benchmarks.run import proving_car

        figures["car"] = proving_car.measure(quick)
        print(f"on simulated cars behind the bus: {figures['car']}")
    return figures
