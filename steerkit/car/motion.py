"""Dead reckoning against the pose: does the car move as its speed, heading, yaw rate and wheel say that it must?"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from steerkit._support.errors import require
from steerkit.diagram.units import degrees_of, radians_of

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
        heading = heading_slack + heading_rate*T + 0.05*turned    turned by how much, to and fro [rad]
        wheel   = wheel_slack + wheel_rate*T + wheel_share*turned

    What stays below them for ever moves the car by motion_across*v + pose_jump/HORIZON a second at most.
    """

    pose_jump: float = 0.25
    """Jump of the position that a good receiver makes [m]."""
    motion_along: float = 0.06
    """Error of the speed [1]."""
    motion_across: float = 0.012
    """Error of the heading, and of the sideslip where it is not measured [rad]."""
    heading_slack: float = radians_of(1.5)
    """Jump of the heading that a good receiver makes [rad]."""
    heading_rate: float = radians_of(0.5)
    """Error of the yaw rate [rad/s]."""
    wheel_slack: float = radians_of(4.0)
    """Heading by which the yaw rate lags behind the wheel, or runs ahead [rad]."""
    wheel_rate: float = radians_of(2.5)
    """Yaw rate that the wheel does not explain: its offset, wind, a banked road [rad/s]."""
    wheel_share: float = 0.4
    """The same as a share of the yaw rate: ratio and tyres that differ from the data sheet [1]."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            require(0.0 < value < math.inf, "MotionLimits", f"{name} = {value}, expected a finite number > 0")


class Reckoned(NamedTuple):
    """What dead reckoning has added up, from a beginning that does not matter."""

    t: float
    """[s]"""
    x: float
    y: float
    """Way by speed and measured heading [m]."""
    psi: float
    """Heading by the measured yaw rate [rad]."""
    psi_wheel: float
    """Heading by speed and wheel [rad]."""
    turned: float
    """|psi|' added up [rad]."""
    turned_wheel: float
    """The same of the wheel."""


class Sample(NamedTuple):
    """A pose, less what dead reckoning explains of it: what is left must stand still."""

    t: float
    along: float
    """What is left of each step, along the heading of that step, added up [m]."""
    across: float
    """The same across it, + = left: a wrong speed does not turn into it in a bend [m]."""
    psi: float
    """Measured heading, unwrapped, less the yaw rate's [rad]."""
    wheel: float
    """The yaw rate's heading less the wheel's [rad]."""
    turned: float
    """|psi|' added up [rad]."""
    turned_wheel: float
    """The same of the wheel."""


class Motion:
    """Compares each pose with all those of the last seconds; the windows overlap, and none of them starts anew.

    wheelbase [m], steer_ratio [1], understeer [rad s^2/m]: of the car; r = v tan(delta)/(L + K v^2) at a steady wheel.
    Source: as Autoware's pose instability detector compares a pose with odometry; the split along and across the
    heading is ours.
    """

    def __init__(self, limits: MotionLimits, *, wheelbase: float, steer_ratio: float, understeer: float = 0.0):
        self.limits = limits
        self._length, self._ratio, self._understeer = wheelbase, steer_ratio, understeer
        self._at: Reckoned | None = None
        self._rates = (0.0, 0.0, 0.0, 0.0)
        self._psi = 0.0
        self._last: tuple[float, float, float, float] | None = None
        self._kept: deque[Sample] = deque()
        self._least = self._most = Sample(*[math.nan] * 7)  # of each quantity, of those that are or were kept

    def forget(self) -> None:
        """Begin anew, after a pause without poses."""
        self._at = self._last = None
        self._kept.clear()

    def moves(self, t: float, *, psi: float, v: float, r: float, beta: float, delta_sw: float) -> None:
        """Speed, heading, yaw rate and wheel at time t [SI]: added up from the last time on (trapezoids)."""
        course = psi + beta
        delta = delta_sw / self._ratio
        by_wheel = v * math.tan(delta) / (self._length + self._understeer * v * v) if abs(delta) < 1.5 else r
        rates = (v * math.cos(course), v * math.sin(course), r, by_wheel if math.isfinite(by_wheel) else r)
        if self._at is None:
            self._at, self._psi = Reckoned(t, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), psi
        else:
            old, dt = self._at, max(0.0, t - self._at.t)
            x, y, turn, turn_wheel = [0.5 * dt * (a + b) for a, b in zip(self._rates, rates)]
            self._at = Reckoned(
                max(t, old.t),
                old.x + x,
                old.y + y,
                old.psi + turn,
                old.psi_wheel + turn_wheel,
                old.turned + abs(turn),
                old.turned_wheel + abs(turn_wheel),
            )
            self._psi += math.remainder(psi - self._psi, 2.0 * math.pi)
        self._rates = rates

    def pose(self, t: float, x: float, y: float) -> str:
        """The position at time t [s, m]: what contradicts the motion of the last seconds, or ""."""
        at = self._at
        if at is None:
            return ""
        ahead = max(0.0, min(t - at.t, 0.1))  # the position may come before the speed of the same moment
        left_x, left_y = x - at.x - ahead * self._rates[0], y - at.y - ahead * self._rates[1]
        last_x, last_y, along, across = self._last or (left_x, left_y, 0.0, 0.0)
        cos, sin = math.cos(self._psi), math.sin(self._psi)
        along += (left_x - last_x) * cos + (left_y - last_y) * sin
        across += (left_y - last_y) * cos - (left_x - last_x) * sin
        self._last = (left_x, left_y, along, across)
        here = Sample(t, along, across, self._psi - at.psi, at.psi - at.psi_wheel, at.turned, at.turned_wheel)
        while self._kept and self._kept[0].t < t - HORIZON:
            self._kept.popleft()
        v = math.hypot(self._rates[0], self._rates[1])
        what = "" if self._agrees(here, v) else self._against(here, v)
        if not self._kept or t - self._kept[-1].t >= SPACING:
            self._kept.append(here)
            columns = [*zip(*self._kept)]
            self._least, self._most = Sample(*map(min, columns)), Sample(*map(max, columns))
        return what

    def _agrees(self, here: Sample, v: float) -> bool:
        """Does it lie within what is borne at T = 0 of all that is kept? Then none contradicts it, as limits only grow
        with T: said without a look at each, and most are said so."""
        limits, least, most = self.limits, self._least, self._most
        along = limits.pose_jump + READ_LATE * v
        return (
            here.t >= most.t
            and here.along - least.along <= along
            and most.along - here.along <= along
            and here.across - least.across <= limits.pose_jump
            and most.across - here.across <= limits.pose_jump
            and here.psi - least.psi <= limits.heading_slack
            and most.psi - here.psi <= limits.heading_slack
            and here.wheel - least.wheel <= limits.wheel_slack
            and most.wheel - here.wheel <= limits.wheel_slack
        )

    def _against(self, here: Sample, v: float) -> str:
        """What the oldest of the kept samples that contradicts this one says, or ""."""
        limits = self.limits
        t_now, along_now, across_now, psi_now, wheel_now, turned_now, turned_wheel_now = here
        for t, along_then, across_then, psi_then, wheel_then, turned_then, turned_wheel_then in self._kept:
            span = t_now - t
            along, across, way = along_now - along_then, across_now - across_then, v * span
            if not abs(along) <= limits.pose_jump + READ_LATE * v + limits.motion_along * way:
                return f"the position is {along:+.2f} m along from where {span:.2f} s at {v:.1f} m/s lead"
            if not abs(across) <= limits.pose_jump + limits.motion_across * way:
                return f"the position drifted by {across:+.2f} m across the heading in {span:.2f} s"
            psi, turned = psi_now - psi_then, turned_now - turned_then
            if not abs(psi) <= limits.heading_slack + limits.heading_rate * span + 0.05 * turned:
                return f"the heading is {degrees_of(psi):+.1f} deg from where the yaw rate of {span:.2f} s leads"
            wheel, turned_wheel = wheel_now - wheel_then, turned_wheel_now - turned_wheel_then
            if turned_wheel > turned:
                turned = turned_wheel
            if not abs(wheel) <= limits.wheel_slack + limits.wheel_rate * span + limits.wheel_share * turned:
                return f"the car turned by {degrees_of(wheel):+.1f} deg more than its wheel says in {span:.2f} s"
        return ""
