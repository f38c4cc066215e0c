"""Made-up recordings of a car whose parameters are known."""

from dataclasses import replace
from typing import Any

import numpy as np

from steerkit import simulate
from steerkit.diagram.loop import Loop
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import Playback
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.vehicles import VW_PASSAT as BASE
from steerkit.vehicles import Vehicle

TRUE = replace(BASE, name="true", steer_ratio=14.2, c_f=150e3, c_r=210e3)
TRUTH = dict(steer_ratio=14.2, delay=0.07, lag=0.09, delay_lag=0.16, offset=-0.03, c_f=150e3, c_r=210e3)
TRUTH["understeer_gradient"] = TRUE.understeer_gradient
"""The actuator delays by 0.06 s, and at dt = 0.01 s actuator and car hold their inputs, dt/2 late each."""
DT = 0.02


def steering(t: np.ndarray, v: np.ndarray, seed: int = 0) -> np.ndarray:
    """A wandering wheel: a sum of sines from 0.03 to 1 Hz, calmer at speed."""
    rng = np.random.default_rng(seed)
    waves = [
        a * np.sin(2.0 * np.pi * f * t + p)
        for f, a, p in zip(np.geomspace(0.03, 1.0, 14), np.geomspace(1.0, 0.25, 14), rng.uniform(0, 6, 14))
    ]
    return np.sum(waves, axis=0) * 3.0 / np.maximum(v, 4.0)


def driven(car: Vehicle = TRUE, seconds: float = 90.0, *, v_low: float = 5.0, v_high: float = 22.0) -> dict[str, Any]:
    """Columns of a drive without noise: the interpreted loop, at twice the rate of the log."""
    t = np.arange(round(seconds / 0.01)) * 0.01
    v = 0.5 * (v_low + v_high) - 0.5 * (v_high - v_low) * np.cos(2.0 * np.pi * t / 60.0)
    angle = steering(t, v)
    play = Playback(angles=tuple(angle.tolist()), speeds=tuple(v.tolist()), dt=0.01)
    motor = SteeringActuator(delay=0.06, lag=0.09, offset=-0.03, limit=30.0, rate_limit=200.0, dt=0.01)
    plant = LinearSingleTrack(vehicle=car, v0=float(v[0]))
    loop = Loop(
        blocks={"drive": play, "actuator": motor, "car": plant},
        wires=[(play.delta_sw, motor.delta_sw_cmd), (motor.delta_sw, plant.delta_sw_cmd), (play.v, plant.v_cmd)],
    )
    log = simulate(loop, seconds, record=["drive.delta_sw", "drive.v", "car.r", "car.psi"], every=2)
    signals = {name.split(".")[1]: log[name] for name in ("drive.delta_sw", "drive.v", "car.r", "car.psi")}
    return {"t": log.t} | signals


def noisy(columns: dict[str, Any], seed: int, *, white: float = 0.004, slow: float = 0.003) -> dict[str, Any]:
    """With white noise and slow drift (5 s), as of a gyro and a cambered road, on the yaw rate."""
    rng = np.random.default_rng(seed)
    keep, drift = np.exp(-DT / 5.0), [0.0]
    for n in rng.normal(size=len(columns["t"]) - 1):
        drift.append(keep * drift[-1] + np.sqrt(1.0 - keep**2) * slow * n)
    return columns | {"r": columns["r"] + white * rng.normal(size=len(drift)) + drift}


def by_rate(columns: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in columns.items() if key != "psi"}
