"""Environment steps in a second of computing: one car and many, each backend, beside Gymnasium's own vectors.

    python -m benchmarks study gym_steps [--conditions hard] [--quick] [--json]

A step is a decision (20 a second of driving): 5 ticks of the loop and one look, with rewards, ends, infos and starts.
The wheel is held on a straight, in the place of a good driver, so that episodes last 5 s. The table is of CPU time of
this process. The figures below it are of the clock on the wall, with a thread a core and 1,024 cars: the vector as
`make_vec` gives it, and Gymnasium's own SyncVectorEnv of as many.
"""

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

import steerkit.gym  # noqa: F401
from benchmarks.tables import show
from steerkit._support import native
from steerkit.scenario import CONDITIONS

ID = "steerkit/TrackSteering-v0"
HOLD = 0
WIDE = 1024
SYNC = {"vectorization_mode": "sync"}
"""Gymnasium's own vector."""


def one(task: dict[str, Any]) -> Callable[[int], int]:
    """Runs so many steps of one car; returns how many."""
    env = gymnasium.make(ID, **task)
    env.reset(seed=0)

    def run(steps: int) -> int:
        for _ in range(steps):
            _, _, terminated, truncated, _ = env.step(HOLD)
            if terminated or truncated:
                env.reset()
        return steps

    return run


def many(cars: int, task: dict[str, Any]) -> Callable[[int], int]:
    """Runs about so many steps of a vector of cars; returns how many."""
    env = gymnasium.make_vec(ID, cars, **task)
    env.reset(seed=0)

    def run(steps: int) -> int:
        rows = max(20, steps // cars)
        for _ in range(rows):
            env.step(np.full(cars, HOLD))
        return rows * cars

    return run


def best_of(
    ways: dict[str, Callable[[int], int]],
    turns: int,
    seconds: float,
    steps: int = 200,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, float]:
    """The most steps a second of CPU time, or of another clock, of each way, in turns: others use this machine too."""
    best = dict.fromkeys(ways, 0.0)
    for _ in range(turns):
        for name, run in ways.items():
            begin, done = clock(), 0
            while clock() - begin < seconds:
                done += run(steps)
            best[name] = max(best[name], done / (clock() - begin))
    return best


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options."""
    parser.add_argument("--conditions", default="clean", choices=["clean", "hard"])


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure every way in turns, and print the table."""
    backends = ["python", "c"] if native.compiler() else ["python"]
    task = {
        "scenario": {"course": "straight", **CONDITIONS[options.conditions]},
        "start_e": 0.0,
        "start_psi_e": 0.0,
        "start": "beginning",
        "duration": 5.0,
    }
    wide, wall = 8 if options.quick else WIDE, dict[str, float]()
    if native.compiler():
        both = {"vector": many(wide, task | {"backend": "c"}), "SyncVectorEnv": many(wide, task | SYNC)}
        turns, seconds = (1, 0.02) if options.quick else (12, 0.3)
        wall = best_of(both, turns, seconds, 20 * wide, time.perf_counter)
    ways = {f"1 car, {backend}": one(task | {"backend": backend}) for backend in backends}
    for cars in (4,) if options.quick else (16, WIDE):
        ways[f"{cars} cars, SyncVectorEnv"] = many(cars, task | SYNC)
        for backend in backends:
            ways[f"{cars} cars, {backend}"] = many(cars, task | {"backend": backend})
    best = best_of(ways, 1 if options.quick else 6, 0.05 if options.quick else 0.2)
    result: dict[str, Any] = {"conditions": options.conditions, "steps_per_cpu_second": best}
    show("", [{"env steps": name, "a second of CPU time": f"{value:,.0f}"} for name, value in best.items()])
    if wall:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        show(f"{wide:,} cars, {cores} cores", [{"": name, "a second": f"{value:,.0f}"} for name, value in wall.items()])
        result |= {"vector_cars": wide, "cores": cores, "vector_steps_per_second": wall["vector"]}
        result |= {"x_sync_vector_env": wall["vector"] / wall["SyncVectorEnv"]}
    return result
