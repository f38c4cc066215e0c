"""Cars unlike their data sheet in the report: the learned RMS e falling through the analytic ones over driving time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.entries import ORACLE
from benchmarks.report import figures
from benchmarks.report.conditions import UNITS
from benchmarks.report.learning import Band, learning
from benchmarks.report.parts import controllers, number, of_metric
from benchmarks.run.results import Case, Results
from benchmarks.scenarios import facts
from steerkit.metrics import metric
from steerkit.scenario import Scenario

LEARNED = "learned on this car"
"""What the learner is called in these pictures, whichever its training was."""
_TROUBLE = (
    *("steering.delay", "steering.lag", "steering.offset_deg", "steering.play_deg", "vehicle.ratio", "vehicle.tyres"),
    *("disturbances.wind", "disturbances.gust", "disturbances.bank_deg", "sensors.noise", "sensors.latency"),
)
_SECOND = 1.0 / 60.0  # min


@dataclass(frozen=True)
class Level:
    """The median RMS e of one analytic controller, told one thing."""

    name: str
    """Controller, without what its name says of the telling."""
    truth: bool
    """Was it told the truth, or the data sheet?"""
    rms_e: float
    """[m]; infinite where half the seeds or more were not held."""


@dataclass(frozen=True)
class Panel:
    """One scenario: what was learned over driving time, and what analytic controllers came to."""

    scenario: str
    trouble: str
    """In which ways the car is not what its data sheet says."""
    x: np.ndarray
    """Driving time [min]."""
    learned: Band
    """RMS e of the net in use [m]: median, low and high over the seeds; infinite before the first that held."""
    drives: dict[float, float]
    """Median RMS e of the suite's drives [m] by the minutes that were learned before."""
    levels: tuple[Level, ...]
    seeds: int

    def best(self, *, truth: bool) -> Level | None:
        """The best analytic controller told the truth, or told the data sheet; None if none held it."""
        held = [level for level in self.levels if level.truth is truth and math.isfinite(level.rms_e)]
        return min(held, key=lambda level: level.rms_e, default=None)

    def below(self, *, truth: bool) -> float:
        """Driving time from which on the learned median stays below that of the best analytic one [min], or infinity.

        Where no analytic one held the drive, the learned one is below as soon as it holds.
        """
        best = self.best(truth=truth)
        above = np.flatnonzero(~(self.learned[0] < (math.inf if best is None else best.rms_e)))
        after = int(above[-1]) + 1 if len(above) else 0
        return float(self.x[after]) if after < len(self.x) else math.inf

    def times(self, *, truth: bool) -> float:
        """RMS e at the end of the learning over that of the best analytic controller [1]; NaN where none held."""
        best = self.best(truth=truth)
        return math.nan if best is None else float(self.learned[0][-1]) / best.rms_e


def trained_on(results: Results, case: Case) -> str:
    """The scenario whose car and course a training learned on; empty for any other case."""
    name = str(results.protocol.get(case.scenario, {}).get("name", ""))
    return name if case.kind == "learn" and case.scenario.endswith(f"-on-{name}") else ""


def panels(results: Results, cases: Sequence[Case]) -> list[Panel]:
    """One for every scenario of the suite's finished `cases` that something was learned on; none for other suites."""
    learnt = [c for c in results.cases if c.status == "done" and trained_on(results, c)]
    rows = []
    for scenario in dict.fromkeys(case.scenario for case in cases):
        here = [case for case in learnt if trained_on(results, case) == scenario]
        longest = max((_minutes(results, case) for case in here), default=0.0)
        runs = [case for case in here if _minutes(results, case) == longest]
        curves = learning(results, runs, points=round(longest / _SECOND) + 1) if runs else []
        if curves:
            drives = [case for case in cases if case.scenario == scenario]
            (band,) = curves[0].rms_e.values()
            middle, low, high = (
                np.append(values, values[-1]) for values in band
            )  # the last net has the wheel to the end
            trouble = _trouble(results.protocol.get(scenario, {}))
            after = {_minutes(results, c): _rms_e([d for d in drives if d.controller == c.controller]) for c in here}
            rows.append(
                Panel(
                    scenario,
                    trouble,
                    np.append(curves[0].x, longest),
                    (middle, low, high),
                    after,
                    _levels(results, drives),
                    len(runs),
                )
            )
    return rows


def _minutes(results: Results, case: Case) -> float:
    return float(results.protocol[case.scenario]["minutes"])


def _rms_e(cases: Sequence[Case]) -> float:
    return float(np.median(of_metric(cases, metric("rms_e")))) if cases else math.nan


def _levels(results: Results, drives: Sequence[Case]) -> tuple[Level, ...]:
    entries = results.provenance["controllers"]
    return tuple(
        Level(name.removesuffix(ORACLE), name.endswith(ORACLE), _rms_e([d for d in drives if d.controller == name]))
        for name in controllers(drives)
        if entries.get(name, {}).get("kind") == "analytic"
    )


def _trouble(fields: Mapping[str, Any]) -> str:
    """What is wrong, beyond sensors and motor of `hard` conditions: 'ratio 1.25, tyres 0.6'."""
    usual = facts(Scenario.under("hard"))
    words = [str(fields.get("vehicle.name", ""))]
    for key in _TROUBLE:
        if fields.get(key, usual[key]) != usual[key]:
            name = key.partition(".")[2]
            unit = "°" if name.endswith("_deg") else UNITS.get(name, "")
            words.append(f"{name.removesuffix('_deg')} {fields[key]:g} {unit}".strip())
    return ", ".join(words).strip(", ")


def section(results: Results, cases: Sequence[Case]) -> dict[str, Any] | None:
    """What the page shows of these cases: a sentence, a legend, a picture a scenario; None where nothing is to be."""
    shown = panels(results, cases)
    if not shown:
        return None
    names = dict.fromkeys(level.name for panel in shown for level in panel.levels)
    look = figures.looks([LEARNED, *names])
    span = _span(shown)
    pictures = []
    for panel in shown:
        levels = [(level.name, level.truth, level.rms_e) for level in panel.levels]
        figure = figures.falling(panel.x, panel.learned, panel.drives, levels, look, LEARNED, span=span)
        words = f"{panel.scenario}: RMS e over driving time, learned and analytic"
        pictures.append((f"{panel.scenario}: {panel.trouble}", _caption(panel), figures.svg(figure, words)))
    return {"summary": _summary(shown), "look": look, "pictures": pictures}


def _span(shown: Sequence[Panel]) -> tuple[float, float]:
    """One range of RMS e for all pictures [m]: from the best of all to beyond the worst analytic one."""
    drawn = [level.rms_e for panel in shown for level in panel.levels]
    learned = np.concatenate([panel.learned[0] for panel in shown])
    lines = [value for value in drawn if math.isfinite(value)]
    values = [*lines, *learned[np.isfinite(learned)]]
    return (0.7 * min(values), 1.5 * max(lines or values)) if values else (0.01, 1.0)


def _caption(panel: Panel) -> str:
    said = [f"after {minutes:g} min {number(value)} m" for minutes, value in sorted(panel.drives.items())]
    text = [f"Learned: {', '.join(said)}."]
    for truth, source in ((False, "the data sheet"), (True, "the truth")):
        best, after = panel.best(truth=truth), panel.below(truth=truth)
        shown = "none held" if best is None else f"{number(best.rms_e)} m ({best.name})"
        when = (
            f"learned is below for good after {60.0 * after:.0f} s" if math.isfinite(after) else "learned stays above"
        )
        if truth and best is not None:
            when = f"learned ends at {panel.times(truth=True):.2f} times that"
        text.append(f"Best told {source}: {shown}; {when}.")
        lost = [level.name for level in panel.levels if level.truth is truth and not math.isfinite(level.rms_e)]
        if lost and best is not None:
            text.append(f"Not held: {', '.join(lost)}.")
    return " ".join([*text, f"Seeds: {panel.seeds}."])


def _summary(shown: Sequence[Panel]) -> str:
    reached = [time for panel in shown if math.isfinite(time := panel.below(truth=False))]
    when = f", for good after {60.0 * float(np.median(reached)):.0f} s of driving in the median" if reached else ""
    text = (
        "The learned controller ends with a lower RMS e than the best analytic one that is told the data sheet in "
        f"{len(reached)} of {len(shown)} scenarios{when}."
    )
    times = [ratio for panel in shown if not math.isnan(ratio := panel.times(truth=True))]
    if times:
        text += (
            f" It ends at {np.median(times):.2f} times the RMS e of the best that is told the truth in the median, "
            f"{max(times):.2f} times at worst."
        )
    return text
