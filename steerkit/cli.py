"""The command line: one small file over the library."""

from __future__ import annotations

import json
import sys
import tomllib
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from steerkit import __version__
from steerkit.car_cli import app as car_app
from steerkit.identify_cli import identify

EPILOG = """
Examples

  steerkit courses                            what can be driven\n
  steerkit drive stanley --course genesis     a controller on a course\n
  steerkit learn --minutes 2 --out runs/mine  a car learns; the run is kept\n
  steerkit show runs/mine                     its story, and its pictures\n
  steerkit drive runs/mine -q --json          its figures, for a program\n

Exit codes: 0 done; 1 refused or failed on the way; 2 a mistake in what was asked, said in one line on stderr;
130 interrupted. NO_COLOR=1 leaves out colours. Completion for your shell: steerkit --install-completion.
"""
app = typer.Typer(
    help="Steer a car along a path: learn it, drive it, look at it. No car was ever driven with this software.",
    epilog=EPILOG,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.add_typer(car_app, name="car")
app.command()(identify)


class Conditions(StrEnum):
    """Named disturbances."""

    clean = "clean"
    hard = "hard"


Seed = Annotated[int, typer.Option(help="Seed of nets, driver and sensors.")]
Course = Annotated[str, typer.Option(help="Course to drive: see `steerkit courses`.")]
Disturbed = Annotated[Conditions, typer.Option(help="hard: 1 cm noise, 50 ms sensor delay, 0.15 s lag.")]
Machine = Annotated[bool, typer.Option("--json", help="Print one JSON object, and all that is for people on stderr.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print results only, no progress.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"steerkit {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[bool, typer.Option("--version", callback=_print_version, is_eager=True,
                                          help="Print the version and exit.")] = False,
) -> None:  # fmt: skip
    """What goes before the command."""


_CONTROLLERS = (
    "stanley, stanley-textbook, stanley-delay, lqr, pure-pursuit, mpc, nonlinear-mpc, or a learning run's directory."
)


@app.command()
def learn(
    course: Course = "paper",
    setting: Annotated[str, typer.Option(help="How to learn: default, paper, bang-bang, ...")] = "default",
    changes: Annotated[
        list[str] | None,
        typer.Option("--with", metavar="NAME=VALUE", help="Change the setting: fit.nets=3, after_failure=shift, ..."),
    ] = None,
    conditions: Disturbed = Conditions.clean,
    seed: Seed = 0,
    minutes: Annotated[float, typer.Option(help="Driving time, recovery and waiting included (min).")] = 11.0,
    rounds: Annotated[int, typer.Option(help="End after so many complete rounds by the learner; 0: never.")] = 0,
    config: Annotated[Path | None, typer.Option(help="TOML file with an experiment; other options give way.")] = None,
    out: Annotated[Path | None, typer.Option(help="Run directory; an unfinished run there is resumed.")] = None,
    quiet: Quiet = False,
    as_json: Machine = False,
) -> None:
    """Let a car learn to steer a course from nothing, the recovery controller catching it."""
    from steerkit.learning import report, rundir
    from steerkit.learning.experiment import Experiment
    from steerkit.learning.settings import changed
    from steerkit.learning.settings import setting as named
    from steerkit.learning.world import World

    if config is None:
        world = World.under(conditions.value, course=course)
        experiment = Experiment(setting=named(setting), world=world, minutes=minutes, rounds=rounds, seed=seed)
    else:
        experiment = rundir.from_plain(_toml(config), str(config), Experiment)
    experiment = replace(experiment, setting=changed(experiment.setting, changes or ()))
    how = "-".join((experiment.setting.name, *(changes or ())))
    name = f"{how}-{experiment.world.course}-{conditions.value}-seed{experiment.seed}"
    place = out or Path("runs") / name
    report.console.stderr = as_json
    try:
        run = report.learn_with_progress(experiment, place, quiet=quiet)
    except KeyboardInterrupt:
        print(f"steerkit: interrupted; the same with --out {place} goes on from the last training", file=sys.stderr)
        raise
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
    animate: Annotated[Path | None, typer.Option(help="Film of the drive to write: .gif, or .mp4 with ffmpeg.")] = None,
    quiet: Quiet = False,
    as_json: Machine = False,
) -> None:
    """Drive a course with any controller and report how well it did."""
    from dataclasses import replace

    from steerkit.learning import report
    from steerkit.learning.world import World

    world = replace(World.under(conditions.value, course=course), delay=delay)
    place = out or Path("runs") / f"drive-{Path(controller).name}-{course}-{conditions.value}-seed{seed}"
    report.console.stderr = as_json
    row = report.drive_and_draw(controller, world, place, rounds=rounds, seed=seed, quiet=quiet)
    if animate is not None:
        from steerkit.simulation import Log

        car, log = world.vehicle, Log.load(place / "drive.npz")
        log.animate(world.path(), animate, wheelbase=car.wheelbase, l_f=car.l_f, steer_ratio=car.steer_ratio,
                    progress=not quiet)  # fmt: skip
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
    as_json: Machine = False,
) -> None:
    """Show a learning run: its counts, its episodes, learned against Stanley, and its pictures."""
    from steerkit.learning import report

    report.console.stderr = as_json
    figures = report.show(run, quiet=quiet)
    if diagnostics:
        from steerkit.learning.diagnostics import draw_all

        pictures = draw_all(run, against=against or ())
        report.console.print(f"diagnostics: {', '.join(map(str, pictures))}", soft_wrap=True)
    if as_json:
        print(json.dumps(figures))


@app.command()
def courses(as_json: Machine = False) -> None:
    """List the built-in courses."""
    from rich.console import Console
    from rich.table import Table

    from steerkit.courses import course, names

    rows: list[dict[str, Any]] = []
    for name in names():
        path = course(name)
        sharpest = float(abs(path.samples.kappa).max())
        radius = 1.0 / sharpest if sharpest > 1e-6 else None
        rows.append({"course": name, "length_m": path.length, "closed": path.closed, "tightest_radius_m": radius})
    if as_json:
        print(json.dumps({"courses": rows}))
        return
    table = Table("course", "length (m)", "closed", "tightest radius (m)")
    for name, length, closed, radius in (row.values() for row in rows):
        table.add_row(name, f"{length:.0f}", "yes" if closed else "no", f"{radius:.1f}" if radius else "straight")
    Console().print(table)


@app.command()
def demo(
    seed: Seed = 0,
    out: Annotated[Path, typer.Option(help="Where runs and pictures go.")] = Path("runs/demo"),
    quiet: Quiet = False,
) -> None:
    """Learn on the 800 m course and on a real recorded lap; compare with Stanley; redraw the paper's figures."""
    from steerkit.learning import demo as story

    story.run(out, seed=seed, quiet=quiet)


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


if __name__ == "__main__":
    main()
