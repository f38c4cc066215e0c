"""Costs of a transition: frozen objects, called with (s, a, s_next), vectorised, giving (cost, terminal).

s, s_next: (n, columns) states, column 0 is the cross-track error e [m]; a: (n,) actions [rad]. cost: (n,) in [0, 1],
terminal: (n,) bool. Costs look at where the car came to (s_next) and what it did to get there (a).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from steerkit.block import require
from steerkit.units import radians_of

Costs = tuple[NDArray[np.float64], NDArray[np.bool_]]
Array = NDArray[np.float64]


class Cost(Protocol):
    """What `steerkit.learning.nfq` asks of a cost."""

    @property
    def goal(self) -> float:
        """|e| [m] below which the car counts as on the path."""
        ...

    def __call__(self, s: Array, a: Array, s_next: Array) -> Costs:
        """Cost (n,) in [0, 1] and terminal (n,) of n transitions."""
        ...


@dataclass(frozen=True, kw_only=True)
class _Limits:
    goal: float = 0.05
    """|e| [m] below which the car counts as on the path."""
    trip: float = 0.5
    """|e| [m] above which the episode has failed (terminal, cost 1)."""
    step: float = 0.01
    """Cost of a step elsewhere; 0.04 uses more of a sigmoid's range."""

    def __post_init__(self) -> None:
        where = type(self).__name__
        require(0.0 < self.goal < self.trip, where, f"goal {self.goal}, trip {self.trip} [m], expected 0 < goal < trip")
        require(0.0 < self.step <= 1.0, where, f"step = {self.step}, expected 0 < step <= 1")


@dataclass(frozen=True, kw_only=True)
class BandCost(_Limits):
    """Nothing inside the band, little outside, everything beyond the limit.

        c = 0 if |e| < goal;  1, terminal, if |e| > trip;  step otherwise

    Source: the NFQ steering task's bang-bang cost. Raises ValueError unless 0 < goal < trip and 0 < step <= 1.
    """

    def __call__(self, s: Array, a: Array, s_next: Array) -> Costs:
        e = np.abs(s_next[:, 0])
        failed = e > self.trip
        return np.where(failed, 1.0, np.where(e < self.goal, 0.0, self.step)), failed


@dataclass(frozen=True, kw_only=True)
class IdoeCost(_Limits):
    """`BandCost` that is free only when the steering wheel is also left alone.

        c = 0 if |e| < goal and a = 0;  1, terminal, if |e| > trip;  step otherwise

    Source: the NFQ steering task's cost for the integrating output element. Raises ValueError as `BandCost`.
    """

    def __call__(self, s: Array, a: Array, s_next: Array) -> Costs:
        e = np.abs(s_next[:, 0])
        failed = e > self.trip
        return np.where(failed, 1.0, np.where((e < self.goal) & (a == 0.0), 0.0, self.step)), failed


@dataclass(frozen=True, kw_only=True)
class TanhCost(_Limits):
    """A smooth well about the path, and a price on moving the wheel.

        c = step * tanh^2(e * w) + action_cost * [a != 0],   w = atanh(sqrt(0.95)) / goal;   1, terminal, if |e| > trip

    so that 95 % of `step` is reached at |e| = goal. Source: Hafner and Riedmiller 2011 (Reinforcement learning in
    feedback control), section 4.3, the tanh^2 cost with band width mu = goal; action_cost is ours.
    Raises ValueError as `BandCost`, or unless 0 <= action_cost <= 1 - step.
    """

    step: float = 0.04
    """Cost of a step far from the path."""
    action_cost: float = 0.01
    """Cost of a step that moves the steering wheel."""

    def __post_init__(self) -> None:
        super().__post_init__()
        fits = 0.0 <= self.action_cost <= 1.0 - self.step
        require(fits, "TanhCost", f"action_cost = {self.action_cost}, expected 0 <= action_cost <= 1 - step")

    def __call__(self, s: Array, a: Array, s_next: Array) -> Costs:
        e = s_next[:, 0]
        failed = np.abs(e) > self.trip
        well = np.tanh(e * (math.atanh(math.sqrt(0.95)) / self.goal)) ** 2
        return np.where(failed, 1.0, self.step * well + self.action_cost * (a != 0.0)), failed


@dataclass(frozen=True, kw_only=True)
class SmoothCost(_Limits):
    """The smooth well of `TanhCost` with a smooth price on the action, for learners of continuous actions.

        c = step * tanh^2(e * w) + action_cost * min(1, (a/action_scale)^2),  w as there;   1, terminal, if |e| > trip

    Source: as `TanhCost`; the quadratic price is the usual one of linear-quadratic control. Raises ValueError as
    `TanhCost`, or unless action_scale > 0.
    """

    goal: float = 0.15
    step: float = 0.04
    """Cost of a step far from the path."""
    action_cost: float = 0.01
    """Cost of a step with an action as large as action_scale."""
    action_scale: float = radians_of(25.0)
    """Action of full cost [rad]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        fits = 0.0 <= self.action_cost <= 1.0 - self.step
        require(fits, "SmoothCost", f"action_cost = {self.action_cost}, expected 0 <= action_cost <= 1 - step")
        require(self.action_scale > 0.0, "SmoothCost", f"action_scale = {self.action_scale} [rad], expected > 0")

    def __call__(self, s: Array, a: Array, s_next: Array) -> Costs:
        e = s_next[:, 0]
        failed = np.abs(e) > self.trip
        well = np.tanh(e * (math.atanh(math.sqrt(0.95)) / self.goal)) ** 2
        price = np.minimum(1.0, (a / self.action_scale) ** 2)
        return np.where(failed, 1.0, self.step * well + self.action_cost * price), failed


COSTS = (BandCost, IdoeCost, TanhCost, SmoothCost)
"""All of them."""
