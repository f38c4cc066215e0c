"""The story of a learner, in simulation or on a car: it is recorded and counted, it trains, and it takes over."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.doe import OutputElement
from steerkit.learning.counts import Counts, Episode
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.recorder import Keep, TransitionRecorder
from steerkit.learning.settings import Setting
from steerkit.learning.trainer import Job, Result, Training
from steerkit.task import RELEASE


def untrained(setting: Setting, seed: int) -> NfqPolicy:
    """The policy that a run of this setting and seed begins with: nets drawn at random."""
    description = setting.description()
    nets = nfq.fresh_nets(setting.fit, description, seed=seed)
    return NfqPolicy(
        nets=nets,
        actions=setting.actions,
        description=description,
        combine=setting.fit.combine,
        continuous=setting.continuous,
        preview_points=setting.fit.preview_points,
    )


def state_signals(setting: Setting, inputs: Mapping[str, str]) -> dict[str, str]:
    """Recorded column -> signal of the loop, from those that drive a policy's inputs (`Loop.inputs_of`).

    The path's curvature is the first of the policy's preview.
    """
    known = {**inputs, "kappa": inputs["preview"].replace(".preview", ".kappa") if "preview" in inputs else ""}
    return {name: known[name] for name in setting.recorded()}


class Events(NamedTuple):
    """What happened in a sample."""

    ended: Episode | None
    """The episode that ended with it."""
    round: bool
    """Was a round complete in it?"""


class LearnerState:
    """What a learner has seen and done, when it trains, and who may steer; whoever drives it asks after each sample.

    setting: how it learns. seed: of the nets. policy: to begin with, and `net` its number. trainer: makes new policies
    of what was recorded. transitions: recorded before (default: none). first: number of the first episode. also: a
    second place that takes every transition, such as a store on disk. round_length: of a round of the course [m].

    A policy is trusted until it fails; then the recovery controller keeps the wheel until a newer one takes over, when
    the car is calm. It is trained at each failure (`train`) and, while it drives, when it is `due`; new policies
    `take_over` between two samples.
    """

    def __init__(
        self,
        *,
        setting: Setting,
        seed: int,
        policy: Any,
        trainer: Training,
        net: int = 0,
        transitions: Transitions | None = None,
        first: int = 1,
        also: Keep | None = None,
        round_length: float = math.inf,
    ):
        self.setting, self.seed, self.trainer = setting, seed, trainer
        self.names = setting.recorded()
        self.policy, self.net, self.trusted = policy, net, True
        self.transitions = Transitions(self.names) if transitions is None else transitions
        self.counts = Counts(updates=net)
        self.recorder = TransitionRecorder(self._keep)
        self.faults: list[str] = []
        """What went wrong in training."""
        self._first, self._also, self._round_length = first, also, round_length

    @property
    def steering(self) -> Any:
        """The policy for the loop: one that is not trusted never says that it is ready."""
        return self.policy if self.trusted else replace(self.policy, ready_from=math.inf)

    def sample(
        self,
        number: int,
        t: float,
        s: Sequence[float],
        action: float,
        *,
        learning: bool,
        failed: bool,
        progress: float,
        e: float,
    ) -> Events:
        """Record and count sample `number`, at driving time t [s].

        s: the learner's state (SI), of the columns `names`. action: its wish [rad]. learning: does it steer?
        failed: if not, was the wheel taken from it? progress: along the path [m]. e: cross-track error [m], which
        its state may hold with noise.
        """
        episode = self._first + len(self.counts.episodes) - 1
        self.recorder.sample(number, tuple(s), action, learning=learning, episode=episode)
        if learning:
            return Events(None, self.counts.steered(t, progress=progress, e=e, round_length=self._round_length))
        return Events(self.counts.ended(t, failed=failed), False)

    def carried(self, t: float) -> None:
        """Somebody carried the car elsewhere: that ends the episode and the recovery, and is no transition."""
        self.recorder.forget()
        self.counts.ended(t, failed=False)
        self.counts.recovery = None

    def corrected(self, share: float) -> bool:
        """The safety filter put so much of its backup [1] into the policy's command: was that once too often?"""
        counts, setting = self.counts, self.setting
        counts.corrected += share > 0.0
        return counts.corrected * self.policy.dt >= setting.corrected_seconds

    def taught(self, action: float, element: OutputElement, *, correction: float, sent: float, state: float) -> float:
        """The action [rad] that a sample teaches: where the filter changed the angle, the one that makes what was sent.

        action: the policy's. correction, sent [rad]: of the filter. state [rad]: of the output element.
        """
        if correction == 0.0 or self.setting.teaches == "chosen":
            return action
        return element.action_for(sent, state)

    def due(self) -> bool:
        """Is it time to train anew while driving on?"""
        every, counts = self.setting.retrain_every_m, self.counts
        return every > 0.0 and not self.trainer.busy and counts.driven - counts.trained_at >= every

    def train(self, t: float, *, trusted: bool) -> None:
        """One update on all transitions, where there are any; the trainer hands its product out later.

        trusted: may the policy go on meanwhile? It does not, once it has failed.
        """
        counts, setting = self.counts, self.setting
        self.trusted = self.trusted and trusted
        counts.trained_at = counts.driven
        if not len(self.transitions):
            return
        counts.updates += 1
        job = Job(
            number=counts.updates,
            transitions=self.transitions,
            actions=setting.actions,
            cost=setting.cost,
            fit=setting.fit,
            description=setting.description(),
            names=self.names,
            seed=self.seed * 100_003 + counts.updates,
        )
        self.trainer.submit(job, t)

    def take_over(self, t: float, *, e: float, e_dot: float) -> Result | None:
        """Let a policy that is ready take over, if now is the time; returns what came of its training, if anything.

        e [m], e_dot [m/s]: as the learner sees them. A training that came to nothing is repeated at once where nobody
        but the recovery controller would drive; else the next one comes when it is due.
        """
        if not (self.trusted or self.calm(e, e_dot)):
            return None
        result = self.trainer.poll(t)
        if result is None:
            return None
        self.counts.train_seconds += result.seconds
        if result.fault:
            self.faults.append(result.fault)
        if result.nets is None and result.policy is None:
            if not self.trusted:
                self.train(t, trusted=False)
            return result
        policy = (
            replace(self.policy, nets=result.nets, forecast=result.forecast) if result.policy is None else result.policy
        )
        self.policy, self.net, self.trusted = replace(policy, ready_from=0.0), result.number, True
        return result

    def recovering(self, t: float, *, e: float, e_dot: float) -> str | None:
        """The recovery controller steers at driving time t [s]: why it does not hand over, where that takes long."""
        return self.counts.recovering(t, e=e, e_dot=e_dot, calm=self.setting.calm, busy=self.trainer.busy)

    def calm(self, e: float, e_dot: float) -> bool:
        """Is the car quiet enough on the path for a new net? A setting without `calm` lets the supervisor judge."""
        limit = self.setting.calm
        return abs(e_dot) < limit and (abs(e) < RELEASE or math.isinf(limit))

    def _keep(self, s: tuple[float, ...], action: float, s_next: tuple[float, ...], episode: int) -> None:
        self.transitions.append(s, action, s_next, episode)
        if self._also is not None:
            self._also(s, action, s_next, episode)
