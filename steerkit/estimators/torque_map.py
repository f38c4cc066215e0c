"""What a steering torque does to a car's lateral acceleration: gain, friction and offset, found while it drives."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from steerkit._support.errors import Checked, number

_RIDGE = 1e-6


class TorqueFit(NamedTuple):
    """Sums of the regression: information matrix (3, 3) and vector (3,), and the seconds of driving in them."""

    A: np.ndarray
    b: np.ndarray
    seconds: float


class LateralMap(NamedTuple):
    """What a torque does to a car: a_y = gain u - gain friction sign(da_y/dt) + offset."""

    gain: float
    """Lateral acceleration at the largest torque [m/s^2]."""
    friction: float
    """The share of the largest torque that friction takes [1]."""
    offset: float = 0.0
    """Lateral acceleration without torque, of a banked road or a wheel off its zero [m/s^2]."""


@dataclass(frozen=True, kw_only=True)
class TorqueMap(Checked):
    """Least squares, with forgetting, of the lateral acceleration on torque, direction of turning and a constant.

        a_y = gain u - gain friction sign(da_y/dt) + offset,  u in [-1, 1], the share of the largest torque

    u acts before a_y is measured, by the steering's delay and lag, which the caller takes care of. Samples in which the
    car turns neither way fast enough to say which way friction acts teach nothing: friction may hold it anywhere. A fit
    is believed after `least` seconds of the others, if these tell the gain to `sure`, and within a share of what the
    data sheet says. Pure: state goes in and comes out. Raises ValueError for parameters
    out of range. Source: Rajamani 2012, section 3.3; the model of opendbc's `car/lateral.py`, get_friction.
    """

    gain: float = number(2.0, "m/s^2", low=0.1, high=20.0)
    """As the data sheet has it [m/s^2]."""
    friction: float = number(0.1, "1", low=0.0, high=1.0)
    """As the data sheet has it [1]."""
    least: float = number(10.0, "s", above=0.0)
    """Turning that a fit needs [s]."""
    noise: float = number(0.15, "m/s^2", above=0.0)
    """What a sample's lateral acceleration deviates by from this model, for a second or so [m/s^2]."""
    sure: float = number(0.06, "1", above=0.0)
    """Largest deviation of the gain, as a share of it [1]."""
    memory: float = number(120.0, "s", above=0.0)
    """Time after which a sample counts 1/e [s]."""
    share: float = number(0.3, "1", above=0.0, high=1.0)
    """How far the gain may be off the data sheet's [1]; friction: twice that."""
    slowest_turn: float = number(0.1, "m/s^3", above=0.0)
    """|da_y/dt| from which friction has a direction [m/s^3]."""

    def init(self) -> TorqueFit:
        """Nothing seen yet: the data sheet, with little weight."""
        prior = np.diag([1e-2, 1e-2, 1e-2]) + _RIDGE * np.eye(3)
        return TorqueFit(prior, prior @ np.array([self.gain, self.gain * self.friction, 0.0]), 0.0)

    def update(self, x: TorqueFit, *, u: float, a_y: float, turning: float, dt: float) -> TorqueFit:
        """One sample: torque u [1], lateral acceleration a_y [m/s^2], its rate [m/s^3]; a NaN teaches nothing."""
        if not np.isfinite(u + a_y + turning) or abs(turning) < self.slowest_turn:
            return x
        row, kept = np.array([u, -float(np.sign(turning)), 1.0]), 1.0 - dt / self.memory
        return TorqueFit(kept * x.A + dt * np.outer(row, row), kept * x.b + dt * row * a_y, x.seconds + dt)

    def found(self, x: TorqueFit) -> LateralMap:
        """The fit, within what may be believed; the data sheet's until there is enough driving in it."""
        if x.seconds < self.least:
            return LateralMap(self.gain, self.friction)
        covariance = np.linalg.inv(x.A + _RIDGE * np.eye(3))
        if self.noise * np.sqrt(covariance[0, 0]) > self.sure * self.gain:
            return LateralMap(self.gain, self.friction)
        gain, rubbing, offset = covariance @ x.b
        gain = float(np.clip(gain, (1.0 - self.share) * self.gain, (1.0 + self.share) * self.gain))
        few, many = (max(0.0, 1.0 + side * 2.0 * self.share) * self.friction for side in (-1.0, 1.0))
        return LateralMap(gain, float(np.clip(rubbing / gain, few, many)), float(np.clip(offset, -1.0, 1.0)))
