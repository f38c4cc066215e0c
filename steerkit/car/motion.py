"""Dead reckoning against the pose: whether the car moves as its speed, heading, yaw rate and wheel say."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from steerkit._support.errors import check_numbers, number
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.vehicles.rollout import yaw_gain

SPACING = 0.05
"""Time between two kept samples [s]: every later pose is compared with each of them."""
HORIZON = 4.0
"""How long a sample is kept [s]."""

READ_LATE = 0.06
"""How late a busy computer may read a frame [s]; the process that reads watches that of its own."""


@dataclass(frozen=True, kw_only=True)
class MotionLimits:
    """How far pose, speed, yaw rate and wheel may contradict each other over any time T, up to `HORIZON`.

        along   = pose_jump + READ_LATE*v + motion_along*v*T      along the heading
        across  = pose_jump + motion_across*v*T                   across it
        heading = heading_slack + heading_rate*T + 0.05*turned    turned: by how much, to and fro [rad]
        wheel   = wheel_slack + wheel_rate*T + wheel_share*turned

    An error that stays below them moves the car by motion_across*v + pose_jump/HORIZON a second at most.
    """

    pose_jump: float = number(0.25, "m", low=0.05, high=0.5)
    """Jump of the position that a good receiver makes [m]."""
    motion_along: float = number(0.06, low=0.005, high=0.15)
    """Error of the speed [1]."""
    motion_across: float = number(0.012, "rad", low=radians_of(0.1), high=radians_of(3.0))
    """Error of the heading, and of the sideslip where it is not measured [rad]."""
    heading_slack: float = number(radians_of(1.5), "rad", low=radians_of(0.5), high=radians_of(5.0))
    """Jump of the heading that a good receiver makes [rad]."""
    heading_rate: float = number(radians_of(0.5), "rad/s", low=radians_of(0.05), high=radians_of(2.0))
    """Error of the yaw rate [rad/s]."""
    wheel_slack: float = number(radians_of(4.0), "rad", low=radians_of(1.0), high=radians_of(10.0))
    """Heading by which the yaw rate lags behind the wheel, or runs ahead [rad]."""
    wheel_rate: float = number(radians_of(2.5), "rad/s", low=radians_of(0.5), high=radians_of(8.0))
    """Yaw rate that the wheel does not explain: its offset, wind, a banked road [rad/s]."""
    wheel_share: float = number(0.4, low=0.05, high=0.8)
    """The same as a share of the yaw rate: ratio and tyres that differ from the data sheet [1]."""

    def __post_init__(self) -> None:
        check_numbers(self, "MotionLimits")


class MotionCheck:
    """Compares each pose with those of the last seconds by dead reckoning, in overlapping windows.

    wheelbase [m], steer_ratio [1], understeer [rad s^2/m]: of the car; r = v tan(delta)/(L + K v^2) at a steady wheel.
    Source: as Autoware's pose instability detector compares a pose with odometry; the split along and across the
    heading is ours.

    A sample is what is left of a pose when dead reckoning is taken off, which must stand still: (t [s]; along, across
    [m], added up along and across the heading of each step, so that a wrong speed does not turn into `across` in a
    bend; measured heading less the yaw rate's, the yaw rate's less the wheel's [rad]; |psi|' added up, by the yaw rate
    and by the wheel [rad]).
    """

    def __init__(self, limits: MotionLimits, *, wheelbase: float, steer_ratio: float, understeer: float = 0.0):
        self.limits = limits
        self._length, self._ratio, self._understeer = wheelbase, steer_ratio, understeer
        self._t: float | None = None
        self._psi = 0.0
        self._rates = (0.0, 0.0, 0.0, 0.0)
        # what dead reckoning has added up: x, y, psi, psi by the wheel; |psi|' of both
        self._added: tuple[float, ...] = (0.0,) * 6
        self._last: tuple[float, float, float, float] | None = None
        self._kept = np.empty((0, 7))

    def forget(self) -> None:
        """Begin anew, after a pause without poses."""
        self._t = self._last = None
        self._kept = self._kept[:0]

    def moves(self, t: float, *, psi: float, v: float, r: float, beta: float, delta_sw: float) -> None:
        """Speed, heading, yaw rate and wheel at time t [SI]: added up from the last time on (trapezoids)."""
        course, delta = psi + beta, delta_sw / self._ratio
        by_wheel = yaw_gain(v, self._length, self._understeer) * math.tan(delta) if abs(delta) < 1.5 else r
        rates = (v * math.cos(course), v * math.sin(course), r, by_wheel if math.isfinite(by_wheel) else r)
        if self._t is None:
            self._t, self._psi, self._added = t, psi, (0.0,) * 6
        else:
            dt = max(0.0, t - self._t)
            steps = [0.5 * dt * (a + b) for a, b in zip(self._rates, rates)]
            steps += abs(steps[2]), abs(steps[3])
            self._t, self._added = max(t, self._t), tuple([a + b for a, b in zip(self._added, steps)])
            self._psi += math.remainder(psi - self._psi, 2.0 * math.pi)
        self._rates = rates

    def pose(self, t: float, x: float, y: float) -> str:
        """The position at time t [s, m]: what contradicts the motion of the last seconds, or ""."""
        if self._t is None:
            return ""
        by_v_x, by_v_y, by_r, by_wheel, turned, turned_wheel = self._added
        ahead = max(0.0, min(t - self._t, 0.1))  # the position may come before the speed of the same moment
        left_x, left_y = x - by_v_x - ahead * self._rates[0], y - by_v_y - ahead * self._rates[1]
        last_x, last_y, along, across = self._last or (left_x, left_y, 0.0, 0.0)
        cos, sin = math.cos(self._psi), math.sin(self._psi)
        along += (left_x - last_x) * cos + (left_y - last_y) * sin
        across += (left_y - last_y) * cos - (left_x - last_x) * sin
        self._last = (left_x, left_y, along, across)
        here = np.array([t, along, across, self._psi - by_r, by_r - by_wheel, turned, turned_wheel])
        self._kept = self._kept[self._kept[:, 0] >= t - HORIZON]
        what = self._against(here, math.hypot(self._rates[0], self._rates[1]))
        if not len(self._kept) or t - self._kept[-1, 0] >= SPACING:
            self._kept = np.vstack([self._kept, here])
        return what

    def _against(self, here: np.ndarray, v: float) -> str:
        """What the oldest of the kept samples that contradicts this one says, or ""."""
        limits = self.limits
        span, *left, turned, turned_wheel = (here - self._kept).T
        most = (
            limits.pose_jump + READ_LATE * v + limits.motion_along * v * span,
            limits.pose_jump + limits.motion_across * v * span,
            limits.heading_slack + limits.heading_rate * span + 0.05 * turned,
            limits.wheel_slack + limits.wheel_rate * span + limits.wheel_share * np.maximum(turned, turned_wheel),
        )
        beyond = ~(np.abs(left) <= most)  # of a NaN too
        if not beyond.any():
            return ""
        then = int(beyond.any(axis=0).argmax())
        along, across, psi, wheel = (float(one[then]) for one in left)
        during = f"{span[then]:.2f} s"
        texts = (
            f"the position is {along:+.2f} m along from where {during} at {v:.1f} m/s lead",
            f"the position drifted by {across:+.2f} m across the heading in {during}",
            f"the heading is {degrees_of(psi):+.1f} deg from where the yaw rate of {during} leads",
            f"the car turned by {degrees_of(wheel):+.1f} deg more than its wheel says in {during}",
        )
        return texts[int(beyond[:, then].argmax())]
