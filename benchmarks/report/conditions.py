"""Where controllers fail: maps over two conditions, lines over one, found in the scenarios that were driven."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import combinations
from typing import Any

import numpy as np

from benchmarks.report.parts import controllers
from benchmarks.run.results import Case
from steerkit.scenario.parts import PARTS

WORDS = ("name", "title", "what", "label", "description", "about", "course.text", "vehicle.text", "driver.text")
"""Fields of a scenario that say nothing of how it is driven."""


def condition(field: str) -> str:
    """A field of a scenario, such as `steering.delay`, in words, with its unit."""
    table, _, name = field.rpartition(".")
    words = ("believed " if table == "knowledge" else "") + name.removesuffix("_deg").replace("_", " ")
    units = {f.name: f.metadata.get("number", ("1",))[0] for f in fields(PARTS[table])} if table else {"v": "m/s"}
    unit = units.get(name, "1").replace("^2", "²")
    return words if unit == "1" else f"{words} [{unit}]"


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


def grids(cases: Sequence[Case], protocol: Mapping[str, Mapping[str, Any]]) -> list[Grid]:
    """Failure-boundary maps: every pair of a scenario's numbers that the cases vary over a grid, all else equal."""
    known = {name: conditions(protocol[name]) for name in dict.fromkeys(c.scenario for c in cases) if name in protocol}
    named = dict.fromkeys(field for fixed in known.values() for field in fixed)
    varying = [f for f in named if len({fixed[f] for fixed in known.values() if _numeric(fixed, f)}) > 1]
    maps = []
    for x, y in combinations(varying, 2):
        for fixed, group in _groups(known, (x, y)).items():
            at = {name: (float(known[name][x]), float(known[name][y])) for name in group}
            xs, ys = sorted({p[0] for p in at.values()}), sorted({p[1] for p in at.values()})
            if not _covers(at, xs, ys):
                continue
            here = [c for c in cases if c.scenario in at and c.status == "done"]
            shares = {}
            for name in controllers(here):
                held = [[_held(here, name, at, (u, w)) for u in xs] for w in reversed(ys)]
                shares[name] = np.array(held)
            seeds = len({c.seed for c in here})
            maps.append(Grid(x, y, tuple(xs), tuple(reversed(ys)), fixed, shares, seeds))
    return maps


def _covers(at: Mapping[str, tuple[float, float]], xs: Sequence[float], ys: Sequence[float]) -> bool:
    """Do the scenarios fill most of a grid, rather than a cross?"""
    return min(len(xs), len(ys)) >= 2 and len(set(at.values())) >= max(4, 0.7 * len(xs) * len(ys))


def _held(cases: Iterable[Case], name: str, at: Mapping[str, tuple[float, float]], point: tuple[float, float]) -> float:
    held = [c.metrics.get("held", 0.0) > 0.5 for c in cases if c.controller == name and at[c.scenario] == point]
    return float(np.mean(held)) if held else math.nan


def conditions(scenario: Mapping[str, Any]) -> dict[str, Any]:
    """What a scenario fixes, without its words; a steady speed is one number `v` instead of v_min and v_max."""
    fields = {key: value for key, value in scenario.items() if key not in WORDS}
    if "driver.v_min" in fields and fields["driver.v_min"] == fields.get("driver.v_max"):
        fields = {"v": fields.pop("driver.v_min"), **fields}
        del fields["driver.v_max"]
    return fields


def _numeric(fixed: Mapping[str, Any], field: str) -> bool:
    value = fixed.get(field)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _groups(every: Mapping[str, Mapping[str, Any]], free: tuple[str, ...]) -> dict[str, list[str]]:
    """Scenarios that agree in all but the `free` conditions, by what tells one such group from the others in words."""
    known = {n: fixed for n, fixed in every.items() if all(_numeric(fixed, f) for f in free)}
    groups: dict[str, list[str]] = {}
    for n, fixed in known.items():
        groups.setdefault(repr(sorted((k, repr(v)) for k, v in fixed.items() if k not in free)), []).append(n)
    firsts = [known[group[0]] for group in groups.values()]
    differing = [k for k in dict.fromkeys(k for f in firsts for k in f) if len({repr(f.get(k)) for f in firsts}) > 1]
    words = [", ".join(f"{k} {f[k]}" for k in differing if k in f and k not in free) for f in firsts]
    return dict(zip(words, groups.values()))
