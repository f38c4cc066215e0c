"""Control steps in a second of computing: one closed loop run in every way steerkit has, next to what others have.

The loop: a linear single-track car (Runge-Kutta, 5 x 10 ms), a steering actuator, a path tracker and Stanley at 20 Hz
on the 795 m course, at a constant speed. python-control gets the same equations (the blocks' own functions on
floats), wired in two ways; all runs start alike and their cross-track errors are compared before anything is timed.

    python -m benchmarks study throughput [--quick] [--json]

Contestants take turns, and a ratio is the median of the ratios within one turn, so that a busy machine hurts all
alike. The ratios of the JSON are to python-control with the same diagram: a system for each block, a connection for
each wire. The table and `against` have them also to python-control with one function that leaves it no wiring.
"""

import argparse
import os
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.peers import python_control
from steerkit.compiled import Backend, compile
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.paths.courses import course
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.task import DT
from steerkit.vehicles import vehicle

BACKENDS: tuple[Backend, ...] = ("python", "c")
SPEED, CARS = 6.0, 1000
CAR = vehicle("vw-passat")
DIAGRAM, ONE = (f"python-control, {how}" for how in ("same diagram", "one function"))
MANY = f"C, {CARS} cars"
NEEDED = {"interpreted_x": 5, "compiled_c_x": 250, "batch_x": 3000, "batch_car_steps_per_second_x_one_function": 3000}


def closed_loop() -> Loop:
    """The loop of this benchmark."""
    path, stanley = course("paper"), Stanley.of(CAR, dt=DT)
    car = LinearSingleTrack(vehicle=CAR, dt=DT, substeps=5, v0=SPEED, y0=0.2)
    return steering_loop(
        car=placed(car, path, s=1.0, e=0.2),
        path=path,
        driver=ConstantSpeed(speed=SPEED, dt=DT),
        actuator=SteeringActuator(dt=DT),
        controller=stanley,
        reference=stanley.reference,
    )


@dataclass
class Contestant:
    """A way to run; `run()` does `steps` car-steps."""

    name: str
    steps: int
    run: Callable[[], Any]


def contestants(loop: Loop, quick: bool) -> list[Contestant]:
    """All ways, warmed up."""
    start, many = loop.init(), loop.init(batch=CARS)
    scale = 1 if quick else 4
    ways = []
    for name, make in ((DIAGRAM, python_control.diagram), (ONE, python_control.one_function)):
        made, n = make(loop, start), 100 * scale
        ways.append(Contestant(name, n, lambda made=made, n=n: python_control.run(made, n)))  # type: ignore[misc]
    n = 500 * scale
    ways.append(Contestant("simulate", n, lambda: simulate(loop, n * DT, state=start, record=["path.e"])))
    for name, backend, size in (("generated Python", BACKENDS[0], 2000), ("C", BACKENDS[1], 40000)):
        ready = compile(loop, record=["path.e"], backend=backend)
        ways.append(Contestant(name, size * scale, lambda c=ready, s=size: c.run(s * scale * DT, state=start)))  # type: ignore[misc]
    ways.append(
        Contestant(f"NumPy, {CARS} cars", 20 * CARS, lambda: simulate(loop, 20 * DT, state=many, record=["path.e"]))
    )
    ready = compile(loop, backend="c", record=["path.e"], every=20)
    size = 250 * scale
    ways.append(Contestant(MANY, size * CARS, lambda: ready.run(size * DT, state=many)))
    for way in ways:
        way.run()
    return ways


def require_equal_runs(loop: Loop) -> float:
    """The largest difference in e between others' and steerkit's ways, over 100 samples [m]."""
    start = loop.init()
    reference = simulate(loop, 100 * DT, state=start)["path.e"]
    runs = [python_control.run(python_control.diagram(loop, start), 100)]
    runs += [compile(loop, backend=b, record=["path.e"]).run(100 * DT, state=start)["path.e"] for b in BACKENDS]
    worst = max(float(np.abs(run - reference).max()) for run in runs)
    if not worst < 1e-11:
        raise SystemExit(f"the ways disagree by {worst:.2e} m: nothing to compare")
    return worst


def measured(ways: list[Contestant], turns: int) -> dict[str, list[float]]:
    """Steps a second of each way in each turn."""
    rates: dict[str, list[float]] = {way.name: [] for way in ways}
    for _ in range(turns):
        for way in ways:
            begin = time.perf_counter()
            way.run()
            rates[way.name].append(way.steps / (time.perf_counter() - begin))
    return rates


def ratios_to(rates: dict[str, list[float]], base: str) -> dict[str, float]:
    """Median over the turns of each way's rate over that of `base` in the same turn."""
    return {name: statistics.median(a / b for a, b in zip(values, rates[base])) for name, values in rates.items()}


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure, and print the tables."""
    warnings.filterwarnings("ignore", message="Unused output")
    loop = closed_loop()
    agreement = require_equal_runs(loop)
    rates = measured(contestants(loop, options.quick), 1 if options.quick else 15)
    against = {base: ratios_to(rates, base) for base in (DIAGRAM, ONE)}
    ratios = against[DIAGRAM]
    print(f"\n20 Hz control steps a second, {os.cpu_count()} cores; all ways agree to {agreement:.0e} m\n")
    print(f"{'':49}ratio to python-control as\n{'way':34}{'car-steps/s':>14}{'diagram':>10}{'one':>10}")
    for name, values in rates.items():
        columns = "".join(f"{against[base][name]:10,.1f}" for base in against)
        print(f"{name:34}{statistics.median(values):14,.0f}{columns}")
    result: dict[str, Any] = {
        "interpreted_x": max(ratios["simulate"], ratios["generated Python"]),
        "simulate_x": ratios["simulate"],
        "compiled_c_x": ratios["C"],
        "batch_x": ratios[MANY],
        "batch_car_steps_per_second": statistics.median(rates[MANY]),
        "batch_car_steps_per_second_x_one_function": against[ONE][MANY],
        "steps_per_second": {name: statistics.median(values) for name, values in rates.items()},
        "base": DIAGRAM,
        "against": against,
        "largest_difference_m": agreement,
    }
    print("\n" + "\n".join(f"{n}: {result[n]:,.1f}, wanted {least}" for n, least in NEEDED.items()))
    return result
