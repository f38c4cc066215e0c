"""The report of a benchmark run: one HTML file that holds everything and asks nothing of the network.

Leaderboards, drives on the map, failure-boundary maps, learning curves with intervals, the paper's values beside ours,
the protocol and where the numbers came from.

    python -m benchmarks report runs/bench --out report.html
"""

import json
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import jinja2
import numpy as np

from benchmarks.report import conditions, figures, learning, parts
from benchmarks.report.verdict import JUDGED, NOTHING, SMALL_PRINT, glances
from benchmarks.run.results import Case, Results
from benchmarks.statistics import interval
from steerkit.metrics import Metric

TEMPLATE = FilePath(__file__).with_name("report.html.j2")
LINES_ON_A_MAP = 12
"""More controllers than these make a map unreadable."""


def write_report(results: Results, out: str | FilePath) -> FilePath:
    """Write the report of the results to `out`; returns that file. Needs jinja2 (extra `bench`)."""
    file = FilePath(out)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(html(results), encoding="utf-8")
    return file


def html(results: Results) -> str:
    """The report as one HTML document. Raises ValueError if no case has finished."""
    if not results.cases:
        raise ValueError(f"{results.place}: no case has finished, so there is nothing to report; run the suite first")
    look = figures.looks(list(dict.fromkeys([*results.provenance["controllers"], *parts.controllers(results.cases)])))
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {
        "shown": parts.number,
        "named": _named,
        "unit": parts.unit,
        "counted": parts.counted,
        "condition": conditions.condition,
    }
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return template.render(
        place=results.place.name,
        glances=glances(results),
        judged=JUDGED,
        nothing=NOTHING,
        small_print=SMALL_PRINT,
        suites=[suite(results, name, look) for name in parts.suites(results)],
        paper=paper_rows(results),
        metrics=parts.METRICS,
        used={name for case in results.cases for name in case.metrics},
        provenance=provenance(results),
        scenarios=protocol(results),
        kinds=kinds(results),
        problems=[case for case in results.cases if case.status != "done"],
        missing=results.missing,
        look=look,
    )


def suite(results: Results, name: str, look: dict[str, figures.Look]) -> dict[str, Any]:
    """All that the page shows of one suite."""
    cases = [case for case in results.cases if case.suite == name]
    done = [case for case in cases if case.status == "done"]
    columns, rows = parts.leaderboard(cases)
    learners, learned = learning.costs(done)
    return {
        "name": name,
        "cases": len(cases),
        "scenarios": list(dict.fromkeys(case.scenario for case in cases)),
        "seeds": sorted({case.seed for case in cases}),
        "controllers": parts.controllers(cases),
        "held": parts.has(cases, "held"),
        "columns": columns,
        "rows": rows,
        "maps": maps(results, done, look),
        "grids": conditions.grids(done, results.protocol),
        "curves": curve_plots(results, done, look),
        "learners": learners,
        "learned": learned,
    }


def _named(m: Metric) -> str:
    return f"{m.label} [{parts.unit(m)}]" if parts.unit(m) else m.label


def maps(results: Results, cases: Sequence[Case], look: dict[str, figures.Look]) -> list[dict[str, Any]]:
    """For the first drive on each course: where the controllers drove, and e along the way."""
    entries, seen = [], set()
    cases = [case for case in cases if case.kind == "drive"]
    for scenario in dict.fromkeys(case.scenario for case in cases):
        course = str(results.protocol.get(scenario, {}).get("course.name", scenario))
        if course in seen:
            continue
        seed = min(case.seed for case in cases if case.scenario == scenario)
        here = [c for c in cases if c.scenario == scenario and c.seed == seed]
        drives = {c.controller: drive for c in here if (drive := results.trajectory(c)) is not None}
        drives = {name: d for name, d in drives.items() if len(d["t"]) > 3 and np.isfinite(d["x"] + d["y"]).all()}
        if not drives:
            continue
        seen.add(course)
        shown = dict(list(drives.items())[:LINES_ON_A_MAP])
        times = figures.magnification(shown)
        entries.append(
            {
                "course": course,
                "scenario": scenario,
                "seed": seed,
                "controllers": list(shown),
                "left_out": list(drives)[LINES_ON_A_MAP:],
                "times": times,
                "map": figures.svg(figures.course_map(shown, look, times), f"drives on {course}"),
                "along": figures.svg(figures.error_along(shown, look), f"cross-track error along {course}"),
            }
        )
    return entries


def curve_plots(results: Results, cases: Sequence[Case], look: dict[str, figures.Look]) -> list[dict[str, str]]:
    """Two pictures a scenario of learning, with captions: the share of seeds that drive well, and how well."""
    pictures = []
    for curves in learning.learning(results, cases):
        x = curves.label
        seeds = ", ".join(f"{name} {n}" for name, n in curves.seeds.items())
        good = figures.bands(curves.x, curves.good, look, x_label=x, y_label="share of seeds", share=True)
        text = (
            "Seeds whose net of that moment drives a whole round with |e| < 0.25 m, RMS e < 0.10 m and jerk < 5 m/s³; "
            f"Wilson's 95 % interval. Seeds: {seeds}."
        )
        title = f"{curves.scenario}: good drivers over {x.partition(' [')[0]}"
        pictures.append({"title": title, "text": text, "svg": figures.svg(good, title)})
        rms = figures.bands(curves.x, curves.rms_e, look, x_label=x, y_label="RMS e [m]", log=True)
        text = (
            "RMS e of one round by the net of that moment: median over the seeds, bootstrap 95 % interval. The line "
            "begins when half the seeds hold the round."
        )
        title = f"{curves.scenario}: RMS e over {x.partition(' [')[0]}"
        pictures.append({"title": title, "text": text, "svg": figures.svg(rms, title)})
    return pictures


def protocol(results: Results) -> dict[str, Any]:
    """Scenarios as rows: what all have in common, and the fields in which they differ."""
    named = {
        n: conditions.conditions(f) for n, f in results.protocol.items() if any(c.scenario == n for c in results.cases)
    }
    fields = list(dict.fromkeys(key for f in named.values() for key in f))
    differing = [k for k in fields if len({repr(f.get(k)) for f in named.values()}) > 1]
    common = {k: next(iter(named.values()))[k] for k in fields if k not in differing}
    rows = {n: [f.get(k, "") for k in differing] for n, f in named.items()}
    return {"common": common, "fields": differing, "rows": rows}


def kinds(results: Results) -> dict[str, tuple[str, str]]:
    """What each controller is (analytic, learned, peer) and one line about it; empty words where that was not kept."""
    entries = results.provenance["controllers"]
    nothing = {"kind": "", "about": ""}
    found = {name: nothing | entries.get(name, {}) for name in parts.controllers(results.cases)}
    return {name: (entry["kind"], entry["about"]) for name, entry in found.items()}


def provenance(results: Results) -> list[tuple[str, str]]:
    """Where the numbers came from, as pairs of words; the plan itself is shown elsewhere."""
    shown = {k: v for k, v in results.provenance.items() if k not in ("scenarios", "controllers", "planned")}
    return [(key, v if isinstance(v, str) else json.dumps(v, ensure_ascii=False)) for key, v in shown.items()]


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


def paper_rows(results: Results) -> list[dict[str, str]]:
    """The paper's values beside those of the suite `paper`; empty where that was not run.

    ours: median with its 95 % interval over the seeds; a dash where the run has no such case.
    """
    cases = [c for c in results.cases if c.suite == "paper" and c.status == "done"]
    if not cases:
        return []
    steering = dict.fromkeys(c.controller for c in cases)
    learners = [c for c in results.cases if c.kind == "learn" and c.status == "done" and c.controller in steering]
    rows = [{"what": what, "paper": paper, "ours": _each(learners, name)} for what, paper, name in _LEARNING]
    for kind, e, a_y in _DRIVING:
        here = [c for c in cases if kind in c.controller]
        rows.append({"what": f"{kind}: range of e in a round [m]", "paper": e, "ours": _ranges(results, here)})
        rows.append({"what": f"{kind}: largest |a_y| [m/s²]", "paper": a_y, "ours": _each(here, "max_a_y")})
    return rows


def _of(cases: Sequence[Case], controller: str) -> list[Case]:
    return [c for c in cases if c.controller == controller]


def _each(cases: Sequence[Case], name: str) -> str:
    """Each controller's median over its seeds with the interval, and of how many seeds, where not of all."""
    texts = []
    for controller in dict.fromkeys(c.controller for c in cases):
        values = np.array([c.metrics.get(name, np.nan) for c in _of(cases, controller)])
        known = values[~np.isnan(values)]
        if len(known):
            middle = interval(known, np.median)
            of = "" if len(known) == len(values) else f" ({len(known)} of {len(values)} seeds)"
            value, low, high = (parts.number(number, 2) for number in (middle.value, middle.low, middle.high))
            texts.append(f"{controller}: {value} [{low}, {high}]{of}")
    return "; ".join(texts) or "–"


def _ranges(results: Results, cases: Sequence[Case]) -> str:
    """Least and greatest e of the recorded drives, of all seeds together."""
    texts = []
    for name in dict.fromkeys(c.controller for c in cases):
        drives = [d["e"] for c in _of(cases, name) if (d := results.trajectory(c)) is not None and len(d["e"])]
        if drives:
            e = np.concatenate(drives)
            texts.append(f"{name}: {parts.number(float(np.nanmin(e)), 2)} to {parts.number(float(np.nanmax(e)), 2)}")
    return "; ".join(texts) or "–"
