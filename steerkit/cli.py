"""The command line: one small file over the library."""

from __future__ import annotations

import json
import sys
import tomllib
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from steerkit.car_cli import app as car_app
from steerkit.export_cli import export

app = typer.Typer(
    help="Steer a car along a path: learn it, drive it, look at it. No car was ever driven with this software.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.add_typer(car_app, name="car")
app.command()(export)


class Conditions(StrEnum):
    """Named disturbances."""

    clean = "clean"
    hard = "hard"


Seed = Annotated[int, typer.Option(help="Seed of nets, driver and sensors.")]
Course = Annotated[str, typer.Option(help="Course to drive: see `steerkit courses`.")]
Disturbed = Annotated[Conditions, typer.Option(help="hard: 1 cm noise, 50 ms sensor delay, 0.15 s lag.")]
Machine = Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print results only, no progress.")]


_CONTROLLERS = (
    "stanley, stanley-textbook, stanley-delay, lqr, pure-pursuit, mpc, nonlinear-mpc, or a learning run's directory."
)


@app.command()
def learn(
    course: Course = "paper",
    setting: Annotated[str, typer.Option(help="How to learn: default, paper, bang-bang, ...")] = "default",
    conditions: Disturbed = Conditions.clean,
    seed: Seed = 0,
    minutes: Annotated[float, typer.Option(help="Driving time, recovery and waiting included [min].")] = 11.0,
    rounds: Annotated[int, typer.Option(help="End after so many complete rounds by the learner; 0: never.")] = 0,
    config: Annotated[Path | None, typer.Option(help="TOML file with an experiment; other options give way.")] = None,
    out: Annotated[Path | None, typer.Option(help="Run directory; an unfinished run there is resumed.")] = None,
    quiet: Quiet = False,
    as_json: Machine = False,
) -> None:
    """Let a car learn to steer a course from nothing, the recovery controller catching it."""
    from steerkit.learning import report, rundir
    from steerkit.learning.experiment import Experiment
    from steerkit.learning.settings import setting as named
    from steerkit.learning.world import World

    if config is None:
        world = World.under(conditions.value, course=course)
        experiment = Experiment(setting=named(setting), world=world, minutes=minutes, rounds=rounds, seed=seed)
    else:
        experiment = rundir.from_plain(_toml(config), str(config), Experiment)
    name = f"{experiment.setting.name}-{experiment.world.course}-{conditions.value}-seed{experiment.seed}"
    place = out or Path("runs") / name
    run = report.learn_with_progress(experiment, place, quiet=quiet)
    report.show(place, quiet=quiet)
    if as_json:
        print(json.dumps(report.figures_of_merit(run)))


@app.command()
def drive(
    controller: Annotated[str, typer.Argument(help=_CONTROLLERS)],
    course: Course = "paper",
    conditions: Disturbed = Conditions.clean,
    delay: Annotated[float, typer.Option(help="Steering delay [s].")] = 0.0,
    rounds: Annotated[float, typer.Option(help="Rounds to drive.")] = 1.0,
    seed: Seed = 0,
    out: Annotated[Path | None, typer.Option(help="Directory for the log and the picture.")] = None,
    quiet: Quiet = False,
    as_json: Machine = False,
) -> None:
    """Drive a course with any controller and report how well it did."""
    from dataclasses import replace

    from steerkit.learning import report
    from steerkit.learning.world import World

    world = replace(World.under(conditions.value, course=course), delay=delay)
    place = out or Path("runs") / f"drive-{Path(controller).name}-{course}-{conditions.value}-seed{seed}"
    row = report.drive_and_draw(controller, world, place, rounds=rounds, seed=seed, quiet=quiet)
    if as_json:
        print(json.dumps(row))


@app.command()
def show(
    run: Annotated[Path, typer.Argument(help="Directory of a learning run.")],
    diagnostics: Annotated[
        bool, typer.Option(help="Draw what the net believes, and where and when it failed.")
    ] = False,
    against: Annotated[list[Path] | None, typer.Option(help="Other runs to compare with (with --diagnostics).")] = None,
    quiet: Quiet = False,
) -> None:
    """Show a learning run: its counts, its episodes, learned against Stanley, and its pictures."""
    from steerkit.learning import report

    report.show(run, quiet=quiet)
    if diagnostics:
        from steerkit.learning.diagnostics import draw_all

        pictures = draw_all(run, against=against or ())
        report.console.print(f"diagnostics: {', '.join(map(str, pictures))}", soft_wrap=True)


@app.command()
def courses() -> None:
    """List the built-in courses."""
    from rich.console import Console
    from rich.table import Table

    from steerkit.courses import course, names

    table = Table("course", "length (m)", "closed", "tightest radius (m)")
    for name in names():
        path = course(name)
        sharpest = abs(path.samples.kappa).max()
        radius = f"{1 / sharpest:.1f}" if sharpest > 1e-6 else "straight"
        table.add_row(name, f"{path.length:.0f}", "yes" if path.closed else "no", radius)
    Console().print(table)


@app.command()
def demo(
    seed: Seed = 0,
    out: Annotated[Path, typer.Option(help="Where runs and pictures go.")] = Path("runs/demo"),
) -> None:
    """Learn on the 800 m course and on a real recorded lap; compare with Stanley; redraw the paper's figures."""
    from steerkit.learning import demo as story

    story.run(out, seed=seed)


def _toml(file: Path) -> dict[str, Any]:
    try:
        with file.open("rb") as stream:
            return tomllib.load(stream)
    except OSError as error:
        raise ValueError(f"--config {file}: cannot be read ({error.strerror})") from error
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"--config {file}: not TOML ({error})") from error


def main() -> None:
    """Run the command line; a mistake of the user's is one line on stderr and exit code 2."""
    try:
        app()
    except (ValueError, KeyError, OSError) as error:
        print(f"steerkit: {error.args[0] if isinstance(error, KeyError) else error}", file=sys.stderr)
        raise SystemExit(2) from None
