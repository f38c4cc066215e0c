"""What a run looks like to a person: it learns before your eyes; tables; pictures in its directory."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from steerkit._support.errors import require
from steerkit._support.files import write_text
from steerkit._support.plugins import fingerprint, is_outside
from steerkit.diagram.diagnostics import in_one_line
from steerkit.diagram.loop import Sample
from steerkit.diagram.simulation import Log
from steerkit.learning import progress, rundir
from steerkit.learning.curve import Curve
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.learning.pictures import paper as figures
from steerkit.metrics import of_log
from steerkit.plots.style import save
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate
from steerkit.scenario.catalogue import CONTROLLERS

console = Console() if Console().is_terminal else Console(width=110)


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
    console.print(comparison(f"one round of {scenario.course}, {net}", logs))
    drive = rundir.drive_log(place, until=run.t)
    name = run.experiment.setting.name
    save(figures.learning(drive, title=f"{name} on {scenario.course}: from the first second"), place / "learning.png")
    title = f"{name} on {scenario.course}: final net"
    save(figures.round_driven(logs["learned"], logs["stanley"], title=title), place / "round.png")
    if not quiet:
        console.print(f"pictures: {place}/learning.png, {place}/round.png", soft_wrap=True)
    return merit | {"drives": [_row(name, log) for name, log in logs.items()]}


def _final_drive(place: FilePath, run: LearningRun) -> Log:
    """A test drive of the net that a run had when it was loaded, where it was learned."""
    scenario = run.experiment.scenario
    policy = rundir.final_policy(place, run.counts.updates)
    return evaluate.drive(scenario, policy, doe=run.experiment.setting.element(scenario.nominal))


def drive_and_draw(
    name: str,
    scenario: Scenario,
    place: FilePath,
    *,
    rounds: float | None,
    seed: int,
    quiet: bool = False,
    each: Each | None = None,
) -> dict[str, Any]:
    """A test drive of a named controller or of a run's final policy, with table, log and picture in `place`."""
    log = _driven(name, scenario, rounds=rounds, seed=seed, quiet=quiet, each=each)
    place.mkdir(parents=True, exist_ok=True)
    log.save(place / "drive.npz")
    save(figures.round_driven(log, title=f"{name} on {scenario.course}"), place / "drive.png")
    _note(place, described([name], scenario, rounds=rounds, seed=seed))
    console.print(comparison(f"{rounds or scenario.rounds:g} round(s) of {scenario.course}", {name: log}))
    if not quiet:
        if scenario.path().origin_deg:
            console.print(f"course: {scenario.path()!r}", soft_wrap=True)
        console.print(f"log and picture: {place}/drive.npz, {place}/drive.png", soft_wrap=True)
    return _row(name, log)


def drive_and_compare(
    names: Sequence[str], scenario: Scenario, place: FilePath, *, rounds: float | None, seed: int, quiet: bool = False
) -> list[dict[str, Any]]:
    """Test drives of several controllers under the same conditions: one table, one picture, and a log of each."""
    logs = {name: _driven(name, scenario, rounds=rounds, seed=seed, quiet=quiet) for name in names}
    place.mkdir(parents=True, exist_ok=True)
    files = {name: place / f"{file_name(name)}.npz" for name in names}
    require(len(set(files.values())) == len(files), "drive", f"two of {', '.join(names)} would have one log's name")
    for name, log in logs.items():
        log.save(files[name])
    save(figures.rounds_driven(logs, title=f"on {scenario.course}"), place / "drive.png")
    _note(place, described(names, scenario, rounds=rounds, seed=seed))
    console.print(comparison(f"{rounds or scenario.rounds:g} round(s) of {scenario.course}", logs))
    if not quiet:
        console.print(f"logs: {', '.join(map(str, files.values()))}; picture: {place}/drive.png", soft_wrap=True)
    return [_row(name, log) for name, log in logs.items()]


def file_name(name: str) -> str:
    """A controller's name, or that of a run's directory, as a part of a file's name."""
    return FilePath(name).name.replace(":", "-")


def _driven(
    name: str, scenario: Scenario, *, rounds: float | None, seed: int, quiet: bool, each: Each | None = None
) -> Log:
    run = FilePath(name)
    how: dict[str, Any] = {"rounds": rounds, "seed": seed, "progress": not quiet, "each": each}
    if name not in CONTROLLERS and run.is_dir():
        doe = rundir.experiment_of(run).setting.element(scenario.nominal)
        policy = rundir.final_policy(run)
        return evaluate.drive(scenario, policy, doe=doe, **how)
    steering = evaluate.controller(name, scenario)
    try:
        return evaluate.drive(scenario, steering, **how)
    except Exception as error:
        if not is_outside(name):
            raise
        raise ValueError(f"controller '{name}' failed: {in_one_line(error)}") from error


NOTE = "drive.json"
"""The file beside a drive's log that says what was driven."""


def described(names: Sequence[str], scenario: Scenario, *, rounds: float | None, seed: int) -> dict[str, Any]:
    """What tells one test drive from another: who drives, where and how; as JSON has it."""

    def version(name: str) -> Any:
        if is_outside(name):
            return fingerprint(name, "controller")
        own = name not in CONTROLLERS and FilePath(name).is_dir()
        return rundir.document(FilePath(name))["counts"]["updates"] if own else None

    told = {"controllers": {name: version(name) for name in names}, "scenario": asdict(scenario)}
    return dict(json.loads(json.dumps({**told, "rounds": rounds, "seed": seed}, default=str)))


def place_of_its_own(place: FilePath, what: dict[str, Any]) -> FilePath:
    """`place`, or `place`-2 and so on where that holds another drive: none is written over by a different one."""
    number = 1
    while True:
        chosen = place if number == 1 else place.with_name(f"{place.name}-{number}")
        note = chosen / NOTE
        if not chosen.exists() or (note.is_file() and json.loads(note.read_text(encoding="utf-8")) == what):
            return chosen
        number += 1


def _note(place: FilePath, what: dict[str, Any]) -> None:
    write_text(place / NOTE, json.dumps(what, indent=1))


def show_several(places: Sequence[FilePath]) -> list[dict[str, Any]]:
    """Print several runs as one table: what learning took, and a test drive of each one's final net."""
    rows = []
    columns: list[list[str]] = []
    for place in places:
        run = rundir.load(place)
        merit = figures_of_merit(run)
        row = _row(str(place), _final_drive(place, run))
        done = merit["first_round_done_s"]
        columns.append(
            [
                *(str(merit[key]) for key in ("setting", "course", "seed")),
                f"{merit['driving_minutes']:.1f}",
                *(str(merit[key]) for key in ("failures", "rounds", "updates")),
                "-" if done is None else f"{done:.0f}",
                "yes" if row["held"] else "no",
                *_cells((row["rms_e"], 3), (row["max_e"], 3), (row["rms_wheel_rate_deg"], 0)),
            ]
        )
        rows.append(merit | {"run": str(place), "drive": row})
    # a column a run: a row a run is wider than a terminal
    table = Table("", *(escape(str(place)) for place in places), title=f"{len(places)} runs")
    for column in table.columns[1:]:
        column.overflow = "fold"
    for head, *cells in zip(_OF_RUNS, *columns):
        table.add_row(escape(head), *map(escape, cells))
    console.print(table)
    return rows


_OF_RUNS = (
    "setting",
    "course",
    "seed",
    "driven [min]",
    "failures",
    "rounds",
    "updates",
    "first round [s]",
    "held",
    "RMS e [m]",
    "max e [m]",
    "wheel [deg/s]",
)


def _row(name: str, log: Log) -> dict[str, Any]:
    return {"controller": name, "held": evaluate.held_all_along(log), **asdict(of_log(log))}


def comparison(title: str, logs: dict[str, Log]) -> Table:
    """A table with one row a drive."""
    heads = (
        "controller",
        "held",
        "RMS e\n[m]",
        "max e\n[m]",
        "RMS wheel\nrate\n[deg/s]",
        "max a_y\n[m/s²]",
        "|e| <\n0.05 m\n[%]",
        "max jerk\n[m/s³]",
    )
    table = Table(*[escape(head) for head in heads], title=title)
    table.columns[0].overflow = "fold"
    for name, log in logs.items():
        s = of_log(log)
        held = "yes" if evaluate.held_all_along(log) else "no"
        table.add_row(
            name,
            held,
            *_cells(
                (s.rms_e, 3),
                (s.max_e, 3),
                (s.rms_wheel_rate_deg, 0),
                (s.max_a_y, 2),
                (100.0 * s.share_within_5cm, 1),
                (s.max_jerk, 1),
            ),
        )
    return table


def _cells(*values: Sequence[float]) -> list[str]:
    return [f"{value:.{int(digits)}f}" for value, digits in values]
