"""What the paper of 2007 says it reached, and the numbers of a run to put beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.report_parts import number
from benchmarks.results import Case, Results
from steerkit.metrics import interval, share

SUITE = "paper"


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
    learners = [c for c in cases if c.kind == "learn"]
    ours = list(dict.fromkeys(c.controller for c in learners))
    rows = []
    for what, paper, name, digits in (
        ("episodes to the first whole round", "56 (real car)", "round_episodes", 2),
        ("driving time to the first whole round [min]", "about 11 (real car)", "round_minutes", 2),
        ("transitions", "20,000 after 60 episodes and 16 min (real car)", "transitions", 3),
    ):
        told = "; ".join(f"{c}: {_median(_of(learners, c), name, digits)}" for c in ours if _of(learners, c))
        rows.append(PaperRow(what, paper, told or "–"))
    rounds = [
        f"{c}: {share([x.metrics.get('round_minutes', np.inf) < np.inf for x in _of(learners, c)])}" for c in ours
    ]
    rows.append(PaperRow("share of runs that drove a whole round", "1 run shown", "; ".join(rounds) or "–"))
    for kind, e, a_y in (("bang-bang", "−0.25 to 0.1 (simulation)", "up to 8 (simulation)"),
                         ("idoe", "about ±0.1 (simulation)", "far smaller than bang-bang's")):  # fmt: skip
        here = [c for c in cases if kind in c.controller.lower()]
        rows.append(PaperRow(f"{kind}: range of e [m]", e, _ranges(results, here)))
        rows.append(PaperRow(f"{kind}: largest |a_y| [m/s²]", a_y, _each(here, "max_a_y")))
    return rows


def _of(cases: Sequence[Case], controller: str) -> list[Case]:
    return [c for c in cases if c.controller == controller]


def _median(cases: Sequence[Case], name: str, digits: int) -> str:
    values = [c.metrics.get(name, np.nan) for c in cases]
    if np.isnan(values).any():
        return "–"
    found = interval(values, np.median)
    return f"{number(found.value, digits)} [{number(found.low, digits)}, {number(found.high, digits)}]"


def _each(cases: Sequence[Case], name: str) -> str:
    names = dict.fromkeys(c.controller for c in cases)
    return "; ".join(f"{n}: {_median(_of(cases, n), name, 2)}" for n in names) or "–"


def _ranges(results: Results, cases: Sequence[Case]) -> str:
    """Least and greatest e of the recorded drives, of all seeds together."""
    told = []
    for name in dict.fromkeys(c.controller for c in cases):
        drives = [d["e"] for c in _of(cases, name) if (d := results.trajectory(c)) is not None and len(d["e"])]
        if drives:
            e = np.concatenate(drives)
            told.append(f"{name}: {number(float(np.nanmin(e)), 2)} to {number(float(np.nanmax(e)), 2)}")
    return "; ".join(told) or "–"
