"""How fast and how well a setting learns, over seeds fixed beforehand.

Driving time counts everything: the learner's driving, recovery, and waiting for a training to end (charged at the
setting's `fit_seconds`, which the measured cost must not exceed: `longest_training` is measured). A net is GOOD when
it drives a whole round with max |e| < 0.25 m, RMS e < 0.10 m and 0.5 s-averaged lateral jerk < 5 m/s^3. Every net is
test-driven after the run, off the clock, and counts from the moment it took the wheel in the run; the final net is the
last one, not the best. `model-based` is the rival: the same experiment, steered by an optimal gain for the learned
model.

    python -m benchmarks study learning --setting default --seeds 10 --conditions clean --course paper
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.rival import ModelBasedRun
from steerkit.learning.settings import SETTINGS, changed, setting
from steerkit.learning.trials import TrialDrive, drive_many
from steerkit.metrics import GOOD, of_log
from steerkit.scenario import drive as evaluate
from steerkit.scenario.world import World


@dataclass(frozen=True)
class Outcome:
    """What one seed came to; times in seconds of driving, None where it did not happen."""

    seed: int
    first_round_begun: float | None
    first_round_done: float | None
    failures_to_round: int | None
    good: float | None
    failures_to_good: int | None
    failures: int
    transitions: int
    nets: int
    last_nets_hold: float
    final_holds: bool
    final_rms_e: float
    final_max_e: float
    final_wheel_rate_deg: float
    final_jerk_rms: float
    final_max_a_y: float
    longest_training: float
    computing: float


@dataclass(frozen=True)
class Trained:
    """A learning run that has ended, and every net that took the wheel in it."""

    run: LearningRun
    nets: list[Taken]
    longest_training: float
    """Computing time of the longest training [s]."""
    computing: float
    """Wall time of the run [s]."""


@dataclass(frozen=True)
class Taken:
    """A net, and what had happened when it took the wheel."""

    t: float
    """Driving time [s]."""
    failures: int
    transitions: int
    policy: Any


def train(experiment: Experiment, *, model_based: bool = False) -> Trained:
    """Run an experiment to its end."""
    nets: list[Taken] = []
    trainings: list[float] = [0.0]

    def watch(what: str, run: LearningRun) -> None:
        if what == "trained":
            nets.append(Taken(run.t, run.counts.failures, len(run.transitions), run.policy))

    began = time.perf_counter()
    run = (ModelBasedRun if model_based else LearningRun)(experiment, watch=watch)
    while not run.done():
        run.drive()
        if run.counts.train_seconds > trainings[-1]:
            trainings.append(run.counts.train_seconds)
    return Trained(run, nets, float(np.diff(trainings).max(initial=0.0)), time.perf_counter() - began)


def one_seed(job: tuple[Experiment, int, bool]) -> Outcome:
    """Run one seed, then test-drive its nets: the first GOOD one, the last ones, the final one."""
    experiment, last, model_based = job
    trained = train(experiment, model_based=model_based)
    run, nets = trained.run, trained.nets
    drives = test_drives(experiment, [net.policy for net in nets], last)
    found = (i for i, d in enumerate(drives) if d.held and d.summary and GOOD.met(d.summary, rounds=1.0))
    first = next(found, None)
    final = drives[-1] if drives else None
    summary = final.summary if final else None
    nan = float("nan")
    return Outcome(
        seed=experiment.seed,
        first_round_begun=run.counts.first_round_begun,
        first_round_done=run.counts.first_round_done,
        failures_to_round=run.counts.failures_to_round,
        good=None if first is None else nets[first].t,
        failures_to_good=None if first is None else nets[first].failures,
        failures=run.counts.failures,
        transitions=len(run.transitions),
        nets=len(nets),
        last_nets_hold=float(np.mean([d.held for d in drives[-last:]])) if nets else 0.0,
        final_holds=final is not None and final.held,
        final_rms_e=summary.rms_e if summary else nan,
        final_max_e=summary.max_e if summary else nan,
        final_wheel_rate_deg=summary.rms_wheel_rate_deg if summary else nan,
        final_jerk_rms=summary.rms_jerk if summary else nan,
        final_max_a_y=summary.max_a_y if summary else nan,
        longest_training=trained.longest_training,
        computing=trained.computing,
    )


def test_drives(experiment: Experiment, policies: list[Any], last: int) -> list[TrialDrive]:
    """One round for each policy: nets all at once in compiled code; of model policies only the first and last few."""
    world, seed = experiment.world, experiment.seed + 1000
    if all(isinstance(policy, NfqPolicy) for policy in policies):
        layouts: dict[int, list[int]] = {}
        for i, policy in enumerate(policies):
            layouts.setdefault(len(policy.nets or ()), []).append(i)
        drives: dict[int, TrialDrive] = {}
        for rows in layouts.values():
            drives |= zip(rows, drive_many(world, experiment.setting, [policies[i] for i in rows], seed=seed))
        return [drives[i] for i in range(len(policies))]
    return [model_drive(experiment, policy, seed) for policy in (*policies[:5], *policies[5:][-last:])]


def model_drive(experiment: Experiment, policy: Any, seed: int) -> TrialDrive:
    """One round of one policy."""
    world = experiment.world
    log = evaluate.drive(world, policy, doe=experiment.setting.element(), seed=seed, only_while_held=True)
    held = evaluate.held_all_along(log)
    return TrialDrive(
        rounds=float(log["path.progress"][-1]) / world.round_length,
        held=held and bool(log["path.progress"][-1] >= world.round_length),
        summary=of_log(log) if len(log.t) > 20 else None,
    )


def summarise(outcomes: list[Outcome], within: float) -> dict[str, Any]:
    """Shares, medians and worst cases over the seeds; a seed that never got there counts as infinite."""

    def spread(name: str) -> dict[str, float | None]:
        values = [np.inf if v is None else float(v) for v in (getattr(o, name) for o in outcomes)]
        finite = {"median": float(np.median(values)), "worst": float(np.max(values))}
        return {f"{name}_{k}": v if np.isfinite(v) else None for k, v in finite.items()}

    result: dict[str, Any] = {
        "seeds": len(outcomes),
        "round_share": float(np.mean([o.first_round_done is not None for o in outcomes])),
        "round_within_minutes": within / 60.0,
        "round_within_share": float(np.mean([(o.first_round_done or np.inf) <= within for o in outcomes])),
        "good_share": float(np.mean([o.good is not None for o in outcomes])),
        "final_holds_share": float(np.mean([o.final_holds for o in outcomes])),
        "last_nets_hold_share": float(np.mean([o.last_nets_hold for o in outcomes])),
    }
    for name in (
        "first_round_begun",
        "first_round_done",
        "failures_to_round",
        "good",
        "failures_to_good",
        "failures",
        "final_rms_e",
        "final_max_e",
        "final_wheel_rate_deg",
        "final_jerk_rms",
        "final_max_a_y",
        "longest_training",
        "computing",
    ):
        result |= spread(name)
    return result


def main() -> None:
    """Parse the command line, run the seeds, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--setting", default="default", choices=[*sorted(SETTINGS), "model-based"])
    parser.add_argument(
        "--with",
        dest="changes",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change the setting, such as fit.guard=1.2 or after_failure=shift; may be repeated",
    )
    parser.add_argument("--seeds", type=int, default=10, help="seeds 0 to N-1 (default 10)")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--conditions", default="clean", choices=["clean", "hard"])
    parser.add_argument("--course", default="paper")
    parser.add_argument("--plant", default="nonlinear", choices=["nonlinear", "linear"])
    parser.add_argument("--reference", default="front", choices=["front", "cg"])
    parser.add_argument("--v-max", type=float, default=None, help="fastest speed of the driver [m/s]")
    parser.add_argument("--minutes", type=float, default=11.0, help="driving time of a run (default 11)")
    parser.add_argument("--episodes", type=int, default=1000, help="failures after which a run ends")
    parser.add_argument("--last", type=int, default=20, help="how many of the last nets are test-driven")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="print one JSON object as the last line")
    a = parser.parse_args()
    world = replace(World.under(a.conditions, course=a.course), plant=a.plant, reference=a.reference)
    if a.v_max is not None:
        world = replace(world, v_max=a.v_max)
    model_based = a.setting == "model-based"  # actions, rhythm and charged time are the default's
    chosen = changed(setting("default" if model_based else a.setting), a.changes)
    base = Experiment(setting=chosen, world=world, minutes=a.minutes, episodes=a.episodes)
    jobs = [(replace(base, seed=a.first_seed + n), a.last, model_based) for n in range(a.seeds)]
    with ProcessPoolExecutor(a.processes, mp_context=get_context("spawn")) as pool:
        outcomes = list(track(pool.map(one_seed, jobs), total=len(jobs), description=a.setting))
    console = Console(width=170)
    names = list(asdict(outcomes[0]))
    title = f"{' '.join((a.setting, *a.changes))} on {a.course}, {a.conditions}"
    table = Table(*[n.replace("_", " ") for n in names], title=title)
    for o in outcomes:
        table.add_row(*[_cell(v) for v in asdict(o).values()])
    console.print(table)
    result = {
        "setting": a.setting,
        "changes": a.changes,
        "course": a.course,
        "conditions": a.conditions,
        "plant": a.plant,
        "reference": a.reference,
        "v_max": world.v_max,
        "minutes": a.minutes,
        **summarise(outcomes, 660.0),
    }
    for key, value in result.items():
        console.print(f"{key:28s} {_cell(value)}")
    if a.json:
        print(json.dumps({**result, "outcomes": [_plain(asdict(o)) for o in outcomes]}))


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    """JSON knows no NaN: what was not measured is null."""
    return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
