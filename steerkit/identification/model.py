"""The loop that is fitted: a recorded drive through the plants' own actuator and linear single track."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from steerkit.compiled import Compiled, compile
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Scalar
from steerkit.logs.drive import Array, Drive
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.playback import Playback
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.vehicles import Vehicle

OPEN = {
    "steer_ratio": "car.vehicle.steer_ratio",
    "delay": "drive.delay",
    "lag": "actuator.lag",
    "offset": "actuator.offset",
}
"""Parameters that are fields of blocks."""
_SLOW_ENOUGH = 0.01  # [s], a step at which every car within the bounds is integrated stably


def stiffnesses(base: Vehicle, d_f: Scalar, d_r: Scalar) -> tuple[Scalar, Scalar]:
    """(c_f, c_r) [N/rad] of cornering compliances d_f, d_r [rad s^2/m]: c_f = m l_r/(L d_f), c_r = m l_f/(L d_r).

    A compliance is the slip angle of an axle per lateral acceleration, and K = d_f - d_r.
    Source: Bundorf, Leffert 1976 (in degrees per g).
    """
    per = base.m / base.wheelbase
    return per * base.l_r / d_f, per * base.l_f / d_r


class Simulator:
    """Yaw rates of the model for a drive's steering and speed; compiled once, then run for any parameters.

    The delay is that of continuous time: what the sampled loop adds by holding its signals is taken off.
    steering and speed: recorded; model: `Playback`, `SteeringActuator`, `LinearSingleTrack`. backend: see `compile`.
    """

    def __init__(self, drive: Drive, base: Vehicle, *, backend: Any = "auto"):
        self.drive, self.base = drive, base
        play = Playback(angles=tuple(drive.delta_sw.tolist()), speeds=tuple(drive.v.tolist()), dt=drive.dt)
        # the wheel may turn as fast as it was recorded to turn: no rate limit acts
        actuator = SteeringActuator(limit=30.0, rate_limit=200.0, dt=drive.dt)
        substeps = math.ceil(drive.dt / _SLOW_ENOUGH - 1e-9)
        car = LinearSingleTrack(vehicle=base, dt=drive.dt, substeps=substeps, v0=float(drive.v[0]))
        loop = Loop(
            blocks={"drive": play, "actuator": actuator, "car": car},
            wires=[(play.delta_sw, actuator.delta_sw_cmd), (actuator.delta_sw, car.delta_sw_cmd), (play.v, car.v_cmd)],
        )
        names = (*OPEN.values(), "car.vehicle.c_f", "car.vehicle.c_r")
        self.loop = loop
        self._compiled: Compiled = compile(loop, backend=backend, record=["car.r"], parameters=names)

    def yaw_rates(self, sets: list[dict[str, float]]) -> Array:
        """Yaw rate (n, len(sets)) [rad/s] for each set of steer_ratio, delay, lag, offset, d_f, d_r."""
        each = {name: np.array([one[name] for one in sets]) for name in sets[0]}
        c_f, c_r = stiffnesses(self.base, each["d_f"], each["d_r"])
        values = {field: each[name] for name, field in OPEN.items()}
        values["drive.delay"] = each["delay"] - self.drive.dt  # actuator and car hold their inputs: dt/2 late each
        values |= {"car.vehicle.c_f": c_f, "car.vehicle.c_r": c_r}
        log = self._compiled.run(len(self.drive.v) * self.drive.dt, parameters=values)
        return log["car.r"]
