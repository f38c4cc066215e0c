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
import warnings
from collections.abc import Callable
from functools import partial
from timeit import timeit
from typing import Any

import numpy as np

from benchmarks.peers import python_control
from benchmarks.tables import show, show_figures
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


Way = tuple[int, Callable[[], Any]]
"""So many car-steps, and what does them."""


def contestants(loop: Loop, quick: bool) -> dict[str, Way]:
    """All ways by their names, warmed up."""
    start, many = loop.init(), loop.init(batch=CARS)
    scale = 1 if quick else 4
    ways: dict[str, Way] = {}
    for name, make in ((DIAGRAM, python_control.diagram), (ONE, python_control.one_function)):
        made, n = make(loop, start), 100 * scale
        ways[name] = n, partial(python_control.run, made, n)
    n = 500 * scale
    ways["simulate"] = n, lambda: simulate(loop, n * DT, state=start, record=["path.e"])
    for name, backend, size in (("generated Python", BACKENDS[0], 2000), ("C", BACKENDS[1], 40000)):
        ready = compile(loop, record=["path.e"], backend=backend)
        ways[name] = size * scale, partial(ready.run, size * scale * DT, state=start)
    ways[f"NumPy, {CARS} cars"] = 20 * CARS, lambda: simulate(loop, 20 * DT, state=many, record=["path.e"])
    ready = compile(loop, backend="c", record=["path.e"], every=20)
    size = 250 * scale
    ways[MANY] = size * CARS, partial(ready.run, size * DT, state=many)
    for _, run in ways.values():
        run()
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


def measured(ways: dict[str, Way], turns: int) -> dict[str, list[float]]:
    """Steps a second of each way in each turn."""
    rates: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(turns):
        for name, (steps, run) in ways.items():
            rates[name].append(steps / timeit(run, number=1))
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
    medians = {name: statistics.median(values) for name, values in rates.items()}
    rows = [{"way": name, "car-steps/s": f"{value:,.0f}"} for name, value in medians.items()]
    over = [{f"x {base}": f"{ratio[name]:,.1f}" for base, ratio in against.items()} for name in rates]
    title = f"20 Hz control steps a second, {os.cpu_count()} cores; all ways agree to {agreement:.0e} m"
    show(title, [row | ratio for row, ratio in zip(rows, over)])
    result: dict[str, Any] = {
        "interpreted_x": max(ratios["simulate"], ratios["generated Python"]),
        "simulate_x": ratios["simulate"],
        "compiled_c_x": ratios["C"],
        "batch_x": ratios[MANY],
        "batch_car_steps_per_second": medians[MANY],
        "batch_car_steps_per_second_x_one_function": against[ONE][MANY],
        "steps_per_second": medians,
        "base": DIAGRAM,
        "against": against,
        "largest_difference_m": agreement,
    }
    show_figures(result)
    return result
