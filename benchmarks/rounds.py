"""Rounds of a course that studies drive: many cars at once, compiled, or one after the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from steerkit.compiled import compile
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, simulate
from steerkit.paths.courses import course
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario import Scenario
from steerkit.scenario.assembly import placed
from steerkit.scenario.catalogue import DesignModel
from steerkit.scenario.drive import assembled
from steerkit.vehicles import vehicle

CAR = vehicle("vw-passat")
LAG = 0.1
"""Time constant of the steering in all drives [s]."""


def drive_loop(
    controller: Block,
    *,
    name: str = "paper",
    delay: float = 0.0,
    lag: float = LAG,
    v_min: float = 4.0,
    v_max: float = 9.0,
    seed: int = 0,
    e: float = 0.0,
) -> Loop:
    """A nonlinear car on a course, whose human slows to 3 m/s^2 for bends; e [m] is judged where the controller has it.

    At 9 m/s the course's hairpin (5.9 m) would be 13.7 m/s^2, more than tyres can do: hence the careful human.
    """
    scenario = Scenario(name="study", course=name, delay=delay, lag=lag, v_min=v_min, v_max=v_max, reference="own")
    loop = assembled(scenario, controller, seed=seed)
    return loop.with_block("car", placed(scenario.car(scenario.path()), scenario.path(), e=e))


def reference_of(controller: Block) -> float:
    """Where a controller has its errors measured, metres ahead of the centre of gravity; 0 if it does not say."""
    return float(getattr(controller, "reference", 0.0))


RECORD = ["path.e", "path.progress", "car.a_y", "actuator.rate"]


def driven(loop: Loop, seconds: float, parameters: Mapping[str, Any] | None = None) -> Log:
    """A log of the course's samples (20 a second), of as many cars as `parameters` have entries; (T, N) signals."""
    run = compile(loop, record=RECORD, every=5, parameters=list(parameters or {}))
    return run.run(seconds, parameters=parameters, allow_nonfinite=True)


def interpreted(loop: Loop, seconds: float) -> Log:
    """The same of one car, sample by sample: for controllers that cannot be compiled."""
    return simulate(loop, seconds, record=RECORD, every=5, allow_nonfinite=True)


def on_course(log: Log, length: float) -> Any:
    """Which samples belong to the first round, (T,) or (T, N)."""
    return np.maximum.accumulate(log["path.progress"]) < length


def worst(log: Log, length: float) -> Any:
    """Largest |e| of the first round [m]; infinite where a NaN came up or the round was not finished."""
    within, e = on_course(log, length), np.abs(log["path.e"])
    largest = np.where(within, e, 0.0).max(axis=0)
    return np.where(np.isfinite(largest) & ~within[-1], largest, np.inf)


def rms(log: Log, signal: str, length: float) -> Any:
    """Root mean square of a signal over the first round."""
    within = on_course(log, length)
    return np.sqrt(np.where(within, log[signal], 0.0).__pow__(2).sum(axis=0) / np.maximum(within.sum(axis=0), 1))


def design_model(*, delay: float, name: str = "paper") -> DesignModel:
    """What controllers are told: this car, the course of that name, the steering's delay [s] and lag."""
    return DesignModel(vehicle=CAR, path=course(name), delay=delay, lag=LAG, hold=SteeringActuator.dt)
