"""One learner on a car that no one here wrote, beside the best analytic controller that is told all that can be told.

Part of the study `foreign`. Test drives are a whole round of the course, with another seed than the learner's.
"""

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.foreign_cars import scene
from benchmarks.run.learners import OTHER, Learned, Learner, best_told, over
from benchmarks.run.trials import Taken
from steerkit.learning.experiment import Experiment
from steerkit.learning.settings import DEFAULT
from steerkit.metrics import GOOD, Criterion, Summary, of_log
from steerkit.scenario import Scenario, drive

TOLD = ("stanley-delay", "lqr", "mpc", "lqr-offset-free", "lqr-adaptive", "mpc-adaptive")
"""Those of which the best is compared with."""
EASED = 1.1
"""A net is good with what GOOD asks for, or with so many times what the best one that is told reaches [1]."""
_STRETCH = 400.0  # m: over which the wheel rates of the last nets are compared


@dataclass(frozen=True)
class Job:
    """A learner to be run."""

    car: str
    v_min: float
    v_max: float
    seed: int
    minutes: float
    conditions: str
    last: int
    """Of how many of the last nets the wheel rates are compared."""
    told: tuple[str, ...] = TOLD
    """Analytic controllers to compare with."""
    rounds: float = 1.0
    """That those drive."""


@dataclass(frozen=True, kw_only=True)
class Compared(Learned):
    """What became of it, beside the best analytic controller; good: by the criterion of `eased`."""

    best: str
    """The analytic controller of the least RMS e."""
    best_rms_e: float
    best_wheel_deg: float
    best_good: bool
    """Is that one GOOD (`steerkit.metrics.GOOD`)?"""
    rms_x: float
    """RMS e of the final net over the best one's; infinite for one that did not hold."""
    rms_x_1: float
    """The same of the net that steered after a minute."""
    wheel_x: float
    wheel_spread: float
    """By what factor the wheel rate of one of the last nets is off their median; infinite if one did not hold."""


def one_learner(job: Job) -> Compared:
    """Run it and compare its nets."""
    scenario, test = scene(job.car, job.v_min, job.v_max, job.seed, job.conditions), job.seed + OTHER
    best, told = best_told(scenario.with_(course={"rounds": job.rounds}), job.told, test)
    learner = Learner(Experiment(setting=DEFAULT, scenario=scenario, minutes=job.minutes, seed=job.seed), eased(told))
    nets = learner.trained.nets
    early = [net for net in nets if net.t <= 60.0]
    return Compared(
        **learner.figures(),
        best=best,
        best_rms_e=told.rms_e,
        best_wheel_deg=told.rms_wheel_rate_deg,
        best_good=GOOD.met(told),
        rms_x=over(learner.final, "rms_e", told),
        rms_x_1=over(learner.drive(early[-1]) if early else None, "rms_e", told),
        wheel_x=over(learner.final, "rms_wheel_rate_deg", told),
        wheel_spread=spread([wheel_rate(scenario, net, test) for net in nets[-job.last :]]),
    )


def eased(told: Summary) -> Criterion:
    """GOOD, where the best told controller is within it with a tenth to spare; else EASED times what that one reaches:
    a bound that the car's own wander and slew break under any controller says nothing of a net."""
    bounds = {name: max(getattr(GOOD, name), EASED * getattr(told, name)) for name in ("max_e", "rms_e", "max_jerk")}
    return Criterion(**{name: bound if math.isfinite(bound) else getattr(GOOD, name) for name, bound in bounds.items()})


def wheel_rate(scenario: Scenario, net: Taken, seed: int) -> float:
    """RMS wheel rate of a net [deg/s] on the first 400 m of a round; infinite if it does not hold them."""
    share = min(1.0, _STRETCH / scenario.round_length)
    doe = DEFAULT.element(scenario.nominal)
    log = drive.drive(scenario, net.policy, doe=doe, seed=seed, rounds=share, only_while_held=True)
    return of_log(log).rms_wheel_rate_deg if drive.held_all_along(log) else math.inf


def spread(rates: list[float]) -> float:
    """By what factor the one that is furthest off is off their median; infinite if one is, NaN for none."""
    if not rates or not np.isfinite(rates).all():
        return math.inf if rates else math.nan
    middle = float(np.median(rates))
    return max(max(rates) / middle, middle / min(rates))
