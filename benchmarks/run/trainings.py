"""Trainings of the learned controllers: each a case of its own, whose last net all drives of its seed share."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.peers.agents import SETTINGS, stable_baselines
from benchmarks.run.drives import Policy, drive
from benchmarks.run.results import CURVE, good_nets
from benchmarks.run.trials import Taken, TrialDrive, drive_each, train
from steerkit._support.errors import require
from steerkit.controllers.network_policy import PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import offline
from steerkit.learning.settings import Setting, setting
from steerkit.scenario import Scenario
from steerkit.task import DT

EPISODES = (70, 120)
"""Episodes, each followed by one training, after which the paper speaks of a controller's quality."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """Where and how long a learner learns."""

    name: str
    """What it is called in results, after `train-`."""
    scenario: Scenario | None = field(default_factory=Scenario)
    """Course, car, disturbances; None: those of the scenario that is driven afterwards, a training each."""
    minutes: float = 6.0
    """Driving time [min]; recovery and waiting count."""
    episode_metres: float = 0.0
    """Distance after which an episode ends too, and is trained on [m]; 0: as the learner's setting has it."""
    offline_iterations: int = 0
    """Trainings on the recorded transitions after the driving."""

    def at(self, driven: Scenario | None) -> Scenario:
        """Where it learns: its own scenario, or the one `driven` afterwards.

        There the recovery controller is given the steering's delay and lag, which the learner identifies by itself.
        Raises ValueError where neither is given.
        """
        if self.scenario is not None:
            return self.scenario
        require(driven is not None, f"training '{self.name}'", "it is one for each scenario, and none was given")
        assert driven is not None
        return driven.with_(knowledge={"delay": None, "lag": None})


_ALL = (
    Training(name="clean"),
    Training(name="published", minutes=16.0),  # as long as the paper's second round took
    Training(name="quick", minutes=3.0),
    Training(name="genesis", scenario=Scenario(course="genesis", driver={"v_min": 6.0, "v_max": 9.0})),
    Training(name="linear", scenario=Scenario(vehicle={"plant": "linear"})),
    Training(name="hard", scenario=Scenario.under("hard")),
    Training(name="episodes-120", minutes=60.0, episode_metres=200.0),  # else a good episode never ends
    Training(name="offline", minutes=2.0, offline_iterations=20),
    Training(name="agent", minutes=30.0),
    Training(name="same-car-1", scenario=None, minutes=1.0),
    Training(name="same-car-5", scenario=None, minutes=5.0),
)
TRAININGS = {training.name: training for training in _ALL}
"""All trainings by name."""


@dataclass(frozen=True)
class Learnt:
    """What a training came to."""

    metrics: dict[str, float]
    curve: dict[str, np.ndarray]
    policy: NfqPolicy | PolicyBlock


def learn(training: Training, setting_name: str, *, seed: int, driven: Scenario | None = None) -> Learnt:
    """Run a training to its end and test-drive its nets, off the clock: every one of ours, ten of an agent's.

    Test drives are of another seed than the training. With its own scenario, the training has `seed`; on the scenario
    `driven`, the test drives have it, so that they are the very drive that the analytic controllers make there.
    """
    learns, drives_with = (seed, seed + 1000) if training.scenario is not None else (seed + 1000, seed)
    if setting_name in SETTINGS:
        return _agent(training, setting_name, seed)
    how = setting(setting_name)
    if training.episode_metres:
        how = replace(how, retrain_every_m=training.episode_metres)
    experiment = Experiment(setting=how, scenario=training.at(driven), minutes=training.minutes, seed=learns)
    trained = train(experiment)
    run = trained.run
    nets = trained.nets + _offline(training, how, run, learns)
    drives = drive_each(experiment.scenario, how, [net.policy for net in nets], seed=drives_with)
    policy = nets[-1].policy if nets else run.policy
    episodic = how.retrain_every_m == 0.0 or training.episode_metres > 0.0  # one training an episode
    return Learnt(_metrics(run, nets, drives, episodic=episodic), _curve(nets, drives), policy)


def _agent(training: Training, setting_name: str, seed: int) -> Learnt:
    """An agent of Stable-Baselines3 on the 800 m course."""
    place = Scenario(name="check")

    def judge(block: PolicyBlock) -> dict[str, float]:
        return drive(place, setting_name, seed=seed + 1000, policy=Policy(block, setting_name)).metrics

    steps = round(60.0 * training.minutes / DT)
    block, curve = stable_baselines(SETTINGS[setting_name], steps=steps, seed=seed, judge=judge)
    good = np.flatnonzero(good_nets(curve))
    metrics = {
        "transitions": float(curve["transitions"][-1]),
        "driving_minutes": training.minutes,
        "good_minutes": float(curve["t"][good[0]]) / 60.0 if len(good) else math.inf,
        **{name: float(curve[name][-1]) for name in ("held", "rms_e", "max_e", "max_a_y", "max_jerk")},
    }
    return Learnt(metrics, curve, block)


def _offline(training: Training, how: Setting, run: LearningRun, seed: int) -> list[Taken]:
    if not training.offline_iterations:
        return []
    policies = offline(run.transitions, how, training.offline_iterations, seed=seed)
    return [Taken(run.t, run.counts.failures, len(run.transitions), policy) for policy in policies]


def _metrics(
    run: LearningRun, nets: Sequence[Taken], drives: Sequence[TrialDrive], *, episodic: bool
) -> dict[str, float]:
    counts = run.counts
    good = next((i for i, trial in enumerate(drives) if trial.good), None)
    rounds = counts.first_round_done
    metrics = {
        "round_minutes": math.inf if rounds is None else rounds / 60.0,
        "round_episodes": math.inf if counts.failures_to_round is None else counts.failures_to_round + 1.0,
        "good_minutes": math.inf if good is None else nets[good].t / 60.0,
        "good_episodes": math.inf if good is None else nets[good].failures + 1.0,
        "transitions": float(len(run.transitions)),
        "failures": float(counts.failures),
        "driving_minutes": run.t / 60.0,
        "trainings": float(len(nets)),
        "last_nets_hold": float(np.mean([trial.held for trial in drives[-20:]])) if drives else 0.0,
        "held": float(bool(drives) and drives[-1].held),
    }
    if drives and drives[-1].summary is not None:
        last = drives[-1].summary
        metrics |= {name: float(getattr(last, name)) for name in type(last).__dataclass_fields__}
    for number in EPISODES if episodic else ():
        if len(drives) >= number:
            trial = drives[number - 1]
            metrics[f"held_after_{number}"] = float(trial.held)
            metrics[f"max_e_after_{number}"] = trial.summary.max_e if trial.summary else math.nan
    return metrics


def _curve(nets: Sequence[Taken], drives: Sequence[TrialDrive]) -> dict[str, np.ndarray]:
    rows = []
    for number, (net, trial) in enumerate(zip(nets, drives, strict=True), start=1):
        row: dict[str, Any] = {
            "t": net.t,
            "iterations": number,
            "transitions": net.transitions,
            "failures": net.failures,
            "held": trial.held,
            "rounds": trial.rounds,
        }
        rows.append([float(row[n] if n in row else getattr(trial.summary, n, math.nan)) for n in CURVE])
    columns = np.array(rows, dtype=float).reshape(len(rows), len(CURVE)).T
    return dict(zip(CURVE, columns, strict=True))
