"""How fast and how well a setting learns, over seeds fixed beforehand.

Driving time counts everything: the learner's driving, recovery, and waiting for a training to end (charged at the
setting's `fit_seconds`, which the measured cost must not exceed: both are reported). A net is GOOD when it drives a
whole round with max |e| < 0.25 m, RMS e < 0.10 m and 0.5 s-averaged lateral jerk < 5 m/s^3. Every net is test-driven
after the run, off the clock, from the moment it took the wheel in the run; the final net is the last one, not the
best.

    python benchmarks/learning.py --setting default --seeds 10 --conditions clean --course paper
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.learning import evaluate
from steerkit.learning.experiment import Experiment, LearningRun, learn
from steerkit.learning.settings import SETTINGS, setting
from steerkit.learning.world import World
from steerkit.metrics import GOOD, of_log


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
    last_nets_hold: float
    final_holds: bool
    final_rms_e: float
    final_max_e: float
    final_wheel_rate_deg: float
    final_jerk_rms: float
    final_max_a_y: float
    longest_training: float
    computing: float


def one_seed(job: tuple[Experiment, int]) -> Outcome:
    """Run one seed, then test-drive its nets: the first GOOD one, the last ones, the final one."""
    import time

    experiment, last = job
    nets: list[tuple[float, int, NfqPolicy]] = []
    costs: list[float] = []

    def watch(what: str, run: LearningRun) -> None:
        if what == "trained":
            nets.append((run.t, run.counts.failures, run.policy))
        costs.append(run.counts.train_seconds)

    began = time.perf_counter()
    run = learn(experiment, watch=watch)
    computing = time.perf_counter() - began
    world, element = experiment.world, experiment.setting.element
    cache: dict[int, Any] = {}

    def round_of(i: int) -> Any:
        if i not in cache:
            log = evaluate.drive(world, nets[i][2], doe=element(), seed=experiment.seed + 1000, only_while_held=True)
            cache[i] = (evaluate.held_all_along(log), of_log(log) if len(log.t) > 20 else None)
        return cache[i]

    first = next((i for i in range(len(nets)) if round_of(i)[0] and GOOD.met(round_of(i)[1], rounds=1.0)), None)
    tail = range(max(0, len(nets) - last), len(nets))
    held, final = round_of(len(nets) - 1) if nets else (False, None)
    nan = float("nan")
    return Outcome(
        seed=experiment.seed,
        first_round_begun=run.counts.first_round_begun,
        first_round_done=run.counts.first_round_done,
        failures_to_round=run.counts.failures_to_round,
        good=None if first is None else nets[first][0],
        failures_to_good=None if first is None else nets[first][1],
        failures=run.counts.failures,
        transitions=len(run.transitions),
        last_nets_hold=float(np.mean([round_of(i)[0] for i in tail])) if nets else 0.0,
        final_holds=held,
        final_rms_e=final.rms_e if final else nan,
        final_max_e=final.max_e if final else nan,
        final_wheel_rate_deg=final.rms_wheel_rate_deg if final else nan,
        final_jerk_rms=final.rms_jerk if final else nan,
        final_max_a_y=final.max_a_y if final else nan,
        longest_training=float(np.diff([0.0, *costs]).max(initial=0.0)),
        computing=computing,
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
    for name in ("first_round_begun", "first_round_done", "failures_to_round", "good", "failures_to_good", "failures",
                 "final_rms_e", "final_max_e", "final_wheel_rate_deg", "final_jerk_rms", "final_max_a_y",
                 "longest_training", "computing"):  # fmt: skip
        result |= spread(name)
    return result


def main() -> None:
    """Parse the command line, run the seeds, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--setting", default="default", choices=sorted(SETTINGS))
    parser.add_argument("--seeds", type=int, default=10, help="seeds 0 to N-1 (default 10)")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--conditions", default="clean", choices=["clean", "hard"])
    parser.add_argument("--course", default="paper")
    parser.add_argument("--plant", default="nonlinear", choices=["nonlinear", "linear"])
    parser.add_argument("--v-max", type=float, default=None, help="fastest speed of the driver [m/s]")
    parser.add_argument("--minutes", type=float, default=11.0, help="driving time of a run (default 11)")
    parser.add_argument("--episodes", type=int, default=1000, help="failures after which a run ends")
    parser.add_argument("--last", type=int, default=20, help="how many of the last nets are test-driven")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="print one JSON object as the last line")
    a = parser.parse_args()
    world = replace(World.under(a.conditions, course=a.course), plant=a.plant)
    if a.v_max is not None:
        world = replace(world, v_max=a.v_max)
    base = Experiment(setting=setting(a.setting), world=world, minutes=a.minutes, episodes=a.episodes)
    jobs = [(replace(base, seed=a.first_seed + n), a.last) for n in range(a.seeds)]
    with ProcessPoolExecutor(a.processes, mp_context=get_context("spawn")) as pool:
        outcomes = list(track(pool.map(one_seed, jobs), total=len(jobs), description=a.setting))
    console = Console(width=170)
    names = list(asdict(outcomes[0]))
    table = Table(*[n.replace("_", " ") for n in names], title=f"{a.setting} on {a.course}, {a.conditions}")
    for o in outcomes:
        table.add_row(*[_cell(v) for v in asdict(o).values()])
    console.print(table)
    result = {"setting": a.setting, "course": a.course, "conditions": a.conditions, **summarise(outcomes, 660.0)}
    for key, value in result.items():
        console.print(f"{key:28s} {_cell(value)}")
    if a.json:
        print(json.dumps({**result, "outcomes": [asdict(o) for o in outcomes]}))


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
