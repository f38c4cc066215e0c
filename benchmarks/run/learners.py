"""A learner of a study: its run, the test drives of its nets, what it came to, and who it is compared with."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.foreign_cars import scene
from benchmarks.run.kept import Row
from benchmarks.run.trials import Taken, TrialDrive, drive_each, train
from steerkit.learning.experiment import Experiment
from steerkit.learning.settings import DEFAULT
from steerkit.metrics import GOOD, Criterion, Summary, of_log
from steerkit.scenario import Scenario, drive

OTHER = 1000
"""What is added to a run's seed for the driver and the sensors of test drives."""
FIRST_NETS = 12
"""So many of a run's first nets are test-driven in search of the first good one, then every fourth."""
TOLD = ("stanley-delay", "lqr", "mpc", "lqr-offset-free", "lqr-adaptive", "mpc-adaptive")
"""Those of which the best is compared with."""
EASED = 1.1
"""A net is good with what GOOD asks for, or with so many times what the best one that is told reaches [1]."""
_STRETCH = 400.0  # m: over which the wheel rates of the last nets are compared


class Learner:
    """A learning run that has ended; a net is test-driven when it is asked for, a whole round with another seed.

    criterion: what a good net keeps to.
    """

    def __init__(self, experiment: Experiment, criterion: Criterion = GOOD):
        self.experiment, self.criterion = experiment, criterion
        self.trained = train(experiment)
        self._drives = dict[int, TrialDrive]()

    def drive(self, net: Taken) -> TrialDrive:
        """The test drive of a net of the run."""
        if id(net) not in self._drives:
            scenario, setting = self.experiment.scenario, self.experiment.setting
            (made,) = drive_each(scenario, setting, [net.policy], seed=self.experiment.seed + OTHER)
            self._drives[id(net)] = replace(made, criterion=self.criterion)
        return self._drives[id(net)]

    @property
    def final(self) -> TrialDrive | None:
        """The test drive of the last net, if there is one."""
        return self.drive(self.trained.nets[-1]) if self.trained.nets else None

    def figures(self, *, every: int = 4, look_for_good: bool = True) -> dict[str, Any]:
        """What the run and its final net came to; every: as for `first_good`.

        first_round_done, good: when it came, and when the first good net took the wheel [s] of driving; None: never.
        departure: largest true |e| of the whole run, first failure and recovery included [m]. stuck: how often recovery
        steered for 20 s without getting to hand over. held: did the final net drive the round, with |e| <= 0.5 m? Then
        figures of its test drive, NaN where there is none: [m], [deg/s] (RMS), jerk smoothed over 0.5 s [m/s^3].
        dead_time: that the learner found [s].
        """
        run, nets, final = self.trained.run, self.trained.nets, self.final
        summary = final.summary if final else None
        forecast = nets[-1].policy.forecast if nets else None
        return {
            "first_round_done": run.counts.first_round_done,
            "good": first_good(nets, self.drive, every) if look_for_good else None,
            "failures": run.counts.failures,
            "departure": float(np.abs(run.recorder.log()["path.e"]).max()),
            "stuck": len(run.counts.stuck),
            "transitions": len(run.transitions),
            "nets": len(nets),
            "held": final is not None and final.held,
            "final_rms_e": summary.rms_e if summary else math.nan,
            "final_max_e": summary.max_e if summary else math.nan,
            "final_wheel_rate_deg": summary.rms_wheel_rate_deg if summary else math.nan,
            "final_max_jerk": summary.max_jerk if summary else math.nan,
            "dead_time": forecast.samples * nets[-1].policy.dt if forecast else 0.0,
        }


def first_good(nets: Sequence[Taken], judged: Callable[[Taken], TrialDrive], every: int = 4) -> float | None:
    """When the first good net took the wheel [s]; after the first dozen, one of so many is judged."""
    for i, net in enumerate(nets):
        if (i < FIRST_NETS or i % every == 0) and judged(net).good:
            return net.t
    return None


def over(trial: TrialDrive | None, metric: str, other: Summary) -> float:
    """A figure of a test drive over another's; infinite if it did not hold."""
    if trial is None or not trial.held or trial.summary is None:
        return math.inf
    return float(getattr(trial.summary, metric) / getattr(other, metric))


def best_told(scenario: Scenario, names: Iterable[str], seed: int) -> tuple[str, Summary]:
    """`best_of` analytic controllers that are told all that can be told."""
    return best_of(scenario.with_(knowledge={"oracle": True, "delay": None, "lag": None}), names, seed)


def best_of(scenario: Scenario, names: Iterable[str], seed: int) -> tuple[str, Summary]:
    """The controller of the least RMS e on a whole test drive, and its metrics; one that was lost only if all were."""
    rows = [(name, of_log(drive.drive(scenario, drive.controller(name, scenario), seed=seed))) for name in names]
    return min(rows, key=lambda row: row[1].rms_e if math.isfinite(row[1].rms_e) else math.inf)


def values(rows: Sequence[Row], name: str) -> Any:
    """A field of the rows, (n,); what never happened (None) or has no figure (NaN) is infinite."""
    found = np.array([math.inf if row[name] is None else row[name] for row in rows], dtype=float)
    return np.where(np.isnan(found), math.inf, found)


def median(rows: Sequence[Row], name: str) -> float:
    """The median of `values`."""
    return float(np.median(values(rows, name)))


def worst(rows: Sequence[Row], name: str) -> float:
    """The largest of `values`."""
    return float(values(rows, name).max())


def share(rows: Sequence[Row], name: str) -> float:
    """In what share of the rows it happened: a field that is neither None nor False [1]."""
    return float(np.mean([row[name] is not None and row[name] is not False for row in rows]))


def good(rows: Sequence[Row]) -> dict[str, float]:
    """How many came to a good net, and how soon."""
    return {
        "good_share": share(rows, "good"),
        "good_median_s": median(rows, "good"),
        "good_worst_s": worst(rows, "good"),
    }


@dataclass(frozen=True)
class Job:
    """A learner to be run on a car that no one here wrote: a part of the study `foreign`."""

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


def one_learner(job: Job) -> dict[str, Any]:
    """Run it and compare its nets with the best analytic controller; a net is good by the criterion of `eased`.

    rms_x: RMS e of the final net over the best one's, infinite for one that did not hold; rms_x_1: the same of the net
    that steered after a minute. wheel_spread: by what factor the wheel rate of one of the last nets is off their
    median; infinite if one did not hold.
    """
    scenario, test = scene(job.car, job.v_min, job.v_max, job.seed, job.conditions), job.seed + OTHER
    best, told = best_told(scenario.with_(course={"rounds": job.rounds}), job.told, test)
    learner = Learner(Experiment(setting=DEFAULT, scenario=scenario, minutes=job.minutes, seed=job.seed), eased(told))
    nets = learner.trained.nets
    early = [net for net in nets if net.t <= 60.0]
    return {
        **learner.figures(),
        "best": best,
        "best_rms_e": told.rms_e,
        "best_wheel_deg": told.rms_wheel_rate_deg,
        "best_good": GOOD.met(told),
        "rms_x": over(learner.final, "rms_e", told),
        "rms_x_1": over(learner.drive(early[-1]) if early else None, "rms_e", told),
        "wheel_x": over(learner.final, "rms_wheel_rate_deg", told),
        "wheel_spread": spread([wheel_rate(scenario, net, test) for net in nets[-job.last :]]),
    }


def eased(told: Summary) -> Criterion:
    """GOOD, where the best told controller is within it with a tenth to spare; else EASED times what that one reaches:
    a bound that the car's own wander and slew break under any controller says nothing of a net."""
    bounds = {name: max(getattr(GOOD, name), EASED * getattr(told, name)) for name in ("max_e", "rms_e", "max_jerk")}
    return Criterion(**{name: bound if math.isfinite(bound) else getattr(GOOD, name) for name, bound in bounds.items()})


def wheel_rate(scenario: Scenario, net: Taken, seed: int) -> float:
    """RMS wheel rate of a net [deg/s] on the first 400 m of a round; infinite if it does not hold them."""
    part = min(1.0, _STRETCH / scenario.round_length)
    doe = DEFAULT.element(scenario.nominal)
    log = drive.drive(scenario, net.policy, doe=doe, seed=seed, rounds=part, only_while_held=True)
    return of_log(log).rms_wheel_rate_deg if drive.held_all_along(log) else math.inf


def spread(rates: list[float]) -> float:
    """By what factor the one that is furthest off is off their median; infinite if one is, NaN for none."""
    if not rates or not np.isfinite(rates).all():
        return math.inf if rates else math.nan
    middle = float(np.median(rates))
    return max(max(rates) / middle, middle / min(rates))
