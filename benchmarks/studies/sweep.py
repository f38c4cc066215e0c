"""A sweep of 1,000 gains: the time for as many drives of 60 s, compiled, and what the compiler takes besides.

The nonlinear car, in steps of 10 ms, drives the 795 m course at 6 m/s under Stanley, with
0.2 s of steering delay and 1,000 values of Stanley's gain k; four metrics of each drive.

    python -m benchmarks study sweep [--quick] [--json]

`seconds` is the call of `sweep` with the program in the compiler's cache, the median of `--turns` calls;
`compile_seconds` what the first call of a loop that was never compiled takes longer.
"""

import argparse
import os
import statistics
import time
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.tables import as_line, show_figures
from steerkit import NonlinearSingleTrack, Stanley, SteeringActuator, course, placed, steering_loop, sweep, vehicle
from steerkit.diagram.loop import Loop
from steerkit.plants.speed_driver import ConstantSpeed

SPEED, SECONDS, WANTED = 6.0, 60.0, 2.0


def the_loop() -> Loop:
    """The loop: car and actuator in steps of 10 ms, the controller in steps of 50 ms."""
    path, passat = course("paper"), vehicle("vw-passat")
    passat = replace(passat, m=passat.m + 1e-3 * (time.time() % 1.0))  # a program that no cache has
    return steering_loop(
        car=placed(NonlinearSingleTrack(vehicle=passat, v0=SPEED), path),
        path=path,
        driver=ConstantSpeed(speed=SPEED),
        actuator=SteeringActuator(delay=0.2),
        controller=Stanley.of(passat),
        reference=passat.l_f,
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """How often."""
    parser.add_argument("--turns", type=int, default=9, help="calls timed")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure, and print."""
    gains = np.geomspace(0.3, 12.0, 20 if options.quick else 1000)
    seconds, turns = (5.0, 1) if options.quick else (SECONDS, options.turns)
    loop, times = the_loop(), []
    for _ in range(turns + 1):
        begin = time.perf_counter()
        found = sweep(loop, {"controller.k": gains}, seconds)
        times.append(time.perf_counter() - begin)
    warm, best = statistics.median(times[1:]), found.best("rms_e")
    figures = {
        "gains": len(gains),
        "drive_seconds": seconds,
        "seconds": warm,
        "compile_seconds": times[0] - warm,
        "best": best,
        "cores": os.cpu_count(),
    }
    show_figures(figures)
    print(f"wanted: at most {WANTED:g} s; best: {as_line(best)}")
    return figures
