"""A car steered along a path, or a straight road, with a slow actuator."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from steerkit.controllers.delay import delayed_stanley
from steerkit.diagram.loop import Loop
from steerkit.paths.courses import straight
from steerkit.paths.path import Path
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed, Playback
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.task import DT
from steerkit.vehicles import VW_PASSAT as PASSAT

ROAD = straight(400.0)


def looped(controller: Any, path: Path, v: float, delay: float, *, car: Any = None, **parts: Any) -> Loop:
    """A car at that speed, behind a motor with that delay and 0.1 s of lag; parts: others, and where it starts."""
    start = {name: parts.pop(name) for name in ("s", "e", "psi_e") if name in parts}
    standard = {
        "driver": ConstantSpeed(speed=v),
        "actuator": SteeringActuator(delay=delay, lag=0.1),
        "reference": PASSAT.l_f,
    }
    plant = placed(car or LinearSingleTrack(vehicle=PASSAT, v0=v), path, **start)
    return steering_loop(car=plant, path=path, controller=controller, **standard | parts)


def recorded_speed(speeds: Sequence[float], spacing: float) -> Playback:
    """A driver with these speeds [m/s] every `spacing` [s], linear in between, who does not steer."""
    at = spacing * np.arange(len(speeds))
    t = np.linspace(0.0, at[-1], round(at[-1] / DT) + 1)
    return Playback(angles=(0.0,) * len(t), speeds=tuple(np.interp(t, at, speeds).tolist()), dt=DT)


def steered(v: float = 6.0, controller: Any = None, delay: float = 0.2, **parts: Any) -> Loop:
    return looped(controller or delayed_stanley(PASSAT, delay=delay, lag=0.1), ROAD, v, delay, s=20.0, **parts)
