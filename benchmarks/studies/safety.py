"""What the safety filter is worth: no departure while learning, adversaries that stay on the path, chatter, cost.

`hard` sensors throughout, judged by the simulated truth.

* Learners: each seed learns with the filter on the single track, on CommonRoad's multi-body car and on cars of the
  fleet, the first seeds (--compare) once more without it. A departure is a run in which |e| exceeds 0.5 m after the
  first second. GOOD is when a net takes the wheel that drives a whole round as `study learning` asks, without the
  filter. interventions_pct: samples of the last minute in which the learner's command was mixed with the backup's, of
  the worst run (interventions_mean_pct: over all). final_rms_x: RMS e of the final net's test drive over that of the
  one that learned without it, in the median.
* Adversaries: full lock to either side, bang-bang at 20 Hz and slower, away from the path, an untrained net, commands
  by chance; tyres 30 % off, ratio 10 % off either way, 0.1 s of unknown delay; 2 to 9 m/s. The filter is
  given that commands may be 0.1 s late.
* Beyond: adversaries on cars whose ratio, tyres and delay are all off by so many times what the filter doubts (10 %
  of ratio and of tyres, 0.05 s), with its model and doubts as they are and as it finds them; `random-N` and
  `sweeping-N`, N by --first-seed. Of the whole drive, and from 5 s on: nobody has steered the car before.
* Car: learners with the filter before the gate of the simulated car behind the bus, in three processes at true 20 Hz;
  only with --parts car.
* Cost: time of a sample in the filter's own C, exported and called from Python, where its commands are corrected.

    python -m benchmarks study safety [--parts PART ...] [--seeds N] [--compare N] [--jobs N] [--keep FILE] [--json]

Learners run on the workers of a cluster with --backend dask --address tcp://HOST:PORT. With --keep each run of a
learner is kept as it ends; the same command goes on after a stop, or with more seeds.
"""

import argparse
import ctypes
import re
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.foreign_cars import WIDE
from benchmarks.run import kept, spread
from benchmarks.run.learners import Learner, values
from benchmarks.scenarios import of_fleet, of_kind
from benchmarks.studies.car_realtime import drive
from benchmarks.tables import as_line, say, show, show_figures
from steerkit._support.native import compiler
from steerkit.controllers.safety_filter import SafetyFilter
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.simulation import Log, simulate
from steerkit.export.c import export_c
from steerkit.learning.experiment import Experiment
from steerkit.learning.settings import DEFAULT
from steerkit.metrics.signals import largest
from steerkit.scenario import Scenario, straightest
from steerkit.scenario.catalogue import make_safety
from steerkit.scenario.drive import assembled
from steerkit.task import DT, STOP, TRIP

KINDS = ("left", "right", "bang-bang", "slow bang-bang", "away", "untrained net", "chance")
"""What an adversary does."""
SPEEDS = (2.0, 4.0, 6.5, 8.0, 9.0)
"""Of the adversaries' drives [m/s]."""
LATE = 0.1
"""Unknown delay [s]."""
HOSTILE, SETTLED = ("left", "slow bang-bang", "chance"), 5.0
"""Adversaries of cars beyond the doubts; from when on what was found counts [s]."""
OFF: dict[str, Any] = dict(vehicle={"tyres": 0.7}, steering={"delay": LATE}, knowledge={"delay": DT})
"""Unknown errors of the adversaries' cars, beside their ratio."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Adversary(Block):
    """One who wants to leave the path."""

    e = In("m")
    psi_e = In("rad")
    v = In("m/s")
    delta_sw = Out("rad")

    kind: str = "left"
    """One of `KINDS`."""
    seed: int = 0
    """Of what is done by chance."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        kind = self.kind
        if kind in ("left", "right"):
            wish = STOP if kind == "left" else -STOP
        elif kind == "away":
            wish = m.where(u.e + 1.5 * u.psi_e >= 0.0, STOP, -STOP)
        elif kind == "untrained net":
            rng = np.random.default_rng((self.seed, int(t)))  # another one every second
            first, last = rng.normal(size=(10, 4)), rng.normal(size=10)
            wish = STOP * float(np.tanh(last @ np.tanh(first @ (2.0 * u.e, 5.0 * u.psi_e, u.v / 5.0, 1.0))))
        elif kind == "chance":
            wish = float(np.random.default_rng((self.seed, int(t / 0.2 + 1e-9))).uniform(-STOP, STOP))
        else:
            half = DT if kind == "bang-bang" else 0.7
            wish = STOP * (1.0 if int(t / half + 1e-9) % 2 else -1.0)
        return self.Y(wish + 0.0 * u.e)


def adversaries(seconds: float, kinds: tuple[str, ...], speeds: tuple[float, ...]) -> dict[str, Any]:
    """Largest |e| of each adversary at each speed [m], the worse of ratios 10 % off either way."""
    table: dict[str, dict[str, float]] = {}
    for kind in kinds:
        row = table.setdefault(kind, {})
        for v in speeds:
            car = Scenario.under("hard", course="paper", driver={"v_min": v, "v_max": v}, **OFF)
            drives = [against(Adversary(kind=kind), car.with_(vehicle={"ratio": r}), seconds, LATE) for r in (0.9, 1.1)]
            row[f"{v:g} m/s"] = max(largest(log["path.e"]) for log in drives)
    return {"adversary_max_e": max(value for row in table.values() for value in row.values()), "adversaries": table}


def against(driver: Block, scenario: Scenario, seconds: float, late: float, **settings: Any) -> Log:
    """A drive with the filter, which assumes that commands may be so late [s]."""
    safety = replace(make_safety(scenario.design_model()), delay_doubt=late, **settings)
    return simulate(assembled(scenario, driver, safety=safety), seconds, every=5)


def beyond(
    seconds: float, kinds: tuple[str, ...], speeds: tuple[float, ...], doubts: tuple[float, ...], seed: int
) -> dict[str, Any]:
    """Largest |e| [m] where ratio, tyres and delay are off by so many doubts, ratio either way; all and from 5 s on."""
    rows = list[dict[str, float]]()
    for v, off in ((v, off) for v in speeds for off in doubts):
        row = {"v": v, "doubts": off}
        for name, settings in (("fixed", {"later": 0.0, "widest": 1.0}), ("found", {})):
            logs = [
                against(Adversary(kind=kind, seed=seed), scenario, seconds, SafetyFilter.delay_doubt, **settings)
                for scenario in (off_by(v, off, -off, seed), off_by(v, off, off, seed))
                for kind in kinds
            ]
            row[name] = max(largest(log["path.e"]) for log in logs)
            settled = min(SETTLED, 0.5 * seconds)
            row[f"{name}_later"] = max(largest(log["path.e"][log.t > settled]) for log in logs)
        rows.append(row)
    return {"beyond": rows, "beyond_max_e": max(row["found"] for row in rows)}


def off_by(v: float, doubts: float, ratio: float, seed: int) -> Scenario:
    """A car at that speed [m/s] whose tyres and delay, and ratio in that direction, are off by so many doubts."""
    course = f"{'sweeping' if v >= WIDE else 'random'}-{20 + seed}"
    return Scenario.under(
        "hard",
        course={"name": course, "start": straightest(Scenario(course=course).path(), 10.0 * v)},
        driver={"v_min": v, "v_max": v},
        vehicle={"ratio": 1.0 + SafetyFilter.ratio_doubt * ratio, "tyres": 1.0 - SafetyFilter.ratio_doubt * doubts},
        steering={"delay": round(DT + SafetyFilter.delay_doubt * doubts, 2)},
        knowledge={"delay": DT},
    )


def cost(seconds: float, level: str = "-O2", **settings: Any) -> dict[str, Any]:
    """Time of a sample of the filter and its path tracker in exported C, the call from Python included [ms].

    It is given the inputs of a drive of full lock, so that most commands are corrected. None without a C compiler.
    """
    tool = compiler()
    if tool is None:
        return {"filter_p99_ms": None, "filter_median_ms": None}
    scenario = Scenario.under("hard", course="paper")
    loop = assembled(scenario, Adversary(), safety=replace(make_safety(scenario.design_model()), **settings))
    log = simulate(loop, seconds, every=5)
    with tempfile.TemporaryDirectory() as folder:
        export_c(loop, folder, blocks=("safety_path", "safety"), name="filter")
        library, header = Path(folder) / "filter.so", (Path(folder) / "filter.h").read_text(encoding="utf-8")
        subprocess.run([*tool, level, "-shared", "-fPIC", f"{folder}/filter.c", "-lm", "-o", str(library)], check=True)
        names = re.findall(r"double (\w+);", header.split("typedef struct {")[2])
        signals = {name.replace(".", "_"): log[name] for name in log}
        columns = [signals[name] for name in names]
        code, taken = ctypes.CDLL(str(library)), []
        state, outputs = ctypes.create_string_buffer(4096), ctypes.create_string_buffer(4096)
        code.filter_init(state)
        for row in np.column_stack(columns):
            given = (ctypes.c_double * len(names))(*row)
            began = time.perf_counter()
            code.filter_step(state, given, outputs)
            taken.append(time.perf_counter() - began)
    p99, median = np.percentile(taken, (99.0, 50.0))
    return {"filter_p99_ms": 1e3 * float(p99), "filter_median_ms": 1e3 * float(median)}


PARTS = ("adversaries", "beyond", "cost", "learners", "car")
"""What it measures; each can be left out, and the last has to be asked for: it takes real time, and the extra `car`."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick is one seed that drives for seconds, and one adversary."""
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS[:-1], metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--drives", type=int, default=10, help="of the car")
    parser.add_argument("--seeds", type=int, default=5, help="seeds of each car")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--compare", type=int, default=1, metavar="N", help="so many of them learn without it too")
    parser.add_argument("--fleet", type=int, default=3, metavar="N", help="cars of the fleet")
    parser.add_argument("--minutes", type=float, default=3.0, help="driving time of a run")
    spread.add_options(parser)
    parser.add_argument("--keep", default="", metavar="FILE", help="keeps runs; those in it are not made again")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the parts asked for and print them."""
    quick, report = options.quick, dict[str, Any]()
    seconds = 2.0 if quick else 15.0
    with spread.computing(spread.where(options)) as those:  # a cluster is asked before anything is measured
        if "adversaries" in options.parts:
            kinds, speeds = (KINDS[:1], SPEEDS[1:2]) if quick else (KINDS, SPEEDS)
            report |= adversaries(seconds, kinds, speeds)
            show("adversaries: largest |e| [m]", [{"kind": kind} | row for kind, row in report["adversaries"].items()])
        if "beyond" in options.parts:
            doubts = (2.0,) if quick else (0.6, 1.0, 2.0, 3.0)
            hostile, at = (KINDS[:1], (5.0,)) if quick else (HOSTILE, (3.0, 7.0, 15.0))
            report |= beyond(seconds, hostile, at, doubts, options.first_seed)
            show("cars beyond the doubts: largest |e| [m]", report["beyond"])
        if "cost" in options.parts:
            report |= cost(1.0, "-O0", horizon=0.35, hold=1, halvings=1) if quick else cost(100.0)
        if "learners" in options.parts:
            report |= learners(options, those)
        if "car" in options.parts:
            report |= on_the_car(1 if quick else options.drives, 0.03 if quick else options.minutes, options.first_seed)
    show_figures(report)
    return report


def on_the_car(drives: int, minutes: float, first_seed: int) -> dict[str, Any]:
    """Learners with the filter on the simulated car behind the bus, at true 20 Hz; |e| from when it is engaged."""
    rows = []
    for seed in range(first_seed, first_seed + drives):
        with tempfile.TemporaryDirectory() as folder:
            rows.append(drive("learn", minutes, Path(folder), safe=True, seed=seed))
        say(f"drive {seed}: {as_line(rows[-1])}")
    asked, same = (sum(row[name] for row in rows) for name in ("requests", "requests_replayed_exactly"))
    return {
        "car_drives": len(rows),
        "car_departures": sum(not row["max_e_m"] <= TRIP for row in rows),
        "car_max_e": max(row["max_e_m"] for row in rows),
        "car_ended_early": sum(bool(row["lost"] or row["faults"]) for row in rows),
        "car_filter_faults": sum(sum(row["filter_faults"].values()) for row in rows),
        "car_interventions_pct": max(row["interventions_pct"] for row in rows),
        "car_longest_step_ms": max(row["longest_step_ms"] for row in rows),
        "car_requests_replayed_pct": 100.0 * same / max(1, asked),
        "car_outcomes": rows,
    }


def learners(options: argparse.Namespace, those: spread.Workers) -> dict[str, Any]:
    """All runs of the learners, seed by seed through the cars, so that a study that is stopped has all of them."""
    quick, course = options.quick, "circle" if options.quick else "paper"  # each net is judged over a round
    cars = [Scenario.under("hard", course=course, name="single track")]
    if not quick:
        cars += [*of_kind("multi-body"), *of_fleet(options.fleet)]
    seeds = range(options.first_seed, options.first_seed + (1 if quick else options.seeds))
    minutes = 0.07 if quick else options.minutes
    jobs = [
        Experiment(setting=replace(DEFAULT, safe=safe, warm_up_seconds=0.0), scenario=car, seed=seed, minutes=minutes)
        for seed in seeds
        for safe in ((True, False) if seed - options.first_seed < options.compare else (True,))
        for car in cars
    ]
    made = kept.done(one_run, jobs, those, options.keep)
    show("learners", made)
    return summarise(made) | {"outcomes": made}


def one_run(experiment: Experiment) -> dict[str, Any]:
    """Let one car learn, random nets first, with the filter or without; only with it is a good net looked for.

    max_e: largest |e| after the first second [m]. interventions_pct: samples of the last minute in which the learner's
    command was mixed with the backup's.
    """
    learner, safe = Learner(experiment), experiment.setting.safe
    log = learner.trained.run.recorder.log()
    last = (log.t >= log.t[-1] - 60.0) & (log["supervisor.learning"] > 0.5)
    share = log["safety.share"] if safe else np.zeros(len(log.t))
    return {
        **learner.figures(look_for_good=safe),
        "car": experiment.scenario.name,
        "safe": safe,
        "max_e": largest(log["path.e"][log.t > 1.0]),
        "interventions_pct": 100.0 * float(np.mean(share[last] > 0.0)) if last.any() else 100.0,
    }


def summarise(learners: Sequence[kept.Row]) -> dict[str, Any]:
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
