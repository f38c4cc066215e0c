"""A whole learning run, and every net that took the wheel in it: what studies and suites judge."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from steerkit.learning.experiment import Experiment, LearningRun


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
    computing: float
    """Wall time of the run [s]."""


def train(experiment: Experiment) -> Trained:
    """Run an experiment to its end."""
    nets: list[Taken] = []
    trainings: list[float] = [0.0]

    def watch(what: str, run: LearningRun) -> None:
        if what == "trained":
            nets.append(Taken(run.t, run.counts.failures, len(run.transitions), run.policy))

    began = time.perf_counter()
    run = LearningRun(experiment, watch)
    while not run.done():
        run.drive()
        if run.counts.train_seconds > trainings[-1]:
            trainings.append(run.counts.train_seconds)
    return Trained(run, nets, float(np.diff(trainings).max(initial=0.0)), time.perf_counter() - began)
