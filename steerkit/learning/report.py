"""What a run looks like to a person: it learns before your eyes; tables; pictures in its directory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from steerkit._support.console import console
from steerkit.diagram.loop import Sample
from steerkit.diagram.simulation import Log
from steerkit.learning import progress, rundir
from steerkit.learning.curve import Curve
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.plots.drive import learning, round_driven
from steerkit.plots.style import save
from steerkit.scenario import drive as evaluate

Each = Callable[[Sample], None]
"""Called with every sample as it is driven."""


def learn_with_progress(
    experiment: Experiment, place: FilePath, *, quiet: bool = False, note: str = "", each: Each | None = None
) -> LearningRun:
    """`learn`, with a moving picture on a terminal and a line for every fifth failure and every round elsewhere."""
    if quiet:
        return learn(experiment, place, each=each)
    if not console.is_terminal:
        lines = progress.in_lines(lambda line: console.print(line, soft_wrap=True))
        return learn(experiment, place, watch=lines, each=each)
    with progress.on_terminal(experiment, console, note=note, before=_before(place)) as watch:
        return learn(experiment, place, watch=watch, each=each)


def _before(place: FilePath) -> Curve | None:
    """What the run in a directory has done so far, if there is one that can be read; `learn` says why it cannot."""
    try:
        log, counts = rundir.drive_log(place), rundir.document(place)["counts"]
    except (ValueError, OSError):
        return None
    failed = np.array([one["ended"] for one in counts["episodes"] if one["failed"]], dtype=float)
    return Curve.of_drive(log.t, log["supervisor.learning"] > 0.5, log["path.e"], failed)


def figures_of_merit(run: LearningRun) -> dict[str, Any]:
    """The numbers of a run that a program would read."""
    counts = run.counts
    return {
        "setting": run.experiment.setting.name,
        "course": run.experiment.scenario.course,
        "seed": run.experiment.seed,
        "driving_minutes": run.t / 60.0,
        "failures": counts.failures,
        "stuck": len(counts.stuck),
        "rounds": counts.rounds,
        "first_round_begun_s": counts.first_round_begun,
        "first_round_done_s": counts.first_round_done,
        "failures_to_round": counts.failures_to_round,
        "transitions": len(run.transitions),
        "updates": counts.updates,
        "training_seconds": counts.train_seconds,
    }


def show(place: FilePath, *, quiet: bool = False) -> dict[str, Any]:
    """Print a run's counts and the final policy against Stanley, and draw the run's pictures beside its data.

    Returns the same for a program: `figures_of_merit`, and under `drives` a row for each of the two.
    """
    run = rundir.load(place)
    merit = figures_of_merit(run)
    table = Table(title=f"{place}", show_header=False)
    for key, value in merit.items():
        table.add_row(key.replace("_", " "), f"{value:.2f}" if isinstance(value, float) else str(value))
    console.print(table)
    scenario = run.experiment.scenario
    logs = {"learned": _final_drive(place, run), "stanley": evaluate.drive(scenario, scenario.recovery_controller())}
    net = "the final net" if run.counts.updates else "a net that was never trained"
    console.print(evaluate.comparison(f"one round of {scenario.course}, {net}", logs))
    drive = rundir.drive_log(place, until=run.t)
    name = run.experiment.setting.name
    save(learning(drive, title=f"{name} on {scenario.course}: from the first second"), place / "learning.png")
    title = f"{name} on {scenario.course}: final net"
    save(round_driven(logs["learned"], logs["stanley"], title=title), place / "round.png")
    if not quiet:
        console.print(f"pictures: {place}/learning.png, {place}/round.png", soft_wrap=True)
    return merit | {"drives": [evaluate.row_of(name, log) for name, log in logs.items()]}


def _final_drive(place: FilePath, run: LearningRun) -> Log:
    """A test drive of the net that a run had when it was loaded, where it was learned."""
    scenario = run.experiment.scenario
    policy = rundir.final_policy(place, run.counts.updates)
    return evaluate.drive(scenario, policy, doe=run.experiment.setting.element(scenario.nominal))


def show_several(places: Sequence[FilePath]) -> list[dict[str, Any]]:
    """Print several runs as one table: what learning took, and a test drive of each one's final net."""
    rows = []
    table = Table("", *(escape(str(place)) for place in places), title=f"{len(places)} runs")
    for column in table.columns[1:]:
        column.overflow = "fold"
    for place in places:
        run = rundir.load(place)
        rows.append(
            figures_of_merit(run) | {"run": str(place), "drive": evaluate.row_of(str(place), _final_drive(place, run))}
        )
    for head, cell in _OF_RUNS.items():  # a column a run: a row a run is wider than a terminal
        table.add_row(escape(head), *(escape(cell(row)) for row in rows))
    console.print(table)
    return rows


_OF_RUNS: dict[str, Callable[[dict[str, Any]], str]] = {
    "setting": lambda row: str(row["setting"]),
    "course": lambda row: str(row["course"]),
    "seed": lambda row: str(row["seed"]),
    "driven [min]": lambda row: f"{row['driving_minutes']:.1f}",
    "failures": lambda row: str(row["failures"]),
    "rounds": lambda row: str(row["rounds"]),
    "updates": lambda row: str(row["updates"]),
    "first round [s]": lambda row: "-" if row["first_round_done_s"] is None else f"{row['first_round_done_s']:.0f}",
    "held": lambda row: "yes" if row["drive"]["held"] else "no",
    "RMS e [m]": lambda row: f"{row['drive']['rms_e']:.3f}",
    "max e [m]": lambda row: f"{row['drive']['max_e']:.3f}",
    "wheel [deg/s]": lambda row: f"{row['drive']['rms_wheel_rate_deg']:.0f}",
}
