"""What the report says of controllers: leaderboards, and comparisons seed for seed."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.run.results import Case, Results
from steerkit.metrics import TABLE, Metric

_AT_THE_FRONT = "of the front axle, wherever the controller has its own measured"
_FRONT = tuple(
    replace(m, name=f"{m.name}_front", label=f"{m.label}, front axle", what=f"{m.what}, {_AT_THE_FRONT}", limit=None)
    for m in TABLE
    if m.name in ("rms_e", "max_e")
)
METRICS = tuple(m for known in TABLE for m in ((known, *_FRONT) if known.name == "max_e" else (known,)))
"""The table's metrics, and those that the suites measure besides, in the order of the report."""
_BY_NAME = {m.name: m for m in METRICS}
BOARD = (
    "rms_e",
    "rms_e_front",
    "p95_e",
    "max_e",
    "share_within_5cm",
    "rms_wheel_rate_deg",
    "large_reversals",
    "max_a_y",
    "max_jerk",
    "weighted_a_y",
    "step_p50_us",
)
"""Columns of a leaderboard."""

Drives = dict[str, dict[str, dict[int, Case]]]
"""Cases by controller, scenario and seed."""


@dataclass(frozen=True)
class Cell:
    """One number of a table: what is shown, what it is sorted by, what hovering tells."""

    text: str
    value: float = math.nan
    title: str = ""
    best: bool = False
    beyond: bool = False
    """Is it beyond the metric's limit?"""


@dataclass(frozen=True)
class Row:
    """A controller's row."""

    controller: str
    cells: tuple[Cell, ...]
    note: str = ""


def suites(results: Results) -> list[str]:
    """The suites that have finished cases, in the order of the cases; those that only taught nets come last."""
    names = dict.fromkeys(case.suite for case in results.cases)
    return sorted(names, key=lambda name: all(c.kind == "learn" for c in results.cases if c.suite == name))


def controllers(cases: Iterable[Case]) -> list[str]:
    """The controllers of the cases, in their order."""
    return list(dict.fromkeys(case.controller for case in cases))


def number(value: float, digits: int = 3) -> str:
    """Three digits, no exponent for what a person meets; a dash for what was never measured or reached."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "never"
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    return f"{value:,.{max(0, digits - 1 - size)}f}" if -5 < size < 9 else f"{value:.{digits - 1}e}"


def counted(n: int, word: str) -> str:
    """So many of them: "1 seed", "3 seeds"."""
    return f"{n} {word}{'s' if n != 1 else ''}"


def unit(m: Metric) -> str:
    """The metric's unit as people write it; nothing for a pure number."""
    return "" if m.unit == "1" else m.unit.replace("^2", "²").replace("^3", "³").replace("us", "µs")


def of_metric(cases: Iterable[Case], m: Metric) -> np.ndarray:
    """The metric of each case (n,); a drive that was not held, a case without a value or an error counts as worst.

    Else a controller would be judged by the few metres before it left the course.
    """
    worst = math.inf if m.lower_is_better else -math.inf
    values = [value_of(case, m) for case in cases]
    return np.array([worst if math.isnan(value) else value for value in values])


def value_of(case: Case, m: Metric) -> float:
    """The metric of a case; NaN where it has none, or, if it is one of driving, where the drive was not held."""
    lost = m.group in ("tracking", "steering", "comfort") and case.metrics.get("held", 1.0) < 0.5
    return math.nan if lost or case.status != "done" else case.metrics.get(m.name, math.nan)


def by_seed(cases: Sequence[Case], m: Metric) -> np.ndarray:
    """One controller's metric of each seed (n,): the median over its scenarios, so that seeds make an interval.

    A scenario without chance in it has one case, which counts for every seed.
    """
    cases = list(cases)
    times: dict[str, int] = {}
    for case in cases:
        times[case.scenario] = times.get(case.scenario, 0) + 1
    values = of_metric(cases, m)
    seeds = dict.fromkeys(case.seed for case in cases)
    return np.array(
        [np.median([v for v, c in zip(values, cases) if c.seed == seed or times[c.scenario] == 1]) for seed in seeds]
    )


def has(cases: Iterable[Case], name: str) -> bool:
    """Did any of the cases measure it?"""
    return any(math.isfinite(case.metrics.get(name, math.nan)) for case in cases)


def leaderboard(cases: Sequence[Case], metrics: Sequence[str] = BOARD) -> tuple[list[Metric], list[Row]]:
    """A row a controller: the share of its drives that it held, then the median over seeds of each metric."""
    columns = [_BY_NAME[name] for name in metrics if has(cases, name)]
    names = controllers(cases)
    ran = {name: [c for c in cases if c.controller == name and c.status != "not installed"] for name in names}
    medians = {m.name: {name: float(np.median(by_seed(ran[name], m))) for name in names if ran[name]} for m in columns}
    held = {n: [c.metrics.get("held", 0.0) > 0.5 for c in ran[n]] for n in names if ran[n]}
    shares = [float(np.mean(h)) for h in held.values()]
    rows = []
    for name in names:
        if not ran[name]:
            blank = tuple(Cell("–") for _ in range(len(columns) + 2))
            rows.append(Row(name, blank, note="not installed"))
            continue
        errors = sum(c.status == "error" for c in ran[name])
        kept = float(np.mean(held[name]))
        detail = f"{sum(held[name])} of {len(held[name])} drives"
        cells = [
            Cell(str(len(ran[name])), float(len(ran[name]))),
            Cell(f"{100.0 * kept:.0f} %", kept, title=detail, best=kept == max(shares) > min(shares)),
        ]
        for m in columns:
            value = medians[m.name][name]
            others = [v for v in medians[m.name].values() if math.isfinite(v)]
            cells.append(
                Cell(
                    number(value) if math.isfinite(value) else "–",
                    value,
                    title=f"{m.label}, {name}: {value:.6g} {'' if m.unit == '1' else m.unit}".rstrip(),
                    best=_best(value, others, m),
                    beyond=m.limit is not None and m.limit < value < math.inf,
                )
            )
        rows.append(Row(name, tuple(cells), note=f"{errors} ended in an error" if errors else ""))
    return columns, rows


def _best(value: float, others: Sequence[float], m: Metric) -> bool:
    """Is it the best of several that are not all the same?"""
    if not math.isfinite(value) or len(set(others)) < 2:
        return False
    return value == (min(others) if m.lower_is_better else max(others))


def paired_logs(table: Drives, name: str, reference: str, m: Metric) -> tuple[np.ndarray, np.ndarray, int] | None:
    """Means of the metric's logarithm over the scenarios that both held on all seeds: ours (n,), theirs (n,), how many.

    The seeds are those that both have; a controller that nowhere met chance has one, and meets all of the other's.
    None where there is no such scenario.
    """
    own, others = _seeds(table[name]), _seeds(table[reference])
    seeds = sorted(own & others if min(len(own), len(others)) > 1 else own | others)
    scenarios = [scenario for scenario in table[name] if scenario in table[reference]]

    def values(who: str, scenario: str) -> list[float]:
        here = {seed: value_of(case, m) for seed, case in table[who][scenario].items()}
        without_chance = next(iter(here.values())) if len(here) == 1 else math.nan
        return [here.get(seed, without_chance) for seed in seeds]

    both = [(values(name, sc), values(reference, sc)) for sc in scenarios]
    both = [pair for pair in both if np.isfinite(pair).all()]
    if not seeds or not both:
        return None
    ours, theirs = np.mean(np.log(np.maximum(both, 1e-12)), axis=0)
    return ours, theirs, len(both)


def _seeds(drives: Mapping[str, Mapping[int, Case]]) -> set[int]:
    return {seed for cases in drives.values() for seed in cases}
