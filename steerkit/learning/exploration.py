"""A policy that explores while it learns: a wrapper that takes another action than the greedy one now and then."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import require
from steerkit._support.random import seed_state, uniform
from steerkit.controllers.nfq_policy import NfqPolicy, without_preview
from steerkit.controllers.policy import Policy
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, State

_STREAM = 3  # of `seed_state`: exploration's
_RANDOM = len(seed_state(0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Exploring(Policy):
    """Wraps a policy so that a share of its samples takes an action drawn at random, all equally likely.

        action = actions[floor(n*w)] if u < share, else the greedy one;   u, w uniform in (0, 1), n actions

    Inputs, as for the policy: e [m], e_dot [m/s], v [m/s], psi_e [rad], r_e [rad/s], doe [rad], preview [1/m]. Outputs:
    action [rad]; q [1], the greedy action's; ready [1]. A NaN action stays NaN.
    State: six numbers of the generator (`steerkit._support.random`), from `seed`; then the policy's.
    Raises ValueError unless 0 <= share <= 1.
    Source: Watkins 1989 (epsilon-greedy exploration).
    """

    preview = In("1/m", size="preview_points")

    policy: NfqPolicy
    """What acts otherwise."""
    share: float = 0.05
    """Share of the samples that explore."""
    seed: int = 0
    """Of the random numbers."""

    def __post_init__(self) -> None:
        require(0.0 <= self.share <= 1.0, "Exploring", f"share = {self.share}, expected 0 <= share <= 1")
        same = self.policy.dt == self.dt
        require(same, "Exploring", f"dt = {self.dt} s, the policy's is {self.policy.dt} s, expected the same")
        if not self.preview_points:
            without_preview(self)

    @property
    def preview_points(self) -> int:
        """As the policy's."""
        return self.policy.preview_points

    @property
    def preview_dt(self) -> float:
        """As the policy's [s]."""
        return self.policy.preview_dt

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*seed_state(self.seed, batch, stream=_STREAM), *self.policy.init(batch))

    def settle(self, t: float, x: State, u: Any) -> State:
        return (*x[:_RANDOM], *self.policy.settle(t, x[_RANDOM:], u))

    def output(self, t: Any, x: State, u: Any) -> Any:
        greedy = self.policy.output(t, x[_RANDOM:], u)
        explores, after = uniform(tuple(x[:_RANDOM]))
        which, _ = uniform(after)
        actions = self.policy.actions
        action = actions[-1]
        for k in reversed(range(len(actions) - 1)):
            action = m.where(which * len(actions) < k + 1.0, actions[k], action)
        chosen = m.where(explores < self.share, action, greedy.action)
        return self.Y(m.where(m.is_finite(greedy.action), chosen, greedy.action), greedy.q, greedy.ready)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        random = uniform(uniform(tuple(x[:_RANDOM]))[1])[1]
        return (*random, *self.policy.update(t, x[_RANDOM:], u, y))
