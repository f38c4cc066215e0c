"""The speed and the quality with which a setting learns, over seeds fixed beforehand.

Driving time counts everything: the learner's driving, recovery, and waiting for a training to end (charged at the
setting's `fit_seconds`, which the measured cost must not exceed: `longest_training` is measured). A net is GOOD when
it drives a whole round with max |e| < 0.25 m, RMS e < 0.10 m and 0.5 s-averaged lateral jerk < 5 m/s^3. Every net is
test-driven after the run, off the clock, and counts from the moment it took the wheel in the run; the final net is the
last one, not the best.

    python -m benchmarks study learning --setting default --seeds 10 --conditions hard [--quick] [--json]

Does it learn any car there is? With --fleet N: N cars drawn from the fleet, each on a course of its own; with --cars
KIND: cars with steering delays, at low or at high speed, CommonRoad's multi-body car (`benchmarks.scenarios`). The
learner knows nothing of its car. Analytic controllers drive the same test once with the true parameters
(`Knowledge.oracle`, delay and lag) and once with the data sheet (mass, tyres, ratio; nothing of the steering's delay,
lag and offset). Play and sensor noise are unknown to all. A ratio is that of the learner's final net to the analytic
controller of the least RMS e.

With --backend dask --address tcp://HOST:PORT the workers of a cluster do it; the figures are the same.
"""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.run import kept, spread
from benchmarks.run.learners import OTHER, Learner, best_of, best_told, good, median, over, share, worst
from benchmarks.scenarios import KINDS, of_fleet, of_kind
from benchmarks.tables import show, show_figures
from steerkit.learning.experiment import Experiment
from steerkit.learning.settings import SETTINGS, changed, setting
from steerkit.scenario import Scenario

LAST = 20
"""So many of a run's last nets: how many of them hold a round?"""
ORACLE = ("stanley-delay", "lqr", "mpc")
"""Analytic controllers that take a believed delay."""
TOLD_DATA_SHEET = ("stanley", "lqr", "mpc")
"""Those that a data sheet is enough for."""


def one_seed(experiment: Experiment) -> dict[str, Any]:
    """Run one seed, then test-drive its nets: until the first GOOD one, the last ones, the final one.

    last_nets_hold: share of the last `LAST` nets. longest_training: computing time [s].
    """
    learner = Learner(experiment)
    last = [learner.drive(net).held for net in learner.trained.nets[-LAST:]]
    return {
        **learner.figures(every=1),
        "last_nets_hold": float(np.mean(last)) if last else 0.0,
        "longest_training": learner.trained.longest_training,
    }


def one_car(experiment: Experiment) -> dict[str, Any]:
    """Let a car learn, and compare its final net with the best analytic controllers: with the truth, and without."""
    learner, scenario, test = Learner(experiment), experiment.scenario, experiment.seed + OTHER
    best, truth = best_told(scenario, ORACLE, test)
    on_sheet, sheet = best_of(scenario.with_(knowledge={"delay": 0.0, "lag": 0.0}), TOLD_DATA_SHEET, test)
    return {
        **learner.figures(),
        "name": scenario.name,
        "best": best,
        "rms_x_oracle": over(learner.final, "rms_e", truth),
        "wheel_x_oracle": over(learner.final, "rms_wheel_rate_deg", truth),
        "jerk_x_oracle": over(learner.final, "rms_jerk", truth),
        "best_on_data_sheet": on_sheet,
        "rms_x_data_sheet": over(learner.final, "rms_e", sheet),
    }


def of_seeds(rows: Sequence[kept.Row]) -> dict[str, Any]:
    """Shares, medians and worst cases over the seeds; a seed that never got there counts as infinite."""
    figures: dict[str, Any] = {
        "seeds": len(rows),
        "round_share": share(rows, "first_round_done"),
        "good_share": share(rows, "good"),
        "final_holds_share": share(rows, "held"),
        "last_nets_hold_share": float(np.mean([row["last_nets_hold"] for row in rows])),
    }
    for name in (
        "first_round_done",
        "good",
        "failures",
        "final_rms_e",
        "final_max_e",
        "final_wheel_rate_deg",
        "longest_training",
    ):
        figures |= {f"{name}_median": median(rows, name), f"{name}_worst": worst(rows, name)}
    return figures


def of_cars(rows: Sequence[kept.Row]) -> dict[str, Any]:
    """Shares, medians and worst cases over cars; one that never got there counts as infinite."""
    ratios = ("rms_x_oracle", "wheel_x_oracle", "jerk_x_oracle", "rms_x_data_sheet")
    return {
        "cars": len(rows),
        **good(rows),
        "failures_worst": max(row["failures"] for row in rows),
        "departure_median_m": median(rows, "departure"),
        "departure_worst_m": worst(rows, "departure"),
        "held_share": share(rows, "held"),
        **{name: median(rows, name) for name in ratios},
        "worst_rms_x_oracle": worst(rows, "rms_x_oracle"),
        "stuck": sum(row["stuck"] for row in rows),
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick is one seed that drives for a quarter of a minute."""
    parser.add_argument("--setting", default="default", choices=sorted(SETTINGS))
    parser.add_argument(
        "--with",
        dest="changes",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change the setting, such as fit.nets=3 or after_failure=reset; may be repeated",
    )
    parser.add_argument("--fleet", type=int, default=0, metavar="N", help="N cars of the fleet, 5 minutes each")
    parser.add_argument("--cars", choices=list(KINDS), default=None, help="cars of that kind, 5 minutes each")
    parser.add_argument("--seeds", type=int, default=None, help="how many seeds (default 10)")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--conditions", default="clean", choices=["clean", "hard"])
    parser.add_argument("--course", default="paper")
    parser.add_argument("--minutes", type=float, default=None, help="driving time of a run (default 11)")
    spread.add_options(parser)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Run the seeds, print the tables."""
    where, quick = spread.where(options), options.quick
    how = changed(setting(options.setting), options.changes)
    fleet = options.fleet or options.cars
    usual_seeds, usual_minutes = (1, 5.0) if fleet else (10, 11.0)
    if quick:
        usual_seeds, usual_minutes = 1, 0.25
    count = usual_seeds if options.seeds is None else options.seeds
    minutes = usual_minutes if options.minutes is None else options.minutes
    rounds = 0.05 if quick else 1.0
    if options.cars:
        cars = of_kind(options.cars, course={"rounds": rounds})
    elif options.fleet:
        cars = of_fleet(options.fleet, rounds)
    else:
        cars = (Scenario.under(options.conditions, course=options.course),)
    jobs = [
        Experiment(setting=how, scenario=car, minutes=minutes, seed=seed)
        for car in (cars[:1] if quick else cars)
        for seed in range(options.first_seed, options.first_seed + count)
    ]
    with spread.computing(where) as those:
        rows = kept.done(one_car if fleet else one_seed, jobs, those)
    show(f"{' '.join((options.setting, *options.changes))}, {minutes:g} minutes", rows)
    if fleet:
        return of_cars(rows) | {"outcomes": rows}
    asked = {name: getattr(options, name) for name in ("setting", "changes", "course", "conditions")}
    figures = {**asked, "minutes": minutes, **of_seeds(rows)}
    show_figures(figures)
    return figures | {"outcomes": rows}
