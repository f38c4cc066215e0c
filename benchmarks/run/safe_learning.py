"""Learners with the safety filter and without it: one run each, kept as it ends, so that a stopped study goes on.

Part of the study `safety`. A departure is a run in which |e| exceeds 0.5 m after the first second. Departures are
counted in runs with the filter; those without it are for comparison, and a few seeds of each car will do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.run.kept import Row
from benchmarks.run.trials import Taken, TrialDrive, drive_each, first_good, train
from steerkit.learning.experiment import Experiment
from steerkit.learning.settings import DEFAULT
from steerkit.metrics.signals import largest
from steerkit.scenario import Scenario
from steerkit.task import TRIP


@dataclass(frozen=True)
class Job:
    """A run to be made."""

    scenario: Scenario
    seed: int
    minutes: float
    safe: bool


@dataclass(frozen=True)
class Learner:
    """What one learning run came to; times in seconds of driving, None where it did not happen."""

    car: str
    max_e: float
    """Largest |e| after the first second [m]."""
    good: float | None
    """When the first GOOD net took the wheel; not looked for without the filter."""
    failures: int
    interventions_pct: float
    """Samples of the last minute in which the learner's command was mixed with the backup's."""
    final_rms_e: float
    """Of the final net's test drive, which is without the filter; NaN: there is none."""


def one_run(job: Job) -> Learner:
    """Let one car learn, with the filter or without."""
    scenario, seed = job.scenario, job.seed
    setting = replace(DEFAULT, safe=job.safe)
    trained = train(Experiment(setting=setting, scenario=scenario, minutes=job.minutes, seed=seed))
    log, nets = trained.run.recorder.log(), trained.nets

    def judged(net: Taken) -> TrialDrive:
        return drive_each(scenario, DEFAULT, [net.policy], seed=seed + 1000)[0]

    final = judged(nets[-1]).summary if nets else None
    good = first_good(nets, judged) if job.safe else None
    last = (log.t >= log.t[-1] - 60.0) & (log["supervisor.learning"] > 0.5)
    share = log["safety.share"] if job.safe else np.zeros(len(log.t))
    return Learner(
        car=scenario.name,
        max_e=largest(log["path.e"][log.t > 1.0]),
        good=good,
        failures=trained.run.counts.failures,
        interventions_pct=100.0 * float(np.mean(share[last] > 0.0)) if last.any() else 100.0,
        final_rms_e=final.rms_e if final else float("nan"),
    )


def summarise(learners: Sequence[Row]) -> dict[str, Any]:
    """Counts, medians and worst cases over the runs, as `kept.done` has them; one never GOOD counts as infinite.

    final_rms_x is over those that have a run without the filter of the same car and seed; NaN where none has.
    """
    safe = [run for run in learners if run["safe"]]
    free = {(run["car"], run["seed"]): run for run in learners if not run["safe"]}
    good = np.array([np.inf if run["good"] is None else run["good"] for run in safe])
    pairs = [(run, free[run["car"], run["seed"]]) for run in safe if (run["car"], run["seed"]) in free]
    ratios = [run["final_rms_e"] / other["final_rms_e"] for run, other in pairs]
    own = np.array([run["interventions_pct"] for run in safe])
    return {
        "runs": len(safe),
        "departures": sum(not run["max_e"] <= TRIP for run in safe),
        "max_e": max((run["max_e"] for run in safe), default=float("nan")),
        "runs_without": len(free),
        "departures_without": sum(not run["max_e"] <= TRIP for run in free.values()),
        "good_median_s": float(np.median(good)) if len(safe) else float("nan"),
        "good_worst_s": float(good.max(initial=0.0)),
        "interventions_pct": float(own.max(initial=0.0)),
        "interventions_mean_pct": float(own.mean()) if len(safe) else float("nan"),
        "interventions_above_2_pct": int(np.sum(own > 2.0)),
        "final_rms_x": float(np.nanmedian(ratios)) if np.isfinite(ratios).any() else float("nan"),
        "codes": len({run["code"] for run in learners}),
    }
