"""Environment steps in a second of computing: one car and many, each backend, beside Gymnasium's own vectors.

    python -m benchmarks study gym_steps [--conditions hard] [--quick] [--json]

A step is a decision (20 a second of driving): 5 ticks of the loop and one look, with rewards, ends, infos and starts.
With random actions an episode lasts a second or two; "driven well" holds the wheel on a straight in the place of a good
driver, so that episodes last 5 s. The table is of CPU time of this process. The figures below it are of the clock on
the wall, with a thread a core and 1,024 cars driven well: Gymnasium's vector as `make_vec` gives it, the same without
copies, the batch in place, and Gymnasium's own SyncVectorEnv of as many.
"""

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

import steerkit.gym  # noqa: F401
from steerkit._support import native
from steerkit.gym.episodes import Episodes
from steerkit.gym.task import Task
from steerkit.scenario import CONDITIONS

ID = "steerkit/TrackSteering-v0"
HOLD = 0
WIDE = 1024


def one(task: dict[str, Any], *, random: bool) -> Callable[[int], int]:
    """Runs so many steps of one car; returns how many."""
    env = gymnasium.make(ID, **task)
    rng = np.random.default_rng(0)
    env.reset(seed=0)

    def run(steps: int) -> int:
        for action in rng.integers(0, 5, steps).tolist() if random else [HOLD] * steps:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return steps

    return run


def many(cars: int, task: dict[str, Any], *, random: bool) -> Callable[[int], int]:
    """Runs about so many steps of a vector of cars; returns how many."""
    env = gymnasium.make_vec(ID, cars, **task)
    rng = np.random.default_rng(0)
    env.reset(seed=0)

    def run(steps: int) -> int:
        rows = max(20, steps // cars)
        for _ in range(rows):
            env.step(rng.integers(0, 5, cars) if random else np.full(cars, HOLD))
        return rows * cars

    return run


def in_buffers(cars: int, task: dict[str, Any]) -> Callable[[int], int]:
    """Runs about so many steps of the batch itself, in its arrays; returns how many."""
    options = Task.of(task)
    batch = Episodes(options, cars, AutoresetMode.SAME_STEP)
    generators = [np.random.default_rng(i) for i in range(cars)]
    batch.draw_from(generators)
    batch.start(np.arange(cars), [options.draw(generator) for generator in generators])

    def run(steps: int) -> int:
        rows = max(20, steps // cars)
        for _ in range(rows):
            batch.step(options.angle(np.full(cars, HOLD), (cars,)))
        return rows * cars

    return run


def rate(
    run: Callable[[int], int], seconds: float, steps: int = 200, clock: Callable[[], float] = time.process_time
) -> float:
    """Steps a second of CPU time, or of another clock."""
    begin, done = clock(), 0
    while clock() - begin < seconds:
        done += run(steps)
    return done / (clock() - begin)


def on_the_wall(cars: int, task: dict[str, Any], *, quick: bool) -> dict[str, float]:
    """Steps a second of all cores: by name, the best of turns."""
    ways = {
        "vector": many(cars, task | {"backend": "c"}, random=False),
        "vector, copy=False": many(cars, task | {"backend": "c", "copy": False}, random=False),
        "batch in place": in_buffers(cars, task),
        "SyncVectorEnv": many(cars, task | {"vectorization_mode": "sync"}, random=False),
    }
    best = dict.fromkeys(ways, 0.0)
    for _ in range(1 if quick else 12):
        for name, run in ways.items():
            best[name] = max(best[name], rate(run, 0.02 if quick else 0.3, 20 * cars, time.perf_counter))
    return best


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options."""
    parser.add_argument("--conditions", default="clean", choices=["clean", "hard"])


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure every way in turns, and print the table."""
    backends = ["python", "c"] if native.compiler() else ["python"]
    ways: list[tuple[str, Callable[..., Callable[[int], int]]]] = []
    for backend in backends:
        ways.append((f"1 car, {backend}", lambda o, random, b=backend: one(o | {"backend": b}, random=random)))
    for cars in (4,) if options.quick else (16, 256, 1024):
        sync = {"vectorization_mode": "sync"}
        ways.append((f"{cars} cars, SyncVectorEnv", lambda o, random, n=cars, k=sync: many(n, o | k, random=random)))
        for backend in backends:
            ways.append(
                (
                    f"{cars} cars, {backend}",
                    lambda o, random, n=cars, b=backend: many(n, o | {"backend": b}, random=random),
                )
            )
    runs = {
        "random actions": {"conditions": options.conditions},
        "driven well": {
            "scenario": {"course": "straight", **CONDITIONS[options.conditions]},
            "start_e": 0.0,
            "start_psi_e": 0.0,
            "start": "beginning",
            "duration": 5.0,
        },
    }
    wide, well = (8 if options.quick else WIDE), runs["driven well"]
    wall = on_the_wall(wide, well, quick=options.quick) if native.compiler() else {}
    contestants = {
        (name, kind): make(options, kind == "random actions") for name, make in ways for kind, options in runs.items()
    }
    best: dict[tuple[str, str], float] = dict.fromkeys(contestants, 0.0)
    for _ in range(1 if options.quick else 6):  # in turns, the best of each: others use this machine too
        for key, run in contestants.items():
            best[key] = max(best[key], rate(run, 0.05 if options.quick else 0.2))
    result: dict[str, Any] = {"conditions": options.conditions, "steps_per_cpu_second": {}}
    print(f"{'way':28}" + "".join(f"{name:>20}" for name in runs) + "   env steps a second of CPU time")
    for name, _ in ways:
        rates = {kind: best[name, kind] for kind in runs}
        result["steps_per_cpu_second"][name] = rates
        print(f"{name:28}" + "".join(f"{value:20,.0f}" for value in rates.values()))
    if wall:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        print(f"\n{wide:,} cars driven well, {cores} cores, env steps a second of the clock")
        for name, value in wall.items():
            print(f"{name:28}{value:20,.0f}")
        result |= {"vector_cars": wide, "cores": cores, "vector_steps_per_second": wall["vector"]}
        result |= {"in_place_steps_per_second": wall["batch in place"]}
        result |= {"x_sync_vector_env": wall["vector"] / wall["SyncVectorEnv"]}
    return result
