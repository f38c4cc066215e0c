"""A policy that explores while it learns: a wrapper that takes another action than the greedy one now and then."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number
from steerkit._support.random import seed_state, uniform
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.wrapper import Wrapper

_STREAM = 3  # of `seed_state`: exploration's


@dataclass(frozen=True, eq=False, kw_only=True)
class Exploring(Wrapper):
    """Wraps a policy so that a share of its samples takes an action drawn at random, all equally likely.

        action = actions[floor(n*w)] if u < share, else the greedy one;   u, w uniform in (0, 1), n actions

    Ports and sample time are those of the policy; q is that of the greedy action. A NaN action stays NaN.
    State: the policy's; then six numbers of the generator (`steerkit._support.random`), from `seed`.
    Raises ValueError unless 0 <= share <= 1.
    Source: Watkins 1989 (epsilon-greedy exploration).
    """

    block: NfqPolicy
    """The policy."""
    share: float = number(0.05, low=0.0, high=1.0)
    """Share of the samples that explore."""
    seed: int = 0
    """Of the random numbers."""

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*super().init(batch), *seed_state(self.seed, batch, stream=_STREAM))

    def output(self, t: Any, x: State, u: Any) -> Any:
        greedy = self.inner_output(t, x, u)
        explores, after = uniform(tuple(self.own(x)))
        which, _ = uniform(after)
        actions = self.block.actions
        action = actions[-1]
        for k in reversed(range(len(actions) - 1)):
            action = m.where(which * len(actions) < k + 1.0, actions[k], action)
        chosen = m.where(explores < self.share, action, greedy.action)
        return greedy._replace(action=m.where(m.is_finite(greedy.action), chosen, greedy.action))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        random = uniform(uniform(tuple(self.own(x)))[1])[1]
        return (*self.block.update(t, self.inner(x), u, y), *random)
