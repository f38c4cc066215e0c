"""What studies and suites judge of learning: a whole run with every net that took the wheel, and their test drives."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.run.drives import own_part, until_end
from benchmarks.run.policy_drives import PolicyDrives, policy_drives
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.simulation import Log
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.settings import Setting
from steerkit.metrics import GOOD, Criterion, Summary, of_log
from steerkit.scenario import Scenario
from steerkit.scenario.drive import drive_loop


@dataclass(frozen=True)
class Taken:
    """A net, and what had happened when it took the wheel."""

    t: float
    """Driving time [s]."""
    failures: int
    transitions: int
    policy: Any


@dataclass(frozen=True)
class Trained:
    """A learning run that has ended, and every net that took the wheel in it."""

    run: LearningRun
    nets: list[Taken]
    longest_training: float
    """Computing time of the longest training [s]."""


def train(experiment: Experiment) -> Trained:
    """Run an experiment to its end."""
    nets: list[Taken] = []
    trainings: list[float] = [0.0]

    def watch(what: str, run: LearningRun) -> None:
        if what == "trained":
            nets.append(Taken(run.t, run.counts.failures, len(run.transitions), run.policy))

    run = LearningRun(experiment, watch)
    while not run.done():
        run.drive()
        if run.counts.train_seconds > trainings[-1]:
            trainings.append(run.counts.train_seconds)
    return Trained(run, nets, float(np.diff(trainings).max(initial=0.0)))


SIGNALS = ("path.e", "path.progress", "car.delta_sw", "car.a_y", "supervisor.learning")


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrialDrive:
    """What became of one policy's test drive."""

    rounds: float
    """Rounds driven before the recovery controller had to take the wheel, or until the end [1]."""
    held: bool
    """Did it keep the wheel, with |e| <= 0.5 m, for all the rounds asked for?"""
    summary: Summary | None
    """Metrics of the part it drove; None if that was less than a second."""
    criterion: Criterion = GOOD
    """What a good driver keeps to."""

    @property
    def good(self) -> bool:
        """Did it hold its one round, and meet the bounds of a good driver?"""
        return self.held and self.summary is not None and self.criterion.met(self.summary)


def drive_each(scenario: Scenario, setting: Setting, policies: Sequence[Any], *, seed: int = 0) -> list[TrialDrive]:
    """Let each policy drive one round, all with the same driver and sensors (`seed`).

    Nets with the same ports share one compiled loop, to the numbers of the interpreted drive; policies that are no
    nets, or that drive in a loop that cannot be compiled, are interpreted, which takes a second or two each.
    """
    return [_drive_one(scenario, setting, policy, seed) for policy in policies]


def _drive_one(scenario: Scenario, setting: Setting, policy: Any, seed: int, *, compiled: bool = True) -> TrialDrive:
    drives = _drives(scenario, setting, policy.preview_points) if compiled and isinstance(policy, NfqPolicy) else None
    one_round, length = scenario.with_(course={"rounds": 1.0}), scenario.round_length
    loop = drive_loop(one_round, policy, doe=setting.element(scenario.nominal), seed=seed)
    log = until_end(loop, one_round.seconds, length, SIGNALS, drives)
    end, held = own_part(log, length)
    part = Log(log.t[:end], {name: log[name][:end] for name in SIGNALS}, log.units)
    return TrialDrive(
        rounds=float(log["path.progress"][max(0, end - 1)]) / length,
        held=held,
        summary=of_log(part) if end > 20 else None,
    )


@lru_cache(maxsize=8)
def _drives(scenario: Scenario, setting: Setting, points: int) -> PolicyDrives | None:
    """The compiled drives that all nets with such a preview share; None: interpreted."""
    loop = drive_loop(scenario, NfqPolicy(preview_points=points), doe=setting.element(scenario.nominal))
    return policy_drives(loop, SIGNALS)
