"""What a gate before the bus makes of commands, for those who look ahead: how fast the wheel may be, and how slow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from steerkit._support.errors import require_within
from steerkit.diagram import maths as m
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import A_Y_MAX, JERK_MAX, STOP

BEHIND_GATE: Mapping[str, float] = MappingProxyType({"hold": 4, "horizon": 2.0, "preview_points": 26})
"""How far a safety filter looks ahead where a gate makes the wheel slow: at 3 m/s^2 and 5 m/s^3 it takes 1.2 s from one
side to the other. A command is held for less: in 0.4 s the gate turns the wheel by 2 m/s^2, and as long back."""


@dataclass(frozen=True, kw_only=True)
class GateModel:
    """The bounds of a gate that makes the wheel slow, for a roll-out of a car that is pushed to the left.

    A gate bounds the angle, its rate, and what the car would feel: kappa = tan(delta_sw/steer_ratio)/L within
    a_y_max/v^2, |dkappa/dt| <= jerk_max/v^2, and while |kappa| grows |v^2 kappa + v arm dkappa/dt| <= a_y_max. It works
    frame by frame and rounds each frame, at a speed that it knows a little differently. `pushed` is where the wheel's
    command gets within a sample at the most, seen from the left; in the mirror the same serves the right.

        to the left    turn = jerk_max/v^2,   share = 1 - exp(-v h/arm),   h = dt (and a frame, for the first sample)
        to the right   turn = jerk_max/w^2 - lost,   share = 1/(1 + arm/(w dt)),   w = v + v_doubt
        lost           quantum/(frame_dt steer_ratio L), what rounding may cost, with 1 + (L kappa)^2
        kappa          within -turn dt and turn h of where it was, and by `share` of what is left to +-a_y_max/v^2

    The shares are those of frames that are infinitely short, and as long as a sample: those of the gate lie between. A
    last frame that is not due yet is left to whoever takes commands to be late. NaN in any input gives NaN.
    Raises ValueError for values out of range. Source: the bounds are the gate's; ExcursionPredictor's equation for the
    way back.
    """

    a_y_max: float = A_Y_MAX
    """Largest lateral acceleration that the gate allows [m/s^2]."""
    jerk_max: float = JERK_MAX
    """Its fastest change [m/s^3]."""
    rate_max: float = radians_of(550.0)
    """Fastest steering wheel [rad/s]."""
    delta_sw_max: float = STOP
    """Largest |delta_sw| [rad]."""
    v_floor: float = 1.0
    """Slowest speed that the bounds reckon with [m/s]."""
    v_doubt: float = 0.2
    """By how much faster than told the gate may take the car to be [m/s]: the faster of two sources counts."""
    steer_ratio: float = 15.6
    """Steering-wheel angle over road-wheel angle [1]."""
    wheelbase: float = 2.71
    """L [m]."""
    arm: float = 1.49
    """Centre of gravity to rear axle [m]."""
    quantum: float = radians_of(0.1)
    """Resolution of the angle on the bus [rad]."""
    frame_dt: float = 0.02
    """Time between two frames [s]."""

    def __post_init__(self) -> None:
        for name, unit, low, high in (
            ("a_y_max", "m/s^2", 0.1, 20.0),
            ("jerk_max", "m/s^3", 0.1, 1e3),
            ("rate_max", "rad/s", 0.1, 1e3),
            ("delta_sw_max", "rad", 0.1, 100.0),
            ("v_floor", "m/s", 0.1, 50.0),
            ("v_doubt", "m/s", 0.0, 10.0),
            ("steer_ratio", "1", 1.0, 100.0),
            ("wheelbase", "m", 0.1, 20.0),
            ("arm", "m", 0.01, 20.0),
            ("quantum", "rad", 0.0, 1.0),
            ("frame_dt", "s", 1e-3, 1.0),
        ):
            require_within("GateModel", name, getattr(self, name), unit, low, high)

    @property
    def turning(self) -> float:
        """Time from the bound on a_y on one side to that on the other [s]."""
        return 2.0 * self.a_y_max / self.jerk_max

    def pushed(self, command: Scalar, before: Scalar, v: Scalar, dt: float, early: float = 0.0) -> Scalar:
        """The command [rad] that is sent in the end a sample after `before`, as far to the left as that may be.

        v [m/s]; early [s]: by how much sooner than the sample before the first frame may have been due.
        """
        ratio, length = self.steer_ratio, self.wheelbase
        fast, slow = m.maximum(v, self.v_floor), m.maximum(v + self.v_doubt, self.v_floor)
        bent = m.tan(before / ratio)
        kappa, most, least = bent / length, self.a_y_max / (fast * fast), self.a_y_max / (slow * slow)
        rounding = self.quantum * (1.0 + bent * bent) / (ratio * length)
        h, frames = dt + early, dt / self.frame_dt
        growth = (1.0 - m.exp(-fast * h / self.arm)) * (most - kappa)
        left = kappa + m.minimum(self.jerk_max / (fast * fast) * h, m.maximum(growth, (frames + 1.0) * rounding))
        back = m.maximum(self.jerk_max / (slow * slow) * dt - frames * rounding, 0.0)
        swing = (kappa + least) / (1.0 + self.arm / (slow * dt)) - frames * rounding
        right = kappa - m.minimum(back, m.maximum(swing, 0.0))
        low = m.maximum(before - self.rate_max * dt, ratio * m.atan(length * right))
        high = m.minimum(before + self.rate_max * h, ratio * m.atan(length * left))
        bound = m.minimum(ratio * m.atan(length * most), self.delta_sw_max)
        tight = m.minimum(ratio * m.atan(length * least), self.delta_sw_max)
        turned = m.clip(command, -tight, bound) - before + 0.0 * v  # a NaN in any of them stays
        return before + m.clip(turned, low - before, high - before)
