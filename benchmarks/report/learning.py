"""Learning in the report: curves over driving time and over trainings, and what it cost until it worked."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.report.parts import of_metric
from benchmarks.run.results import Case, Results, good_nets
from benchmarks.statistics import Interval, interval, share
from steerkit.metrics import TABLE, Metric

Curve = Mapping[str, np.ndarray]
Band = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Curves:
    """Learning over x: by controller (middle, low, high), each over x."""

    scenario: str
    label: str
    """What x is, with its unit."""
    x: np.ndarray
    rms_e: dict[str, Band]
    good: dict[str, Band]
    seeds: dict[str, int]


def learning(results: Results, cases: Sequence[Case], *, points: int = 80) -> list[Curves]:
    """Curves by scenario: RMS e of the net in use, and the share of seeds whose net is GOOD.

    First those over driving time, then, for scenarios whose nets went on being trained after the driving, those over
    the number of trainings. A seed's value is that of the last net that had taken the wheel; before the first it
    counts as never.
    """
    by_time, by_training = [], []
    for scenario, learners in _runs(results, cases).items():
        runs = [c for them in learners.values() for c in them]
        x = np.linspace(0.0, max(float(c["t"].max()) for c in runs) / 60.0, points)
        by_time.append(_curves(scenario, "driving time [min]", learners, x, lambda c: c["t"] / 60.0))
        if all(np.count_nonzero(c["t"] == c["t"].max()) >= 3 for c in runs):
            x = np.arange(max(len(c["t"]) for c in runs) + 1.0)
            by_training.append(_curves(scenario, "trainings", learners, x, lambda c: np.arange(1.0, len(c["t"]) + 1)))
    return by_time + by_training


def _runs(results: Results, cases: Sequence[Case]) -> dict[str, dict[str, list[Curve]]]:
    """Curves of the finished trainings, by scenario and controller."""
    runs: dict[str, dict[str, list[Curve]]] = {}
    for case in (c for c in cases if c.kind == "learn" and c.status == "done"):
        curve = results.curve(case)
        if curve is not None and len(curve["t"]):
            runs.setdefault(case.scenario, {}).setdefault(case.controller, []).append(curve)
    return runs


def _curves(
    scenario: str, label: str, learners: Mapping[str, list[Curve]], x: np.ndarray, at: Callable[[Curve], np.ndarray]
) -> Curves:
    rms_e, good = dict[str, Band](), dict[str, Band]()
    for name, runs in learners.items():
        errors = [np.where(np.isfinite(c["rms_e"]) & (c["held"] > 0.5), c["rms_e"], np.inf) for c in runs]
        held_at = [_held_at(at(c), rms, x, math.inf) for c, rms in zip(runs, errors, strict=True)]
        rms_e[name] = _band(held_at, lambda rms: interval(rms, np.median))
        good[name] = _band([_held_at(at(c), good_nets(c), x, 0.0) for c in runs], lambda held: share(held > 0.5))
    return Curves(scenario, label, x, rms_e, good, {name: len(runs) for name, runs in learners.items()})


def _held_at(at: np.ndarray, values: np.ndarray, x: np.ndarray, before: float) -> np.ndarray:
    """At each x the value of the last net that stood by then; before the first, `before`."""
    return np.concatenate([[before], values])[np.searchsorted(at, x, side="right")]


def _band(rows: list[np.ndarray], of: Callable[[np.ndarray], Interval]) -> Band:
    """Value, low and high of each column; between two new nets columns repeat, and are worked out once."""
    columns, which = np.unique(np.array(rows), axis=1, return_inverse=True)
    bands = np.array([(i.value, i.low, i.high) for i in map(of, columns.T)])[which]
    return bands[:, 0], bands[:, 1], bands[:, 2]


@dataclass(frozen=True)
class Cost:
    """What it cost one learner."""

    scenario: str
    controller: str
    seeds: int
    medians: tuple[Interval, ...]
    """One a metric, with bootstrap intervals."""
    rounds: Interval
    """Share of the seeds that drove a whole round."""
    good: Interval
    """Share of the seeds that came to a GOOD controller."""


def costs(cases: Sequence[Case]) -> tuple[list[Metric], list[Cost]]:
    """What learning cost, by scenario and learner; and the metrics of which there are medians."""
    learnt = [c for c in cases if c.kind == "learn" and c.status == "done"]
    columns = [m for m in TABLE if m.group == "learning" and any(m.name in c.metrics for c in learnt)]
    rows = []
    for scenario, name in dict.fromkeys((c.scenario, c.controller) for c in learnt):
        here = [c for c in learnt if (c.scenario, c.controller) == (scenario, name)]
        medians = tuple(interval(of_metric(here, m), np.median) for m in columns)
        rows.append(
            Cost(scenario, name, len(here), medians, _reached(here, "round_minutes"), _reached(here, "good_minutes"))
        )
    return columns, rows


def _reached(cases: Sequence[Case], name: str) -> Interval:
    return share([math.isfinite(case.metrics.get(name, math.nan)) for case in cases])
