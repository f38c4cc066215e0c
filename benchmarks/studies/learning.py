"""The speed and the quality with which a setting learns, over seeds fixed beforehand.

Driving time counts everything: the learner's driving, recovery, and waiting for a training to end (charged at the
setting's `fit_seconds`, which the measured cost must not exceed: `longest_training` is measured). A net is GOOD when
it drives a whole round with max |e| < 0.25 m, RMS e < 0.10 m and 0.5 s-averaged lateral jerk < 5 m/s^3. Every net is
test-driven after the run, off the clock, and counts from the moment it took the wheel in the run; the final net is the
last one, not the best.

    python -m benchmarks study learning --setting default --seeds 10 --conditions hard [--quick] [--json]

With --fleet N: N cars drawn from the fleet, each on a course of its own; with --cars KIND: cars with steering delays,
at low or at high speed, CommonRoad's multi-body car (`benchmarks.run.fleet`). With --backend
dask --address tcp://HOST:PORT the workers of a cluster do it; the figures are the same.
"""

import argparse
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from benchmarks.run import spread
from benchmarks.run.fleet import KINDS, fleet, of_fleet, of_kind
from benchmarks.run.trials import drive_each, train
from benchmarks.tables import show, show_figures
from steerkit.learning.experiment import Experiment
from steerkit.learning.settings import SETTINGS, changed, setting
from steerkit.scenario import Scenario

LAST = 20
"""So many of a run's last nets: how many of them hold a round?"""


@dataclass(frozen=True)
class Outcome:
    """What one seed came to; times in seconds of driving, None where it did not happen."""

    seed: int
    first_round_done: float | None
    good: float | None
    failures: int
    transitions: int
    nets: int
    last_nets_hold: float
    final_holds: bool
    final_rms_e: float
    final_max_e: float
    final_wheel_rate_deg: float
    longest_training: float


def one_seed(experiment: Experiment) -> Outcome:
    """Run one seed, then test-drive its nets: the first GOOD one, the last ones, the final one."""
    trained = train(experiment)
    run, nets = trained.run, trained.nets
    policies = [net.policy for net in nets]
    drives = drive_each(experiment.scenario, experiment.setting, policies, seed=experiment.seed + 1000)
    first = next((i for i, drive in enumerate(drives) if drive.good), None)
    final = drives[-1] if drives else None
    summary = final.summary if final else None
    nan = float("nan")
    return Outcome(
        seed=experiment.seed,
        first_round_done=run.counts.first_round_done,
        good=None if first is None else nets[first].t,
        failures=run.counts.failures,
        transitions=len(run.transitions),
        nets=len(trained.nets),
        last_nets_hold=float(np.mean([d.held for d in drives[-LAST:]])) if nets else 0.0,
        final_holds=final is not None and final.held,
        final_rms_e=summary.rms_e if summary else nan,
        final_max_e=summary.max_e if summary else nan,
        final_wheel_rate_deg=summary.rms_wheel_rate_deg if summary else nan,
        longest_training=trained.longest_training,
    )


def summarise(outcomes: list[Outcome]) -> dict[str, Any]:
    """Shares, medians and worst cases over the seeds; a seed that never got there counts as infinite."""

    def spread(name: str) -> dict[str, float | None]:
        values = [np.inf if v is None else float(v) for v in (getattr(o, name) for o in outcomes)]
        finite = {"median": float(np.median(values)), "worst": float(np.max(values))}
        return {f"{name}_{k}": v if np.isfinite(v) else None for k, v in finite.items()}

    result: dict[str, Any] = {
        "seeds": len(outcomes),
        "round_share": float(np.mean([o.first_round_done is not None for o in outcomes])),
        "good_share": float(np.mean([o.good is not None for o in outcomes])),
        "final_holds_share": float(np.mean([o.final_holds for o in outcomes])),
        "last_nets_hold_share": float(np.mean([o.last_nets_hold for o in outcomes])),
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
        result |= spread(name)
    return result


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
    where = spread.where(options)
    count = (1 if options.quick else 10) if options.seeds is None else options.seeds
    minutes = (0.25 if options.quick else 11.0) if options.minutes is None else options.minutes
    if options.fleet or options.cars:
        how = changed(setting(options.setting), options.changes)
        seeds = range(options.first_seed, options.first_seed + (1 if options.seeds is None else options.seeds))
        five = minutes if options.minutes is not None or options.quick else 5.0
        rounds = 0.05 if options.quick else 1.0
        cars = of_kind(options.cars, course={"rounds": rounds}) if options.cars else of_fleet(options.fleet, rounds)
        return fleet(cars[:1] if options.quick else cars, seeds, how, five, where)
    scenario = Scenario.under(options.conditions, course=options.course)
    chosen = changed(setting(options.setting), options.changes)
    base = Experiment(setting=chosen, scenario=scenario, minutes=minutes)
    jobs = [replace(base, seed=options.first_seed + n) for n in range(count)]
    with spread.computing(where) as those:
        outcomes = those.in_order(one_seed, jobs, options.setting)
    show(f"{' '.join((options.setting, *options.changes))} on {options.course}, {options.conditions}", outcomes)
    result = {
        "setting": options.setting,
        "changes": options.changes,
        "course": options.course,
        "conditions": options.conditions,
        "minutes": minutes,
        **summarise(outcomes),
    }
    show_figures(result)
    return {**result, "outcomes": [asdict(o) for o in outcomes]}
