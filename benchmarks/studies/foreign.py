"""Recovery, learners and adaptive controllers on cars that no one here wrote, told rightly, wrongly or not at all.

Cars: `torque`, made from the measured answers of a production car (`benchmarks.plants.torque_car`); `mujoco`, a free
body on four suspended wheels; `commonroad-1` to `-3`, CommonRoad's multi-body cars. The torque car has 0.5 s of dead
time of its own, the others 0.2 s and a motor. Courses: `random-N` below 8 m/s, `sweeping-N` (wide bends and straights)
above, N by the seed. Judged by the simulated truth.

**recovery**: every drive starts 1 m and 5 degrees off, to either side by its seed, where a course hardly bends; clean.

* recovery_max_e: largest |e| after 15 s, of the worst drive.
* recovery_swings: drives with a limit cycle: after 15 s, four half-periods on end or more whose durations are within a
  factor of 1.5 of their median, and whose turning points are 0.2 m apart or more (an amplitude of 0.1 m). What wind or
  wander does is not as regular.
* recovery_back_share: drives that are within 0.3 m at 15 s; recovery_stays_share: within 0.5 m from then on.

They are those of `auto`, the recovery that the catalogue picks, over all drives; `rows` has each car, speed and dead
time told. A drive is lost, and ends, at |e| = 20 m. Told `none`: that there is no dead time.

**adaptive**: the same starts and speeds, a minute, told a lag of 0.02 and of 0.2 s. adaptive_spread: by what factor RMS
e after 20 s differs, at worst over cars, speeds, seeds, `lqr-adaptive` and `stanley-adaptive`.

**learner**: each seed learns for --minutes in two ranges of speed, `hard` sensors. GOOD is when a net takes the wheel
that drives a whole round as `study learning` asks, or as well as the best told controller, within 10 %, in what that
one cannot keep to (best_good_share: in which runs it is GOOD; by torque, its jerk alone is 5 m/s^3, the slew).
good_share, good_median_s and good_worst_s are over all runs;
rms_x_best_told and wheel_x_best_told are the final net's RMS e and wheel rate over those of the best analytic
controller that is told all that can be told, and wheel_spread_nets is by what factor a wheel rate of the last 20 nets
is off their median: each the median over seeds of the car and range where it is largest (`_torque`, `_others`: of these
cars; `_worst`: of the worst run; rms_x_after_1_minute: of the net that steered then).

**changes**: a learner with the safety filter drives for --phase minutes, then the car changes, and nobody is told
(`benchmarks.run.changes`). changes_recovered_s: from the change to the end of the first 20 s in which RMS e is within
1.2 times that of the best made for the new car (analytic and told, or newly learned) under the same noise;
changes_x_best: the same ratio from 60 s on; changes_departures: changes after which |e| exceeds 0.5 m. All of the worst
change.

Figures that are infinite (never, or lost) are null. With --keep each drive is kept as it ends, and the same command
goes on after a stop.

    python -m benchmarks study foreign [--parts PART ...] [--cars CAR ...] [--seeds N] [--keep FILE] [--quick] [--json]
"""

import argparse
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.foreign_cars import CARS, HOME, scene, told
from benchmarks.run import changes, kept, spread
from benchmarks.run.changes import CHANGES, one_change
from benchmarks.run.learners import TOLD as ANALYTIC
from benchmarks.run.learners import Job as LearnerJob
from benchmarks.run.learners import good, median, one_learner, share, worst
from benchmarks.tables import show, show_figures
from steerkit.diagram.simulation import Log, simulate
from steerkit.diagram.units import radians_of
from steerkit.metrics.signals import rms
from steerkit.scenario import Scenario
from steerkit.scenario.assembly import placed
from steerkit.scenario.catalogue import AUTO, RECOVERIES, make_controller, make_recovery
from steerkit.scenario.drive import assembled
from steerkit.task import TRIP

PARTS = ("recovery", "adaptive", "learner", "changes")
BACK, SETTLED, STAYS, LOST = 15.0, 0.3, 0.5, 20.0  # s, m, m, m
AMPLITUDE, HALVES, REGULAR = 0.1, 4, 1.5  # m, half-periods, factor
OFF, TURNED = 1.0, radians_of(5.0)
TOLD = ("0.5", "1", "1.5", "none")
ADAPTIVE, LAGS, ADAPTED = ("lqr-adaptive", "stanley-adaptive"), (0.02, 0.2), 20.0  # s, s
LAST = 20
"""So many of a learner's last nets have their wheel rates compared."""


@dataclass(frozen=True)
class Job:
    """One drive."""

    car: str
    speed: float
    told: str
    controller: str
    seed: int
    seconds: float
    conditions: str


@dataclass(frozen=True)
class AdaptiveJob:
    """One drive of an adaptive controller that is told a lag [s]."""

    car: str
    speed: float
    controller: str
    lag: float
    seed: int
    seconds: float
    conditions: str


def one_drive(job: Job) -> dict[str, Any]:
    """Drive it, and judge it."""
    scenario = scene(job.car, job.speed, job.speed, job.seed, job.conditions)
    scenario = told(scenario, 0.0 if job.told == "none" else float(job.told))
    log = from_beside(scenario, job.controller, job.seed, job.seconds)
    return judged(log.t, log["path.e"], job.seconds)


def one_adaptive(job: AdaptiveJob) -> dict[str, Any]:
    """Drive it. rms_e: after `ADAPTED` [m]; infinite for a lost drive."""
    scenario = scene(job.car, job.speed, job.speed, job.seed, job.conditions).with_(knowledge={"lag": job.lag})
    log = from_beside(scenario, job.controller, job.seed, job.seconds)
    held = log.t[-1] >= job.seconds - 0.1
    return {"rms_e": rms(log["path.e"][log.t >= min(ADAPTED, 0.5 * job.seconds)]) if held else math.inf}


def from_beside(scenario: Scenario, controller: str, seed: int, seconds: float) -> Log:
    """A drive that starts beside the path, until it is lost."""
    make = partial(make_recovery, alone=True) if controller in RECOVERIES else make_controller
    loop = assembled(scenario, make(controller, scenario.design_model()), seed=seed)
    side, turn = (1.0 if seed % 2 == 0 else -1.0), (1.0 if seed // 2 % 2 == 0 else -1.0)
    start = placed(loop.blocks["car"], scenario.path(), s=scenario.course.start, e=side * OFF, psi_e=turn * TURNED)
    return simulate(
        loop.with_block("car", start),
        seconds,
        every=5,
        until=lambda sample: not abs(sample["path.e"]) < LOST,
        allow_nonfinite=True,
    )


def judged(t: Any, e: Any, seconds: float) -> dict[str, Any]:
    """What a drive's e [m] at times t [s] shows from `BACK` on, if it should have lasted that long [s].

    max_e: largest |e| [m]. back, stays: within `SETTLED` at `BACK`, within `STAYS` from then on. swing, period: of a
    limit cycle, its amplitude [m], 0 without one, and its period [s], NaN without one.
    """
    lost = not (t[-1] >= seconds - 0.1 and np.isfinite(e).all())
    late = t >= min(BACK, 0.5 * t[-1] if lost else BACK)
    largest = math.inf if lost else float(np.abs(e[late]).max())
    amplitude, period = limit_cycle(t[late], e[late])
    back = not lost and abs(float(e[late][0])) <= SETTLED
    return {"max_e": largest, "back": back, "stays": largest <= STAYS, "swing": amplitude, "period": period}


def limit_cycle(t: Any, e: Any) -> tuple[float, float]:
    """Amplitude [m] and period [s] of the swinging in e [m] over t [s]; 0 and NaN where it is none.

    A turning point is one from which e comes back by twice `AMPLITUDE`. The last half-periods count, as many of them as
    are regular.
    """
    turns, rising, at = list[tuple[float, float]](), 0, 0
    for k in range(1, len(e)):
        ahead = (e[k] - e[at]) * rising
        if rising == 0:
            moved = e[k] - e[0]
            if abs(moved) >= 2.0 * AMPLITUDE:
                rising, at = (1 if moved > 0.0 else -1), k
        elif ahead >= 0.0:
            at = k
        elif ahead <= -2.0 * AMPLITUDE:
            turns.append((float(t[at]), float(e[at])))
            rising, at = -rising, k
    times, places = np.array(turns).reshape(-1, 2).T
    for end in range(len(times), HALVES, -1):
        halves = np.diff(times[end - HALVES - 1 : end])
        middle = float(np.median(halves))
        if (halves <= REGULAR * middle).all() and (halves >= middle / REGULAR).all():
            return 0.5 * float(np.median(np.abs(np.diff(places[end - HALVES - 1 : end])))), 2.0 * middle
    return 0.0, math.nan


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick is a short drive of each part."""
    cars = f"{', '.join(CARS)}; of the changes: {HOME}, mujoco, ..."
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=PARTS, metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--cars", nargs="+", default=None, choices=[*CARS, HOME], metavar="CAR", help=cars)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=5.0, help="of each learner")
    parser.add_argument("--phase", type=float, default=2.0, help="minutes before and after each change")
    parser.add_argument("--keep", default="", metavar="FILE", help="keeps drives; those in it are not made again")
    spread.add_options(parser)


def jobs_of(part: str, options: argparse.Namespace) -> list[Any]:
    """What a part drives, seed by seed, so that a study that is stopped has all cars."""
    quick, some = options.quick, slice(1 if options.quick else None)
    seeds = range(options.first_seed, options.first_seed + (1 if quick else options.seeds))
    cars = [(seed, car) for seed in seeds for car in [car for car in options.cars or CARS if car in CARS][some]]
    steady = [(seed, car, speed) for seed, car in cars for speed in CARS[car].speeds[some]]
    if part == "recovery":
        seconds, factors = (15.2, ("1",)) if quick else (40.0, TOLD)
        return [Job(car, v, factor, AUTO, seed, seconds, "clean") for seed, car, v in steady for factor in factors]
    if part == "adaptive":
        seconds, names = (2.0, ADAPTIVE[-1:]) if quick else (60.0, ADAPTIVE)
        ways = [(name, lag) for name in names for lag in LAGS]
        return [AdaptiveJob(car, v, *way, seed, seconds, "clean") for seed, car, v in steady for way in ways]
    if part == "learner":
        how = (0.2, "hard", 1, ANALYTIC[1:2], 0.05) if quick else (options.minutes, "hard", LAST)
        return [LearnerJob(car, *speeds, seed, *how) for seed, car in cars for speeds in CARS[car].ranges[some]]
    short: dict[str, Any] = {"minutes": 0.05, "told": ("lqr",)} if quick else {"minutes": options.phase}
    every = [
        changes.Job(car=car, change=change, seed=seed, conditions="hard", **short)
        for seed in seeds
        for change in CHANGES
        for car in CHANGES[change].cars
        if car in (options.cars or (HOME, "mujoco"))
    ]
    return every[:1] if quick else every


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Make the drives, print tables."""
    how: dict[str, tuple[Callable[[Any], Any], Callable[[list[kept.Row]], dict[str, Any]]]] = {
        "recovery": (one_drive, recovery_figures),
        "adaptive": (one_adaptive, adaptive_figures),
        "learner": (one_learner, learner_figures),
        "changes": (one_change, changes_figures),
    }
    report, codes = dict[str, Any](), set[str]()
    with spread.computing(spread.where(options)) as those:
        for part in [part for part in PARTS if part in options.parts]:
            function, figures = how[part]
            rows = kept.done(function, jobs_of(part, options), those, options.keep)
            codes |= {row["code"] for row in rows}
            report |= figures(rows) if rows else {}
    show_figures(report)
    return report | {"codes": len(codes)}


def _groups(rows: Iterable[kept.Row], *names: str) -> dict[tuple[Any, ...], list[kept.Row]]:
    """Rows by the values of these fields."""
    groups = dict[tuple[Any, ...], list[kept.Row]]()
    for row in rows:
        groups.setdefault(tuple(row[name] for name in names), []).append(row)
    return groups


def recovery_figures(drives: Sequence[kept.Row]) -> dict[str, Any]:
    """Those of all drives, and a row a controller, car, speed and dead time told."""
    names = ("controller", "car", "speed", "told")
    rows = [dict(zip(names, key)) | _recovered(group) for key, group in _groups(drives, *names).items()]
    show("recovery", rows)
    return {**_recovered(drives), "rows": rows, "drives": list(drives)}


def _recovered(drives: Sequence[kept.Row]) -> dict[str, Any]:
    """Worst cases, counts and shares over drives."""
    return {
        "recovery_drives": len(drives),
        "recovery_max_e": max(drive["max_e"] for drive in drives),
        "recovery_swings": sum(drive["swing"] > 0.0 for drive in drives),
        "recovery_swing_worst": max(drive["swing"] for drive in drives),
        "recovery_lost": sum(not math.isfinite(drive["max_e"]) for drive in drives),
        "recovery_back_share": share(drives, "back"),
        "recovery_stays_share": share(drives, "stays"),
    }


def adaptive_figures(drives: Sequence[kept.Row]) -> dict[str, Any]:
    """The largest ratio of RMS e of two drives that differ in the lag told only, of each car, controller and speed."""
    rows = []
    for (car, name, speed), group in _groups(drives, "car", "controller", "speed").items():
        pairs = [[drive["rms_e"] for drive in pair] for pair in _groups(group, "seed").values() if len(pair) == 2]
        if pairs:
            ratios = [max(pair) / min(pair) if math.isfinite(max(pair)) else math.inf for pair in pairs]
            spreads = {"adaptive_spread": max(ratios), "median": float(np.median(ratios))}
            row = {"car": car, "controller": name, "speed": speed, "seeds": len(pairs)} | spreads
            rows.append(row | {"rms_e_worst": max(map(max, pairs))})
    if not rows:
        return {}
    show("adaptive controllers, told a lag of 0.02 or 0.2 s", rows)
    return {"adaptive_spread": max(row["adaptive_spread"] for row in rows), "adaptive_rows": rows}


_WORST = {
    "rms_x_best_told": "rms_x",
    "rms_x_after_1_minute": "rms_x_1",
    "wheel_x_best_told": "wheel_x",
    "wheel_spread_nets": "wheel_spread",
}
"""Figures of the learners, and of which field each is."""


def learner_figures(runs: Sequence[kept.Row]) -> dict[str, Any]:
    """Medians and worst cases over the runs; what never happened, or did not hold, is infinite."""
    rows = []
    for (car, v_min, v_max), group in _groups(runs, "car", "v_min", "v_max").items():
        row = {"car": car, "v": f"{v_min:g} to {v_max:g} m/s", "seeds": len(group)} | good(group)
        for name, field in _WORST.items():
            row |= {name: median(group, field), f"{name}_worst": worst(group, field)}
        row |= {name: max(run[name] for run in group) for name in ("failures", "departure", "stuck")}
        rows.append(row | {"held_share": share(group, "held")})
    show("learners", rows)
    report = {"learners": len(runs), **good(runs), "best_good_share": share(runs, "best_good")}
    for name in _WORST:
        report[name] = max(row[name] for row in rows)
        report[f"{name}_worst"] = max(row[f"{name}_worst"] for row in rows)
        for kind, mine in (("torque", True), ("others", False)):
            medians = [row[name] for row in rows if (row["car"] == "torque") == mine]
            report |= {f"{name}_{kind}": max(medians)} if medians else {}
    return report | {"learner_rows": rows, "learner_runs": list(runs)}


def changes_figures(drives: Sequence[kept.Row]) -> dict[str, Any]:
    """Worst cases over all changes; what never happened is infinite."""
    fields = ("best", "best_rms_e", "recovered", "x", "max_e", "failures")
    rows = [
        {"car": drive["car"], "change": drive["change"], "n": n + 1, "seed": drive["seed"]}
        | {name: drive[name][n] for name in fields}
        for drive in drives
        for n in range(len(drive["best"]))
    ]
    show("changes", rows)
    return {
        "changes": len(rows),
        "changes_recovered_s": max(row["recovered"] for row in rows),
        "changes_recovered_median_s": float(np.median([row["recovered"] for row in rows])),
        "changes_x_best": float(np.max([row["x"] for row in rows])),
        "changes_x_best_median": float(np.median([row["x"] for row in rows])),
        "changes_departures": sum(not row["max_e"] <= TRIP for row in rows),
        "changes_max_e": max(row["max_e"] for row in rows),
        "changes_rows": rows,
    }
