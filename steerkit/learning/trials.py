"""Test drives of many policies at once, in compiled code: for judging every net of a run, or one from many starts."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from steerkit.compiled import Compiled, compile
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.learning.settings import Setting
from steerkit.metrics import GOOD, Summary, of_log
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate
from steerkit.simulation import Log
from steerkit.task import TRIP

SIGNALS = ("path.e", "path.progress", "car.delta_sw", "car.a_y", "supervisor.learning")
WEIGHTS = "controller.block.weights"
WORTH_COMPILING = 12
"""Policies of one layout from which on compiling a loop for them takes less time than driving them one by one."""
LARGEST_COMPILED = 8
"""Nets of a policy up to which that is so: with 16 and their weights left open the C compiler takes minutes."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrialDrive:
    """What became of one policy's test drive."""

    rounds: float
    """Rounds driven before the recovery controller had to take the wheel, or until the end [1]."""
    held: bool
    """Did it keep the wheel, with |e| <= 0.5 m, for all the rounds asked for?"""
    summary: Summary | None
    """Metrics of the part it drove; None if that was less than a second."""

    @property
    def good(self) -> bool:
        """Did it hold its one round, and meet the bounds of a good driver (`steerkit.metrics.GOOD`)?"""
        return self.held and self.summary is not None and GOOD.met(self.summary, rounds=1.0)


def drive_many(
    scenario: Scenario, setting: Setting, policies: Sequence[NfqPolicy], *, seed: int = 0, rounds: float = 1.0
) -> list[TrialDrive]:
    """Let each policy drive `rounds` rounds of the scenario's course, all with the same human and sensors (`seed`).

    The policies must share layout, actions and description: they differ in weights. The same numbers as
    `evaluate.drive`, to rounding. Raises ValueError for policies that do not fit together.
    """
    if not policies:
        return []
    first = policies[0]
    if len({_Layout(policy) for policy in policies}) > 1:
        raise ValueError("drive_many: policies of different layouts or actions; judge them in separate calls")
    compiled = _compiled(scenario, setting, _Layout(first))
    start = evaluate.drive_loop(scenario, first.with_weights(), doe=setting.element(scenario.nominal), seed=seed).init()
    asked = dataclasses.replace(scenario, rounds=rounds)
    length, duration = asked.length, asked.seconds
    weights = np.array([policy.flat_weights() for policy in policies]).T
    log = compiled.run(duration, state=start, parameters={WEIGHTS: weights}, allow_nonfinite=True)
    return [_judged(log, car, length) for car in range(len(policies))]


def drive_each(scenario: Scenario, setting: Setting, policies: Sequence[Any], *, seed: int = 0) -> list[TrialDrive]:
    """Let each policy drive one round, all with the same human and sensors (`seed`).

    Many nets of one layout drive all at once, in compiled code; few, and policies that are no nets, one by one, which
    takes a second or two each.
    """
    if not all(isinstance(policy, NfqPolicy) for policy in policies):
        return [_drive_one(scenario, setting, policy, seed) for policy in policies]
    layouts: dict[_Layout, list[int]] = {}
    for i, policy in enumerate(policies):
        layouts.setdefault(_Layout(policy), []).append(i)
    drives: dict[int, TrialDrive] = {}
    for rows in layouts.values():
        some = [policies[i] for i in rows]
        if len(rows) < WORTH_COMPILING or len(some[0].nets or ()) > LARGEST_COMPILED:
            drives |= zip(rows, [_drive_one(scenario, setting, policy, seed) for policy in some])
        else:
            drives |= zip(rows, drive_many(scenario, setting, some, seed=seed))
    return [drives[i] for i in range(len(policies))]


def _drive_one(scenario: Scenario, setting: Setting, policy: Any, seed: int) -> TrialDrive:
    log = evaluate.drive(
        scenario, policy, doe=setting.element(scenario.nominal), seed=seed, rounds=1.0, only_while_held=True
    )
    one_car = Log(log.t, {name: log[name][:, None] for name in SIGNALS}, log.units)
    return _judged(one_car, 0, scenario.round_length)


def _judged(log: Log, car: int, length: float) -> TrialDrive:
    e, progress = log["path.e"][:, car], log["path.progress"][:, car]
    lost = (log["supervisor.learning"][:, car] < 0.5) | ~(np.abs(e) <= TRIP)
    over = progress >= length
    end = min(_first(lost), _first(over) + 1)
    part = Log(log.t[:end], {name: log[name][:end, car] for name in SIGNALS}, log.units)
    driven = float(progress[max(0, end - 1)])
    return TrialDrive(
        rounds=driven / length,
        held=bool(over.any()) and _first(over) < _first(lost),
        summary=of_log(part) if end > 20 else None,
    )


def _first(flags: np.ndarray) -> int:
    return int(flags.argmax()) if flags.any() else len(flags)


class _Layout:
    """A policy as a cache key: what its compiled loop depends on, which is all but its weights."""

    def __init__(self, policy: NfqPolicy):
        self.policy = policy
        shapes = tuple(p.shape for net in policy.nets or () for p in net)
        dead = None if policy.forecast is None else policy.forecast.samples
        how = (policy.combine, policy.continuous, policy.preview_points, policy.dt)
        self.key = (shapes, dead, policy.actions, repr(policy.description), how)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Layout) and self.key == other.key


@lru_cache(maxsize=8)
def _compiled(scenario: Scenario, setting: Setting, layout: _Layout) -> Compiled:
    loop = evaluate.drive_loop(scenario, layout.policy.with_weights(), doe=setting.element(scenario.nominal))
    ticks = round(layout.policy.dt / loop.dt)
    return compile(loop, record=SIGNALS, every=ticks, parameters=[WEIGHTS])
