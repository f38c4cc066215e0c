"""How well a car was steered and what learning it cost, in numbers with sources; `table.TABLE` lists them all."""

from steerkit.metrics.comfort import (
    JERK_WINDOW,
    lateral_jerk,
    r79_acceleration,
    r79_jerk,
    wd_filter,
    weighted_acceleration,
)
from steerkit.metrics.drive import GOOD, Criterion, Summary, measures, measures_of_log, of_log, step_times, summary
from steerkit.metrics.learners import Learned, learned
from steerkit.metrics.signals import largest, magnitude_at, rates, rms, share_within, time_over
from steerkit.metrics.statistics import Interval, Paired, interval, paired, share
from steerkit.metrics.steering import accelerations, reversal_rate
from steerkit.metrics.table import TABLE, Metric, metric

__all__ = [
    "GOOD",
    "JERK_WINDOW",
    "TABLE",
    "Criterion",
    "Interval",
    "Learned",
    "Metric",
    "Paired",
    "Summary",
    "accelerations",
    "interval",
    "largest",
    "lateral_jerk",
    "learned",
    "magnitude_at",
    "measures",
    "measures_of_log",
    "metric",
    "of_log",
    "paired",
    "r79_acceleration",
    "r79_jerk",
    "rates",
    "reversal_rate",
    "rms",
    "share",
    "share_within",
    "step_times",
    "summary",
    "time_over",
    "wd_filter",
    "weighted_acceleration",
]
