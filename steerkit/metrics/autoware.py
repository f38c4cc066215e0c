"""The figures that Autoware's control evaluator publishes of a drive, under its names, for comparison with its logs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from steerkit.metrics.signals import samples, step

PERIOD = 0.1
"""Autoware's evaluator looks every 100 ms [s]."""
LEFT_OUT = (
    "left_boundary_distance",
    "right_boundary_distance",
    "left_uncrossable_boundary_distance",
    "right_uncrossable_boundary_distance",
    "stop_deviation",
    "stop_deviation_abs",
    "closest_object_distance",
    "longitudinal_velocity_deviation",
)
"""What it also publishes and a steering drive does not have: lane boundaries, stop lines, objects, a speed plan."""


@dataclass(frozen=True)
class Accumulated:
    """Least, greatest and mean value of a figure over the samples, as Autoware's evaluator writes at its end."""

    min: float
    max: float
    mean: float
    count: int


def control_evaluator(
    t: ArrayLike, *, e: ArrayLike, psi_e: ArrayLike, delta: ArrayLike, a_y: ArrayLike, v: ArrayLike
) -> dict[str, Accumulated]:
    """Autoware's figures of a drive by its names, from samples 100 ms apart (or the record's own, if slower).

    t (T,) [s], even; e [m], psi_e [rad], delta [rad] road-wheel angle, a_y [m/s^2], v [m/s], each (T,); signs as here
    (ISO 8855), which are Autoware's. lateral_acceleration is a magnitude; acceleration and jerk are longitudinal, from
    differences of v; rates are differences of neighbouring looks. In m, rad, s. Left out: `LEFT_OUT`.
    Raises ValueError for signals of other lengths, uneven t or less than three looks.
    Source: autoware_universe, evaluator/autoware_control_evaluator (2025), metric.hpp and control_evaluator_node.cpp.
    """
    signals = {"e": e, "psi_e": psi_e, "delta": delta, "a_y": a_y, "v": v}
    dt = min(step(t, f"control_evaluator: {name}", signal) for name, signal in signals.items())
    every = max(1, round(PERIOD / dt))
    seen = {name: samples(name, signal)[::every] for name, signal in signals.items()}
    look = every * dt
    if len(seen["e"]) < 3:
        raise ValueError(f"control_evaluator: {len(seen['e'])} looks {look:g} s apart, expected at least 3")
    rate, acceleration = np.diff(seen["delta"]) / look, np.diff(seen["v"]) / look
    figures = {
        "velocity": seen["v"],
        "acceleration": acceleration,
        "jerk": np.diff(acceleration) / look,
        "lateral_acceleration": np.abs(seen["a_y"]),
        "lateral_deviation": seen["e"],
        "lateral_deviation_abs": np.abs(seen["e"]),
        "yaw_deviation": seen["psi_e"],
        "yaw_deviation_abs": np.abs(seen["psi_e"]),
        "steering_angle": seen["delta"],
        "steering_angle_abs": np.abs(seen["delta"]),
        "steering_rate": rate,
        "steering_acceleration": np.diff(rate) / look,
    }
    return {name: accumulated(values) for name, values in figures.items()}


def goal_deviation(pose: tuple[float, float, float], goal: tuple[float, float, float]) -> dict[str, float]:
    """How far a pose x, y [m], psi [rad] is ahead [m], to the left [m] and turned left [rad] of a goal pose.

    Names as Autoware's, with `_abs` for magnitudes; it counts them only where the car stands within 3 m of the goal,
    which is for the caller to know. Source: as `control_evaluator`.
    """
    dx, dy, turned = pose[0] - goal[0], pose[1] - goal[1], math.remainder(pose[2] - goal[2], 2.0 * math.pi)
    c, s = math.cos(goal[2]), math.sin(goal[2])
    signed = {
        "goal_longitudinal_deviation": c * dx + s * dy,
        "goal_lateral_deviation": c * dy - s * dx,
        "goal_yaw_deviation": turned,
    }
    return signed | {f"{name}_abs": abs(value) for name, value in signed.items()}


def accumulated(values: Any) -> Accumulated:
    """min, max, mean and count of the values."""
    return Accumulated(float(np.min(values)), float(np.max(values)), float(np.mean(values)), len(values))
