"""How a car's yaw rate answers its wheel, as its data sheet has it: what estimators take for known."""

from __future__ import annotations

from steerkit.diagram.maths import Scalar
from steerkit.vehicles import Vehicle

SLOWEST = 3.0
"""Speed [m/s] from which on a car tells of its steering; slower, plants and cars roll, and noise is all there is."""


def steady_gain(p: Vehicle, v: Scalar) -> Scalar:
    """Steady yaw rate over steering-wheel angle [1/s] at v [m/s]: v/(n (L + K v^2))."""
    return v / (p.steer_ratio * (p.wheelbase + p.understeer_gradient * v * v))


def yaw_delay(p: Vehicle, v: Scalar) -> Scalar:
    """By how much the yaw rate of the linear single track is behind a slow wheel at v [m/s]: seconds.

    The slope of its phase at frequency 0, 2 D/omega_0 - T_z; source: Mitschke, Wallentowitz 2014, ch. 20.
    """
    turn = p.c_r * p.l_r - p.c_f * p.l_f
    damped = (p.c_f + p.c_r) * p.i_z + (p.c_f * p.l_f**2 + p.c_r * p.l_r**2) * p.m
    poles = damped * v / (p.c_f * p.c_r * p.wheelbase**2 + p.m * v * v * turn)
    return poles - p.m * p.l_f * v / (p.c_r * p.wheelbase)


def yaw_step(p: Vehicle, beta: Scalar, r: Scalar, delta: Scalar, v: Scalar, dt: float) -> tuple[Scalar, Scalar]:
    """(beta, r) of the linear single track dt [s] later, its front wheels held at delta [rad]: the trapezoidal rule.

    v [m/s], SLOWEST at least. Stable at any dt; exact at low frequency.
    """
    h = 0.5 * dt
    turn = p.c_r * p.l_r - p.c_f * p.l_f
    a11, a12 = -(p.c_f + p.c_r) / (p.m * v), turn / (p.m * v * v) - 1.0
    a21, a22 = turn / p.i_z, -(p.c_f * p.l_f**2 + p.c_r * p.l_r**2) / (p.i_z * v)
    rate_beta = a11 * beta + a12 * r + p.c_f / (p.m * v) * delta
    rate_r = a21 * beta + a22 * r + p.c_f * p.l_f / p.i_z * delta
    one, two = 1.0 - h * a11, 1.0 - h * a22
    det = one * two - h * h * a12 * a21
    beta = beta + dt * (two * rate_beta + h * a12 * rate_r) / det
    return beta, r + dt * (h * a21 * rate_beta + one * rate_r) / det
