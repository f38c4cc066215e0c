"""Control steps in a second of computing: one closed loop run in every way steerkit has, next to what others have.

The loop: a linear single-track car (Runge-Kutta, 5 x 10 ms), a steering actuator, a path tracker and Stanley at 20 Hz
on the 795 m course, at a constant speed. python-control gets the same equations (the blocks' own functions on
floats), wired three ways; all runs start alike and their cross-track errors are compared before anything is timed.

    python -m benchmarks study throughput [--quick] [--json]

Contestants take turns, and a ratio is the median of the ratios within one turn, so that a busy machine hurts all
alike. The ratios of the JSON are to python-control with the same diagram: a system for each block, a connection for
each wire. The table and `against` have them also to python-control wired as two systems (plant and controller), and as
one function that leaves no wiring to it at all.

`c_step_ns`: CPU time of a step of one car in C. `tracker_ns`: that of the path tracker, in a loop with nothing but a
table of poses before it, less the loop of the poses alone. There each search waits for the one before.
`tracker_in_loop_ns`: what it adds to the closed loop, against one with a tracker that costs nothing, where a processor
computes it while it waits for other blocks. All are the least of 40 turns, since other processes on the same core only
ever add to them.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.peers import python_control
from steerkit.compiled import Backend, compile
from steerkit.controllers.stanley import Stanley
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop, Wire
from steerkit.diagram.maths import Table
from steerkit.diagram.simulation import simulate
from steerkit.paths.courses import course
from steerkit.paths.tracker import PathTracker
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed
from steerkit.task import DT
from steerkit.vehicles import vehicle

BACKENDS: tuple[Backend, ...] = ("python", "vm", "c")
SPEED, CARS = 6.0, 1000
CAR = vehicle("vw-passat")
DIAGRAM, TWO, ONE = (f"python-control, {how}" for how in ("same diagram", "two systems", "one function"))
MANY = f"C, {CARS} cars"
NEEDED = {
    "interpreted_x": 5,
    "compiled_vm_x": 60,
    "compiled_c_x": 250,
    "batch_x": 400,
    "batch_linear_x": 3000,
    "batch_car_steps_per_second_x_one_function": 3000,
}
NEEDED_NS = {"tracker_ns": 150, "c_step_ns": 450}


@dataclass(frozen=True, eq=False, kw_only=True)
class Zigzag(Block):
    """Errors from a zigzag about the x axis, in a few operations: what a tracker costs is seen by leaving it out.

    (From a straight line the errors would fade into numbers so small that processors take longer for them.)
    """

    x = In("m")
    y = In("m")
    psi = In("rad")
    e = Out("m")
    psi_e = Out("rad")
    kappa = Out("1/m", direct=())

    def output(self, t: Any, x: Any, u: Any) -> Any:
        turns = u.x * 0.025
        return self.Y(u.y - m.absolute(turns - m.floor(turns) - 0.5), u.psi, 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Poses(Block):
    """A drive's poses and motion, a row a sample: what a tracker looks at where nothing else is computed."""

    x = Out("m", direct=())
    y = Out("m", direct=())
    psi = Out("rad", direct=())
    v = Out("m/s", direct=())
    beta = Out("rad", direct=())
    r = Out("rad/s", direct=())

    rows: Table

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (m.filled(0.0, batch),)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(*self.rows(x[0]))

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return (m.where(x[0] < len(self.rows) - 1.0, x[0] + 1.0, 0.0),)


def closed_loop(*, tracker: bool = True, actuator: bool = True) -> Loop:
    """The loop of this benchmark, with or without two of its blocks."""
    path = course("paper")
    car = LinearSingleTrack(vehicle=CAR, dt=DT, substeps=5, v0=SPEED, y0=0.2)
    car = placed(car, path, s=1.0, e=0.2) if tracker else car
    stanley, driver = Stanley.of(CAR, dt=DT), ConstantSpeed(speed=SPEED, dt=DT)
    seen: Any = PathTracker(path=path, reference=stanley.reference, dt=DT) if tracker else Zigzag(dt=DT)
    motor = SteeringActuator(dt=DT)
    wires: list[Wire] = [(getattr(car, p.name), getattr(seen, p.name)) for p in seen.inputs]
    wires += [
        (seen.e, stanley.e),
        (seen.psi_e, stanley.psi_e),
        (seen.kappa, stanley.kappa),
        (car.v, stanley.v),
        (car.r, stanley.r),
        (driver.v, car.v_cmd),
    ]
    blocks: dict[str, Block] = {"driver": driver, "car": car, "path": seen, "controller": stanley}
    if actuator:
        blocks["actuator"] = motor
        wires += [
            (stanley.delta_sw, motor.delta_sw_cmd),
            (motor.delta_sw, car.delta_sw_cmd),
            (motor.delta_sw, stanley.delta_sw_meas),
        ]
    else:
        wires += [(stanley.delta_sw, car.delta_sw_cmd), (car.delta_sw, stanley.delta_sw_meas)]
    return Loop(blocks=blocks, wires=wires)


# ---- measuring --------------------------------------------------------------------------------------------------


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
    for name, make in (
        (DIAGRAM, python_control.diagram),
        (TWO, python_control.two_systems),
        (ONE, python_control.one_function),
    ):
        made, n = make(loop, start), 100 * scale
        ways.append(Contestant(name, n, lambda made=made, n=n: python_control.run(made, n)))  # type: ignore[misc]
    n = 500 * scale
    ways.append(Contestant("simulate", n, lambda: simulate(loop, n * DT, state=start, record=["path.e"])))
    for name, options, size in (
        ("generated Python", {"backend": "python"}, 2000),
        ("CasADi VM", {"backend": "vm"}, 8000),
        ("CasADi VM, collapsed", {"backend": "vm", "collapse": True}, 8000),
        ("C", {"backend": "c"}, 40000),
        ("C, collapsed", {"backend": "c", "collapse": True}, 40000),
    ):
        ready = compile(loop, record=["path.e"], **options)
        ways.append(Contestant(name, size * scale, lambda c=ready, s=size: c.run(s * scale * DT, state=start)))  # type: ignore[misc]
    ways.append(
        Contestant(f"NumPy, {CARS} cars", 20 * CARS, lambda: simulate(loop, 20 * DT, state=many, record=["path.e"]))
    )
    for name, collapse in ((MANY, False), (f"{MANY}, collapsed", True)):
        ready = compile(loop, backend="c", record=["path.e"], every=20, collapse=collapse)
        size = 250 * scale
        ways.append(Contestant(name, size * CARS, lambda c=ready, s=size: c.run(s * DT, state=many)))  # type: ignore[misc]
    for way in ways:
        way.run()
    return ways


def require_equal_runs(loop: Loop) -> float:
    """The largest difference in e between others' and steerkit's ways, over 100 samples [m]."""
    start = loop.init()
    reference = simulate(loop, 100 * DT, state=start)["path.e"]
    runs = [python_control.run(make(loop, start), 100) for make in (python_control.two_systems, python_control.diagram)]
    runs += [
        compile(loop, backend=b, record=["path.e"], collapse=c).run(100 * DT, state=start)["path.e"]
        for b in BACKENDS
        for c in (False, True)
    ]
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


def best_rate(run: Callable[[], Any], steps: int, turns: int = 3) -> float:
    """Car-steps a second, best of a few: for scaling within one way."""
    run()
    times = []
    for _ in range(turns):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return steps / min(times)


def scaling(loop: Loop, quick: bool) -> dict[str, Any]:
    """Rates over numbers of cars and of laps, and the memory that 100 laps take."""
    lap = round(course("paper").length / SPEED / DT)
    c = compile(loop, backend="c", record=["path.e"], every=20)
    cars = {}
    for n in (1, 10, 100, 1000) if quick else (1, 10, 100, 1000, 10000):
        start, steps = loop.init(batch=n), max(50, min(20000, 200000 // n))
        cars[n] = best_rate(lambda s=start, k=steps: c.run(k * DT, state=s), n * steps)  # type: ignore[misc]
    one, laps = loop.init(), {}
    for n in (1, 10) if quick else (1, 10, 100):
        laps[n] = best_rate(lambda n=n: c.run(n * lap * DT, state=one), n * lap)  # type: ignore[misc]
    silent = compile(loop, backend="c", record=(), every=lap)
    silent.run(lap * DT, state=one)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    silent.run(100 * lap * DT, state=one)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0
    return {"cars": cars, "laps": laps, "memory_of_100_silent_laps_mb": grown}


def tracked_poses(samples: int, *, tracker: bool) -> Loop:
    """The poses of the loop's first samples, one after the other, with a tracker that looks at them or without."""
    loop = closed_loop()
    seen = loop.blocks["path"]
    drive = compile(loop, backend="c").run(samples * DT)
    poses = Poses(rows=Table(np.column_stack([drive[f"car.{port.name}"] for port in seen.inputs])), dt=DT)
    if not tracker:
        return Loop(blocks={"poses": poses}, wires=[])
    wires = [(getattr(poses, port.name), getattr(seen, port.name)) for port in seen.inputs]
    return Loop(blocks={"poses": poses, "path": seen}, wires=wires)


def block_costs(turns: int) -> dict[str, float]:
    """CPU seconds a step in C: the loop, without the tracker or the actuator, poses with a tracker and without."""
    steps = 4000
    loops = {
        "all": closed_loop(),
        "without tracker": closed_loop(tracker=False),
        "without actuator": closed_loop(actuator=False),
        "poses and tracker": tracked_poses(steps, tracker=True),
        "poses": tracked_poses(steps, tracker=False),
    }
    times: dict[str, list[float]] = {name: [] for name in loops}
    runs = []
    for name, loop in loops.items():
        c = compile(loop, backend="c", record=["poses.x" if name == "poses" else "path.e"])
        runs.append((name, c, loop.init()))
    for turn in range(turns + 1):
        for name, c, start in runs:
            begin = time.thread_time()  # one car runs in one thread, and others on the core only ever add
            c.run(steps * DT, state=start)
            if turn:  # the first is a warm-up
                times[name].append((time.thread_time() - begin) / steps)
    return {name: min(values) for name, values in times.items()}


def first_calls() -> dict[str, float]:
    """First-call seconds of each backend, and of C in a second process that finds the cache."""
    loop = closed_loop()
    costs: dict[str, float] = {}
    for backend in BACKENDS[:2]:
        c = compile(loop, backend=backend)
        c.run(DT)
        costs[backend] = c.first_call_seconds or 0.0
    with tempfile.TemporaryDirectory() as folder:
        code = (
            f"from {__name__} import DT, closed_loop, compile\n"
            "c = compile(closed_loop(), backend='c'); c.run(DT); print(c.first_call_seconds)"
        )
        for name in ("c", "c, second process"):
            done = subprocess.run(
                [sys.executable, "-c", code],
                env={**os.environ, "XDG_CACHE_HOME": folder},
                capture_output=True,
                encoding="utf-8",
                check=True,
            )
            costs[name] = float(done.stdout)
    return costs


def add_options(parser: argparse.ArgumentParser) -> None:
    """It has no options of its own; --quick takes fewer turns and smaller runs."""


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure, and print the tables."""
    warnings.filterwarnings("ignore", message="Unused output")
    loop = closed_loop()
    agreement = require_equal_runs(loop)
    rates = measured(contestants(loop, options.quick), 1 if options.quick else 15)
    against = {base: ratios_to(rates, base) for base in (DIAGRAM, TWO, ONE)}
    ratios = against[DIAGRAM]
    print(f"\n20 Hz control steps a second, {os.cpu_count()} cores; all ways agree to {agreement:.0e} m\n")
    print(f"{'':49}ratio to python-control as\n{'way':34}{'car-steps/s':>14}{'diagram':>10}{'two':>10}{'one':>10}")
    for name, values in rates.items():
        columns = "".join(f"{against[base][name]:10,.1f}" for base in against)
        print(f"{name:34}{statistics.median(values):14,.0f}{columns}")
    result: dict[str, Any] = {
        "interpreted_x": max(ratios["simulate"], ratios["generated Python"]),
        "simulate_x": ratios["simulate"],
        "compiled_vm_x": max(ratios["CasADi VM"], ratios["CasADi VM, collapsed"]),
        "compiled_vm_uncollapsed_x": ratios["CasADi VM"],
        "compiled_c_x": ratios["C"],
        "batch_x": ratios[MANY],
        "batch_linear_x": ratios[f"{MANY}, collapsed"],
        "batch_car_steps_per_second": statistics.median(rates[MANY]),
        "batch_car_steps_per_second_x_one_function": against[ONE][MANY],
        "steps_per_second": {name: statistics.median(values) for name, values in rates.items()},
        "base": DIAGRAM,
        "against": against,
        "largest_difference_m": agreement,
    }
    costs, calls, sizes = block_costs(4 if options.quick else 40), first_calls(), scaling(loop, options.quick)
    result |= {
        "c_step_ns": 1e9 * costs["all"],
        "tracker_ns": 1e9 * (costs["poses and tracker"] - costs["poses"]),
        "tracker_in_loop_ns": 1e9 * (costs["all"] - costs["without tracker"]),
        "actuator_in_loop_ns": 1e9 * (costs["all"] - costs["without actuator"]),
    }
    print(
        "\nin C a step takes {c_step_ns:.0f} ns of CPU time; the path tracker by itself {tracker_ns:.0f}, "
        "in the loop {tracker_in_loop_ns:.0f} more than none".format(**result)
    )
    print("first call [s]: " + ", ".join(f"{name} {seconds:.2f}" for name, seconds in calls.items()))
    print("C, car-steps/s by cars: " + ", ".join(f"{n}: {rate:,.0f}" for n, rate in sizes["cars"].items()))
    print("C, steps/s by laps: " + ", ".join(f"{n}: {rate:,.0f}" for n, rate in sizes["laps"].items()))
    print(f"100 laps without a record take {sizes['memory_of_100_silent_laps_mb']:.1f} MB more than one")
    result |= {"seconds_a_step_in_c": costs, "first_call_seconds": calls, "scaling": sizes}
    print("\n" + "\n".join(f"{n}: {result[n]:,.1f}, wanted {least}" for n, least in NEEDED.items()))
    print("\n".join(f"{n}: {result[n]:,.0f}, wanted at most {most}" for n, most in NEEDED_NS.items()))
    return result
