"""A linear single track through the manoeuvres of vehicle testing: what its figures are, and what instruments show."""

import math
from dataclasses import replace

import numpy as np

from steerkit import LinearSingleTrack, Scenario
from steerkit.proving.runs import Run
from steerkit.vehicles import Vehicle

NOISE = {"r": math.radians(0.1), "a_y": 0.05, "delta_sw": math.radians(0.1), "beta": math.radians(0.1), "v": 0.02}
"""Standard deviation of each signal's white noise at 100 Hz, in SI."""


def linear(name: str) -> Scenario:
    """A car as a linear single track, steered without lag."""
    return Scenario(vehicle={"name": name, "plant": "linear"}, steering={"lag": 0.0})


def closed_forms(car: Vehicle, v: float) -> dict[str, float]:
    """What a linear single track's steady and frequency-domain figures are, by theory."""
    a, _ = (np.array(part) for part in LinearSingleTrack(vehicle=car).matrices(v))
    natural = math.sqrt(np.linalg.det(a))
    margin = (car.c_r * car.l_r - car.c_f * car.l_f) / ((car.c_f + car.c_r) * car.wheelbase)
    return {
        "understeer_gradient": float(car.understeer_gradient),
        "yaw_gain": float(v / (car.wheelbase + car.understeer_gradient * v * v) / car.steer_ratio),
        "natural_frequency": natural / (2.0 * math.pi),
        "damping": float(-np.trace(a) / (2.0 * natural)),
        "static_margin": float(margin),
    }


def noisy(run: Run, random: np.random.Generator) -> Run:
    """The run as instruments would have it."""
    signals = {
        name: values + NOISE.get(name, 0.0) * random.standard_normal(len(values))
        for name, values in run.signals.items()
    }
    return replace(run, signals=signals)
