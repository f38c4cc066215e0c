"""Costs of a transition: frozen objects, called with (s, a, s_next), vectorised, giving (cost, terminal).

s, s_next: (n, columns) states, column 0 is the cross-track error e [m]; a: (n,) actions [rad], as chosen from the set:
before a fast car's share of them is taken (`StateDescription.scaled`). cost: (n,) in [0, 1],
terminal: (n,) bool. Costs look at where the car came to (s_next) and what it did to get there (a).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import Checked, check_numbers, number, require
from steerkit.controllers.policy import DOE, R_E, E, V
from steerkit.diagram import maths as m
from steerkit.diagram.maths import Array
from steerkit.task import DT, GOAL, TRIP

_WELL = 25.0
"""Width of a well over the median |e| of the driving [1]: with sensors as in `hard` conditions, the widest."""
Costs = tuple[Array, NDArray[np.bool_]]

Cost = Callable[[Array, Array, Array], Costs]
"""Of s, a, s_next: the cost (n,) in [0, 1] and terminal (n,) of n transitions."""


@dataclass(frozen=True, kw_only=True)
class _Limits:
    goal: float = GOAL
    """|e| [m] below which the car counts as on the path."""
    trip: float = TRIP
    """|e| [m] above which the episode has failed (terminal, cost 1)."""
    step: float = number(0.01, above=0.0, high=1.0)
    """Cost of a step elsewhere; 0.04 uses more of a sigmoid's range."""

    def __post_init__(self) -> None:
        where = type(self).__name__
        check_numbers(self, where)
        require(0.0 < self.goal < self.trip, where, f"goal {self.goal}, trip {self.trip} [m], expected 0 < goal < trip")

    def steps(self, e: Array, a: Array) -> Array:
        """Cost (n,) of steps to e [m] that do not fail."""
        raise NotImplementedError

    def __call__(self, s: Array, a: Array, s_next: Array) -> Costs:
        e = s_next[:, E]
        failed = m.absolute(e) > self.trip
        return m.where(failed, 1.0, self.steps(e, a)), failed


@dataclass(frozen=True, kw_only=True)
class BandCost(_Limits):
    """Nothing inside the band, little outside, everything beyond the limit.

        c = 0 if |e| < goal;  1, terminal, if |e| > trip;  step otherwise

    Source: the NFQ steering task's bang-bang cost. Raises ValueError unless 0 < goal < trip and 0 < step <= 1.
    """

    def steps(self, e: Array, a: Array) -> Array:
        return m.where(m.absolute(e) < self.goal, 0.0, self.step)


@dataclass(frozen=True, kw_only=True)
class IdoeCost(_Limits):
    """`BandCost` that is free only when the steering wheel is also left alone.

        c = 0 if |e| < goal and a = 0;  1, terminal, if |e| > trip;  step otherwise

    Source: the NFQ steering task's cost for the integrating output element. Raises ValueError as `BandCost`.
    """

    def steps(self, e: Array, a: Array) -> Array:
        return m.where(m.both(m.absolute(e) < self.goal, a == 0.0), 0.0, self.step)


@dataclass(frozen=True, kw_only=True)
class TanhCost(_Limits):
    """A smooth well about the path, and a price on moving the wheel.

        c = step * tanh^2(e * w) + action_cost * p(a),   w = atanh(sqrt(0.95)) / goal;   1, terminal, if |e| > trip
        p(a) = min(1, |a|/action_unit),   or [a != 0] where action_unit is 0

    so that 95 % of `step` is reached at |e| = goal. With a `goal_least` the well is as wide as the driving is good (see
    `suited`): where sensors and car let e be small, the net is told to make it smaller still.

    A policy with actions between those of the set moves the wheel in every sample: at [a != 0] that adds up to
    action_cost/(1 - discount), and where this nears 1, failing costs no more than driving and nothing is learned.
    Source: Hafner and Riedmiller 2011 (Reinforcement learning in feedback control), section 4.3, the tanh^2 cost with
    band width mu = goal; action_cost and goal_least are ours.
    Raises ValueError as `BandCost`, or unless 0 <= action_cost <= 1 - step and goal_least <= goal.
    """

    goal_least: float = number(0.0, "m", low=0.0)
    """Narrowest `goal` of a slow car [m]; 0: it stays as it is."""

    step: float = number(0.04, above=0.0, high=1.0)
    """Cost of a step far from the path."""
    action_cost: float = 0.01
    """Cost of a step that moves the steering wheel."""
    action_unit: float = number(0.0, "rad", low=0.0)
    """Action from which a step costs all of that, smaller ones in proportion; 0: all that is not 0 does [rad]."""
    dear_from: float | None = number(None, "1", low=1.0)
    """Of torque steering: how many times `scaled_from` the speed is from which actions cost more (see `suited`)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        fits = 0.0 <= self.action_cost <= 1.0 - self.step
        require(fits, "TanhCost", f"action_cost = {self.action_cost}, expected 0 <= action_cost <= 1 - step")
        narrow, wide = self.goal_least, self.goal
        require(narrow <= wide, "TanhCost", f"goal_least = {narrow}, goal = {wide} [m], expected goal_least <= goal")

    def suited(self, e: Array, fast: float = 1.0, dearer: float = 1.0) -> "TanhCost":
        """The cost of driving with errors e (n,) [m] at `fast` times `scaled_from` (1 at least).

            action_cost' = min(action_cost*dearer*fast, 1 - step),   or max(1, fast/dear_from)^2 in place of fast

        The well is _WELL times the median |e| wide, within goal_least*fast and goal. An error of the course leads a
        fast car off as many times faster; by angle, a price that grows with fast^2 leaves it further off.
        """
        dear = fast if self.dear_from is None else max(1.0, fast / self.dear_from) ** 2
        cost = replace(self, action_cost=min(self.action_cost * dearer * dear, 1.0 - self.step))
        if not self.goal_least or not len(e):
            return cost
        least = min(self.goal, self.goal_least * fast)
        return replace(cost, goal=float(np.clip(_WELL * np.median(np.abs(e)), least, self.goal)))

    def steps(self, e: Array, a: Array) -> Array:
        well = m.tanh(e * (math.atanh(math.sqrt(0.95)) / self.goal)) ** 2
        moved = m.minimum(m.absolute(a) / self.action_unit, 1.0) if self.action_unit else a != 0.0
        return self.step * well + self.action_cost * moved


@dataclass(frozen=True, kw_only=True)
class SmoothCost(Checked):
    """Another cost, and a price on jerk and on turning the steering wheel fast.

        c = cost + jerk_cost * min(1, (j/jerk_unit)^2) + wheel_cost * min(1, (change/wheel_unit)^2);   terminal: 1
        j = v (r_e' - r_e)/dt,  the lateral jerk against the path's,  change = doe' - doe

    of a state (e, e_dot, v, psi_e, r_e, doe). Under noise j is mostly the yaw-rate sensor's: 0.02 rad/s of noise at
    5 m/s and 20 Hz is 3 m/s^3. Raises ValueError unless prices are >= 0 and units > 0. Ours; squares as in LQR.
    """

    cost: BandCost | IdoeCost | TanhCost = field(default_factory=TanhCost)
    """The cost of the task itself."""
    jerk_cost: float = number(0.005, low=0.0)
    """Price of a step with a jerk of `jerk_unit` or more."""
    jerk_unit: float = number(5.0, "m/s^3", above=0.0)
    """[m/s^3]"""
    wheel_cost: float = number(0.005, low=0.0)
    """Price of a step in which the steering wheel turns by `wheel_unit` or more."""
    wheel_unit: float = number(math.radians(25.0), "rad", above=0.0)
    """[rad]"""
    dt: float = number(DT, "s", above=0.0)
    """Sample time [s]."""

    def __call__(self, s: Array, a: Array, s_next: Array) -> Costs:
        c, failed = self.cost(s, a, s_next)
        jerk = s_next[:, V] * (s_next[:, R_E] - s[:, R_E]) / self.dt
        change = s_next[:, DOE] - s[:, DOE]
        c = c + self.jerk_cost * m.minimum((jerk / self.jerk_unit) ** 2, 1.0)
        c = c + self.wheel_cost * m.minimum((change / self.wheel_unit) ** 2, 1.0)
        return m.where(failed, 1.0, m.minimum(c, 1.0)), failed


COSTS = (BandCost, IdoeCost, TanhCost, SmoothCost)
