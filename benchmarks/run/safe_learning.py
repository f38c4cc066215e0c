"""Learners with the safety filter and without it: one run each, kept as it ends, so that a stopped study goes on.

Part of the study `safety`. A departure is a run in which |e| exceeds 0.5 m after the first second. Departures are
counted in runs with the filter; those without it are for comparison, and a few seeds of each car will do.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.run.kept import Row
from benchmarks.run.learners import Learned, Learner, values
from steerkit.learning.experiment import Experiment
from steerkit.metrics.signals import largest
from steerkit.task import TRIP


@dataclass(frozen=True, kw_only=True)
class Safe(Learned):
    """What a run came to; a good net is looked for only with the filter, and test drives are without it."""

    car: str
    safe: bool
    """With the filter?"""
    max_e: float
    """Largest |e| after the first second [m]."""
    interventions_pct: float
    """Samples of the last minute in which the learner's command was mixed with the backup's."""


def one_run(experiment: Experiment) -> Safe:
    """Let one car learn, with the filter or without."""
    learner, safe = Learner(experiment), experiment.setting.safe
    log = learner.trained.run.recorder.log()
    last = (log.t >= log.t[-1] - 60.0) & (log["supervisor.learning"] > 0.5)
    share = log["safety.share"] if safe else np.zeros(len(log.t))
    return Safe(
        **learner.figures(look_for_good=safe),
        car=experiment.scenario.name,
        safe=safe,
        max_e=largest(log["path.e"][log.t > 1.0]),
        interventions_pct=100.0 * float(np.mean(share[last] > 0.0)) if last.any() else 100.0,
    )


def summarise(learners: Sequence[Row]) -> dict[str, Any]:
    """Counts, medians and worst cases over the runs, as `kept.done` has them; one never GOOD counts as infinite.

    final_rms_x is over those that have a run without the filter of the same car and seed; NaN where none has.
    """
    safe = [run for run in learners if run["safe"]]
    free = {(run["car"], run["seed"]): run for run in learners if not run["safe"]}
    pairs = [(run, free[run["car"], run["seed"]]) for run in safe if (run["car"], run["seed"]) in free]
    ratios = [run["final_rms_e"] / other["final_rms_e"] for run, other in pairs]
    good, own = values(safe, "good"), values(safe, "interventions_pct")
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
