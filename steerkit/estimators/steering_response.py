"""What an angle of the steering comes to: behind lag and dead time, then as the yaw rate of the data sheet's car."""

import math
from collections.abc import Sequence

from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.maths import Scalar
from steerkit.vehicles import Vehicle

SLOWEST = 3.0
"""Speed [m/s] from which on samples are used; slower, plants and cars roll, and noise is all there is."""


def at(number: Scalar, values: Sequence[Scalar]) -> Scalar:
    """The value of that number, rounded half down; the first or the last where there is none."""
    if isinstance(number, float) and math.isfinite(number):  # one car
        return values[min(max(math.ceil(number - 0.5), 0), len(values) - 1)]
    picked = values[0]
    for i in range(1, len(values)):
        picked = m.where(number > i - 0.5, values[i], picked)
    return picked


def arrived(
    line: State, command: Scalar, delay: Scalar, lag: Scalar, dt: float, *, held: bool
) -> tuple[State, tuple[Scalar, Scalar, Scalar]]:
    """The line a sample later, and how the angle that arrives goes on in it: one way to a corner, then another.

    The corner [rad] is where the angle on its way was a whole number of samples old, as a held command changes only
    there; then the share of the sample until it [1], and the angle at the sample's end [rad].

    line: the angle behind the lag, now and at the samples before, newest first; command: the angle of now. The lag [s]
    is exact where that is `held` for dt [s]; between samples then goes what arrives, too:

        angle(t + s) = x(t) + (x(t + dt) - x(t)) (1 - exp(-s/lag))/(1 - exp(-dt/lag)),  0 <= s <= dt,

    else in a line. The delay [s] is cut to the line's length. The way has no extremum before its corner, nor after.
    """
    keep = m.exp(-dt / m.maximum(lag, 1e-3))
    lagged = command + (line[0] - command) * keep
    line = (lagged, *line[:-1])
    place = m.clip(delay / dt, 0.0, len(line) - 1.0)
    entry = m.floor(place)
    first = place - entry
    newer, older = at(entry, line), at(m.minimum(entry + 1.0, len(line) - 1.0), line)
    share = (1.0 - m.exp(-(1.0 - first) * dt / m.maximum(lag, 1e-3))) / (1.0 - keep) if held else 1.0 - first
    return line, (older, first, older + share * (newer - older))


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
