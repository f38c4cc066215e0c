"""Environment steps in a second of computing: one car and many, each backend, beside Gymnasium's own vectors.

    python -m benchmarks study gym_steps [--conditions hard] [--quick] [--json]

A step is a decision (20 a second of driving): 5 ticks of the loop and one look, with rewards, ends, infos and starts.
With random actions an episode lasts a second or two, and starts are a good part of the work; "driven well" holds the
wheel on a straight in the place of a good driver, so that episodes last 5 s. CPU time of this process.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

import steerkit.gym  # noqa: F401
from steerkit import native
from steerkit.scenario import CONDITIONS

ID = "steerkit/TrackSteering-v0"
HOLD = 0


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


def rate(run: Callable[[int], int], seconds: float) -> float:
    """Steps a second of CPU time."""
    begin, steps = time.process_time(), 0
    while time.process_time() - begin < seconds:
        steps += run(200)
    return steps / (time.process_time() - begin)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options."""
    parser.add_argument("--conditions", default="clean", choices=["clean", "hard"])


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure every way in turns, and print the table."""
    backends = ["python", "c"] if native.compiler() else ["python"]
    ways: list[tuple[str, Callable[..., Callable[[int], int]]]] = []
    for backend in backends:
        ways.append((f"1 car, {backend}", lambda o, random, b=backend: one(o | {"backend": b}, random=random)))
    for cars in (4,) if options.quick else (16, 256):
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
    return result
