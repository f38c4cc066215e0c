"""What the report says, computed from results: leaderboards, comparisons seed for seed, failure maps, learning."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from benchmarks.results import Case, Results
from steerkit.metrics import GOOD, TABLE, Interval, Metric, interval, metric, paired, share

BOARD = ("rms_e", "p95_e", "max_e", "share_within_5cm", "rms_wheel_rate_deg", "large_reversals", "max_a_y", "max_jerk",
         "weighted_a_y", "step_p50_us")  # fmt: skip
"""Columns of a leaderboard."""
VERSUS = ("rms_e", "max_e", "rms_wheel_rate_deg", "max_jerk", "max_a_y")
"""Metrics that are compared seed for seed."""
WORDS = ("name", "title", "what", "label", "description", "about")
"""Fields of a scenario that say nothing of how it is driven."""

UNITS = {"v": "m/s", "v_min": "m/s", "v_max": "m/s", "delay": "s", "lag": "s", "told_delay": "s", "told_lag": "s",
         "latency": "s", "wind": "m/s²", "gust": "m/s²"}  # fmt: skip
"""Units of a scenario's fields; the others are numbers, or end in _deg."""


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
    """The suites that have finished cases, in the order of the cases."""
    return list(dict.fromkeys(case.suite for case in results.cases))


def condition(field: str) -> str:
    """A field of a scenario in words, with its unit."""
    words = field.removesuffix("_deg").replace("_", " ")
    found = "deg" if field.endswith("_deg") else UNITS.get(field, "")
    return f"{words} [{found}]" if found else words


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


def unit(m: Metric) -> str:
    """The metric's unit as people write it; nothing for a pure number."""
    return "" if m.unit == "1" else m.unit.replace("^2", "²").replace("^3", "³").replace("us", "µs")


def of_metric(cases: Iterable[Case], m: Metric) -> np.ndarray:
    """The metric of each finished case (n,); one without a value, or that failed with an error, counts as worst."""
    worst = math.inf if m.lower_is_better else -math.inf
    found = [case.metrics.get(m.name, math.nan) if case.status == "done" else math.nan for case in cases]
    return np.array([worst if math.isnan(value) else value for value in found])


def by_seed(cases: Sequence[Case], m: Metric) -> np.ndarray:
    """The metric of each seed (n,): the median over its scenarios, so that seeds, not scenarios, make an interval."""
    seeds = dict.fromkeys(case.seed for case in cases)
    return np.array([float(np.median(of_metric([c for c in cases if c.seed == seed], m))) for seed in seeds])


def has(cases: Iterable[Case], name: str) -> bool:
    """Did any of the cases measure it?"""
    return any(math.isfinite(case.metrics.get(name, math.nan)) for case in cases)


def leaderboard(cases: Sequence[Case]) -> tuple[list[Metric], list[Row]]:
    """A row a controller: the share of its drives that it held, then the median over seeds of each metric."""
    columns = [metric(name) for name in BOARD if has(cases, name)]
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
        told = f"{sum(held[name])} of {len(held[name])} drives"
        cells = [Cell(str(len(ran[name])), float(len(ran[name]))),
                 Cell(f"{100.0 * kept:.0f} %", kept, title=told, best=kept == max(shares) > min(shares))]  # fmt: skip
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


@dataclass(frozen=True)
class Versus:
    """One controller against the reference, seed for seed."""

    controller: str
    metric: Metric
    seeds: int
    scenarios: int
    reference: float
    difference: Interval
    p: float

    @property
    def verdict(self) -> str:
        """better, worse, or no difference shown, at 5 %."""
        if self.p >= 0.05:
            return "open"
        return "better" if (self.difference.value < 0.0) == self.metric.lower_is_better else "worse"


def against(cases: Sequence[Case], reference: str) -> list[Versus]:
    """Every other controller against the reference: the mean over common scenarios, paired by seed.

    Only scenarios that both finished on all common seeds count; a seed is one pair, as its scenarios share a driver.
    """
    found = []
    table = {(c.controller, c.scenario, c.seed): c for c in cases if c.status == "done"}
    for name in controllers(cases):
        if name == reference:
            continue
        for m in (metric(n) for n in VERSUS):
            pairs = _paired_means(table, name, reference, m.name)
            if pairs is None:
                continue
            ours, theirs, scenarios = pairs
            test = paired(ours, theirs)
            found.append(Versus(name, m, len(ours), scenarios, float(theirs.mean()), test.difference, test.p))
    return found


def _paired_means(
    table: Mapping[tuple[str, str, int], Case], name: str, reference: str, key: str
) -> tuple[np.ndarray, np.ndarray, int] | None:
    seeds = sorted({s for c, _, s in table if c == name} & {s for c, _, s in table if c == reference})
    scenarios = sorted({sc for c, sc, _ in table if c == name} & {sc for c, sc, _ in table if c == reference})

    def values(who: str, scenario: str) -> list[float]:
        return [
            table[who, scenario, s].metrics.get(key, math.nan) if (who, scenario, s) in table else math.nan
            for s in seeds
        ]

    both = [(values(name, sc), values(reference, sc)) for sc in scenarios]
    both = [pair for pair in both if np.isfinite(pair).all()]
    if len(seeds) < 2 or not both:
        return None
    ours, theirs = np.mean(both, axis=0)
    return ours, theirs, len(both)


def reference_of(names: Sequence[str]) -> str | None:
    """The controller that others are compared with: complete Stanley where it drove, else the first."""
    return "stanley" if "stanley" in names else next(iter(names), None)


@dataclass(frozen=True)
class Grid:
    """Which of two conditions a controller held: shares (rows, columns), NaN where nothing was driven."""

    x: str
    y: str
    xs: tuple[float, ...]
    ys: tuple[float, ...]
    fixed: str
    shares: dict[str, np.ndarray]
    seeds: int


@dataclass(frozen=True)
class Sweep:
    """One condition varied, all others fixed: cases by controller and value."""

    x: str
    xs: tuple[float, ...]
    fixed: str
    cases: dict[str, list[list[Case]]]


def grids(cases: Sequence[Case], protocol: Mapping[str, Mapping[str, Any]]) -> list[Grid]:
    """Failure-boundary maps: every pair of a scenario's numbers that the cases vary over a grid, all else equal."""
    found = []
    for x, y in combinations(_varying(cases, protocol), 2):
        for fixed, group in _groups(cases, protocol, (x, y)).items():
            at = {name: (_value(protocol, name, x), _value(protocol, name, y)) for name in group}
            xs, ys = sorted({p[0] for p in at.values()}), sorted({p[1] for p in at.values()})
            if not _covers(at, xs, ys):
                continue
            here = [c for c in cases if c.scenario in at and c.status == "done"]
            shares = {}
            for name in controllers(here):
                held = [[_held(here, name, at, (u, w)) for u in xs] for w in reversed(ys)]
                shares[name] = np.array(held)
            seeds = len({c.seed for c in here})
            found.append(Grid(x, y, tuple(xs), tuple(reversed(ys)), fixed, shares, seeds))
    return found


def sweeps(cases: Sequence[Case], protocol: Mapping[str, Mapping[str, Any]]) -> list[Sweep]:
    """Every number of the scenarios that takes three values or more, all else equal, and is not on a map already."""
    found = []
    mapped = {name for x, y in combinations(_varying(cases, protocol), 2)
              for name in _on_a_map(cases, protocol, x, y)}  # fmt: skip
    for x in _varying(cases, protocol):
        for fixed, group in _groups(cases, protocol, (x,)).items():
            at = {_value(protocol, name, x): name for name in group}
            if len(at) < 3 or mapped.issuperset(group):
                continue
            xs = tuple(sorted(at))
            names = controllers(c for c in cases if c.scenario in group)
            by = {n: [[c for c in cases if (c.controller, c.scenario) == (n, at[v])] for v in xs] for n in names}
            found.append(Sweep(x, xs, fixed, by))
    return found


def _covers(at: Mapping[str, tuple[float, float]], xs: Sequence[float], ys: Sequence[float]) -> bool:
    """Do the scenarios fill most of a grid, rather than a cross?"""
    return min(len(xs), len(ys)) >= 2 and len(set(at.values())) >= max(4, 0.7 * len(xs) * len(ys))


def _on_a_map(cases: Sequence[Case], protocol: Mapping[str, Mapping[str, Any]], x: str, y: str) -> list[str]:
    found: list[str] = []
    for group in _groups(cases, protocol, (x, y)).values():
        at = {name: (_value(protocol, name, x), _value(protocol, name, y)) for name in group}
        if _covers(at, sorted({p[0] for p in at.values()}), sorted({p[1] for p in at.values()})):
            found += group
    return found


def _held(cases: Iterable[Case], name: str, at: Mapping[str, tuple[float, float]], point: tuple[float, float]) -> float:
    held = [c.metrics.get("held", 0.0) > 0.5 for c in cases if c.controller == name and at[c.scenario] == point]
    return float(np.mean(held)) if held else math.nan


def conditions(scenario: Mapping[str, Any]) -> dict[str, Any]:
    """What a scenario fixes, without its words; a steady speed is one number `v` instead of v_min and v_max."""
    fields = {key: value for key, value in scenario.items() if key not in WORDS}
    if "v_min" in fields and fields["v_min"] == fields.get("v_max"):
        fields = {"v": fields.pop("v_min"), **fields}
        del fields["v_max"]
    return fields


def _known(cases: Sequence[Case], protocol: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    return {name: conditions(protocol[name]) for name in dict.fromkeys(c.scenario for c in cases) if name in protocol}


def _varying(cases: Sequence[Case], protocol: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Numeric conditions that differ between the scenarios of the cases."""
    known = _known(cases, protocol)
    fields = dict.fromkeys(field for fixed in known.values() for field in fixed)
    return [f for f in fields if len({fixed[f] for fixed in known.values() if _numeric(fixed, f)}) > 1]


def _numeric(fixed: Mapping[str, Any], field: str) -> bool:
    value = fixed.get(field)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _value(protocol: Mapping[str, Mapping[str, Any]], scenario: str, field: str) -> float:
    return float(conditions(protocol[scenario])[field])


def _groups(
    cases: Sequence[Case], protocol: Mapping[str, Mapping[str, Any]], free: tuple[str, ...]
) -> dict[str, list[str]]:
    """Scenarios that agree in all but the `free` conditions, by what tells one such group from the others in words."""
    known = {n: fixed for n, fixed in _known(cases, protocol).items() if all(_numeric(fixed, f) for f in free)}
    groups: dict[str, list[str]] = {}
    for n, fixed in known.items():
        groups.setdefault(repr(sorted((k, repr(v)) for k, v in fixed.items() if k not in free)), []).append(n)
    firsts = [known[group[0]] for group in groups.values()]
    told = [k for k in dict.fromkeys(k for f in firsts for k in f) if len({repr(f.get(k)) for f in firsts}) > 1]
    words = [", ".join(f"{k} {f[k]}" for k in told if k in f and k not in free) for f in firsts]
    return dict(zip(words, groups.values()))


@dataclass(frozen=True)
class Curves:
    """Learning over driving time: per controller (middle, low, high), each over `minutes`."""

    scenario: str
    minutes: np.ndarray
    rms_e: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]
    good: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]
    seeds: dict[str, int]


def learning(results: Results, cases: Sequence[Case], *, points: int = 80) -> list[Curves]:
    """Learning curves by scenario: RMS e of the net in use and the share of seeds whose net is GOOD, with intervals.

    A seed's value at a time is that of the last net that had taken the wheel; before the first it counts as never.
    """
    found = []
    for scenario in dict.fromkeys(c.scenario for c in cases if c.kind == "learn" and c.status == "done"):
        learners: dict[str, list[Mapping[str, np.ndarray]]] = {}
        for case in (c for c in cases if c.scenario == scenario and c.kind == "learn"):
            curve = results.curve(case)
            if curve is not None and len(curve["t"]):
                learners.setdefault(case.controller, []).append(curve)
        if not learners:
            continue
        end = max(float(c["t"].max()) for runs in learners.values() for c in runs)
        minutes = np.linspace(0.0, end / 60.0, points)
        rms_e = {name: _band([_held_at(c, minutes, _rms) for c in runs]) for name, runs in learners.items()}
        good = {name: _shares([_held_at(c, minutes, _good) for c in runs]) for name, runs in learners.items()}
        found.append(Curves(scenario, minutes, rms_e, good, {name: len(runs) for name, runs in learners.items()}))
    return found


def _rms(curve: Mapping[str, np.ndarray]) -> np.ndarray:
    return np.where(np.isfinite(curve["rms_e"]) & (curve["held"] > 0.5), curve["rms_e"], np.inf)


def _good(curve: Mapping[str, np.ndarray]) -> np.ndarray:
    bounds = (curve["max_e"] < GOOD.max_e) & (curve["rms_e"] < GOOD.rms_e) & (curve["max_jerk"] < GOOD.max_jerk)
    kept = bounds & (curve["held"] > 0.5) & (curve["rounds"] >= GOOD.rounds)
    return np.where(kept, 1.0, 0.0)


def _held_at(
    curve: Mapping[str, np.ndarray], minutes: np.ndarray, value: Callable[[Mapping[str, np.ndarray]], np.ndarray]
) -> np.ndarray:
    """The value of the last net at each time; what stood before the first net counts as worst."""
    worst = 0.0 if value is _good else math.inf
    last = np.searchsorted(curve["t"], 60.0 * minutes, side="right")
    return np.concatenate([[worst], value(curve)])[last]


def _band(rows: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    columns = np.array(rows).T
    found = [interval(column, np.median) for column in columns]
    return (np.array([i.value for i in found]), np.array([i.low for i in found]), np.array([i.high for i in found]))


def _shares(rows: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    found = [share(column > 0.5) for column in np.array(rows).T]
    return (np.array([i.value for i in found]), np.array([i.low for i in found]), np.array([i.high for i in found]))


def learners_table(cases: Sequence[Case]) -> tuple[list[Metric], list[tuple[str, str, int, list[Interval]]]]:
    """What learning cost: (scenario, controller, seeds, an interval a metric) by the metrics of the group learning."""
    rows = []
    columns = [m for m in TABLE if m.group == "learning" and any(m.name in c.metrics for c in cases)]
    plain = [m for m in columns if not m.name.endswith("_share")]
    for scenario, name in dict.fromkeys((c.scenario, c.controller) for c in cases if c.kind == "learn"):
        here = [c for c in cases if (c.scenario, c.controller) == (scenario, name) and c.status == "done"]
        if here:
            found = [interval(of_metric(here, m), np.median) for m in plain]
            rows.append((scenario, name, len(here), found))
    return plain, rows
