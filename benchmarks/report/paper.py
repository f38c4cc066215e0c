"""What the paper of 2007 says it reached, and the numbers of a run to put beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.report.parts import number
from benchmarks.run.results import Case, Results
from steerkit.metrics import interval

SUITE = "paper"
_LEARNING = (
    ("episodes to the first whole round", "56, real car", "round_episodes"),
    ("driving time to the first whole round [min]", "about 11, real car", "round_minutes"),
    ("transitions at the end", "20,000 after 60 episodes and 16 min, real car", "transitions"),
    ("max |e| of a round after 70 episodes [m]", "no number given", "max_e_after_70"),
    (
        "max |e| of a round after 120 episodes [m]",
        "very good controllers, no number given, simulation",
        "max_e_after_120",
    ),
)
_DRIVING = (
    ("bang-bang", "−0.25 to 0.1 over 2,000 steps, simulation", "up to 8, simulation"),
    ("idoe", "about ±0.1 over 2,000 steps, simulation", "far smoother than bang-bang, simulation"),
)


@dataclass(frozen=True)
class PaperRow:
    """One value of the paper beside ours."""

    what: str
    paper: str
    ours: str
    """Median with its 95 % interval over the seeds; a dash where the run has no such case."""


def paper_rows(results: Results) -> list[PaperRow]:
    """The paper's values beside those of the suite `paper`; empty where that was not run."""
    cases = [c for c in results.cases if c.suite == SUITE and c.status == "done"]
    if not cases:
        return []
    steering = dict.fromkeys(c.controller for c in cases)
    learners = [c for c in results.cases if c.kind == "learn" and c.status == "done" and c.controller in steering]
    rows = [PaperRow(what, paper, _each(learners, name)) for what, paper, name in _LEARNING]
    for kind, e, a_y in _DRIVING:
        here = [c for c in cases if kind in c.controller]
        rows.append(PaperRow(f"{kind}: range of e in a round [m]", e, _ranges(results, here)))
        rows.append(PaperRow(f"{kind}: largest |a_y| [m/s²]", a_y, _each(here, "max_a_y")))
    return rows


def _of(cases: Sequence[Case], controller: str) -> list[Case]:
    return [c for c in cases if c.controller == controller]


def _each(cases: Sequence[Case], name: str) -> str:
    """Each controller's median over its seeds with the interval, and of how many seeds, where not of all."""
    parts = []
    for controller in dict.fromkeys(c.controller for c in cases):
        values = np.array([c.metrics.get(name, np.nan) for c in _of(cases, controller)])
        known = values[~np.isnan(values)]
        if len(known):
            middle = interval(known, np.median)
            of = "" if len(known) == len(values) else f" ({len(known)} of {len(values)} seeds)"
            parts.append(
                f"{controller}: {number(middle.value, 2)} [{number(middle.low, 2)}, {number(middle.high, 2)}]{of}"
            )
    return "; ".join(parts) or "–"


def _ranges(results: Results, cases: Sequence[Case]) -> str:
    """Least and greatest e of the recorded drives, of all seeds together."""
    parts = []
    for name in dict.fromkeys(c.controller for c in cases):
        drives = [d["e"] for c in _of(cases, name) if (d := results.trajectory(c)) is not None and len(d["e"])]
        if drives:
            e = np.concatenate(drives)
            parts.append(f"{name}: {number(float(np.nanmin(e)), 2)} to {number(float(np.nanmax(e)), 2)}")
    return "; ".join(parts) or "–"
