"""The command line: one small file over the library."""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from steerkit import __version__
from steerkit.cli.bench import app as bench_app
from steerkit.cli.car import app as car_app
from steerkit.cli.export import export
from steerkit.cli.identify import identify

if TYPE_CHECKING:
    from steerkit.scenario import Scenario

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
app.add_typer(bench_app, name="bench")
app.command()(identify)
app.command()(export)


class Conditions(StrEnum):
    """Named disturbances."""

    clean = "clean"
    hard = "hard"


_SIMULATED, _CAR = "In simulation (without --car)", "On a car (with --car)"
Seed = Annotated[int, typer.Option(help="Seed of nets, human and sensors.")]
Course = Annotated[
    str, typer.Option(help="Course: a name of `steerkit courses`, random-7, or a CSV file.", rich_help_panel=_SIMULATED)
]
Vehicle = Annotated[
    str,
    typer.Option(help="Car: a name, or a vehicle file (its [steering] is then the motor).", rich_help_panel=_SIMULATED),
]
ScenarioFile = Annotated[
    Path | None,
    typer.Option(
        "--scenario", help="TOML file of a scenario; options given besides change it.", rich_help_panel=_SIMULATED
    ),
]
Disturbed = Annotated[
    Conditions, typer.Option(help="hard: 1 cm noise, 50 ms sensor delay, 0.15 s lag.", rich_help_panel=_SIMULATED)
]
Machine = Annotated[bool, typer.Option("--json", help="Print one JSON object, and all that is for people on stderr.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print results only, no progress.")]
Car = Annotated[
    str,
    typer.Option(
        "--car", help="TOML file of a car on a CAN bus, or a shipped one: dbw-kit.toml; read docs/real-car.md first."
    ),
]
Recovery = Annotated[str, typer.Option(help="Who catches a learner: stanley, stanley-delay.", rich_help_panel=_CAR)]
Simulated = Annotated[
    bool, typer.Option("--simulated", help="A simulated car on a bus, started for it.", rich_help_panel=_CAR)
]
Socket = Annotated[str, typer.Option(help="Unix socket of the driver process.", rich_help_panel=_CAR)]
RecordTo = Annotated[str, typer.Option(help="MCAP file to record to; default: under runs/.", rich_help_panel=_CAR)]
Channel = Annotated[
    str,
    typer.Option(
        help="slcan device or socket://, or INTERFACE:CHANNEL, instead of the file's bus.", rich_help_panel=_CAR
    ),
]
Scale = Annotated[
    float, typer.Option(help="How many times faster than real time; simulated cars only.", rich_help_panel=_CAR)
]
Realtime = Annotated[
    bool, typer.Option("--realtime", help="Run under SCHED_FIFO, if the system lets us.", rich_help_panel=_CAR)
]

_NOT_ON_A_CAR = {
    "course": "the car's file names the course, under [course]",
    "vehicle": "the car's file names it, under [vehicle]",
    "scenario_file": "the car's file says where and with what",
    "conditions": "a car brings its own noise and delays",
    "delay": "the car's file tells it, under [kit]",
    "rounds": "say --minutes, or end with `q`",
    "config": "an experiment is a simulation; choose --setting",
}
"""Options of the simulation, and what a car has instead."""
_ON_A_CAR_ONLY = ("recovery", "simulated", "socket", "recording", "channel", "time_scale", "realtime")


_CONTROLLERS = (
    "stanley, stanley-textbook, stanley-delay, lqr, pure-pursuit, mpc, nonlinear-mpc, nfq, a run's directory, "
    "or your own: my_file.py:make."
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"steerkit {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """What goes before the command."""


@app.command()
def learn(
    ctx: typer.Context,
    car: Car = "",
    setting: Annotated[str, typer.Option(help="How to learn: default, paper, bang-bang, ...")] = "default",
    changes: Annotated[
        list[str] | None,
        typer.Option("--with", metavar="NAME=VALUE", help="Change the setting: fit.nets=3, after_failure=shift, ..."),
    ] = None,
    seed: Seed = 0,
    minutes: Annotated[
        float | None,
        typer.Option(help="Minutes of driving, recovery and waiting included; default: 11, on a car until `q`."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Run directory; an unfinished run there is resumed. On a car: runs/car.")
    ] = None,
    quiet: Quiet = False,
    as_json: Machine = False,
    course: Course = "paper",
    vehicle: Vehicle = "vw-passat",
    conditions: Disturbed = Conditions.clean,
    scenario_file: ScenarioFile = None,
    rounds: Annotated[
        int,
        typer.Option(help="End after so many complete rounds by the learner; 0: never.", rich_help_panel=_SIMULATED),
    ] = 0,
    config: Annotated[
        Path | None,
        typer.Option(help="TOML file with an experiment; other options give way.", rich_help_panel=_SIMULATED),
    ] = None,
    recovery: Recovery = "stanley",
    simulated: Simulated = False,
    socket: Socket = "",
    recording: RecordTo = "",
    channel: Channel = "",
    time_scale: Scale = 1.0,
    realtime: Realtime = False,
) -> None:
    """Let a car learn to steer a course from nothing, the recovery controller catching it."""
    from steerkit.learning.settings import changed
    from steerkit.learning.settings import setting as named

    _check_options(ctx, car)
    if car:
        from steerkit.on_car import loop as loops
        from steerkit.on_car import session as car_session

        options = _car_options(ctx)
        place = out or loops.LEARNED
        how = changed(named(setting), changes or ())
        figures = car_session.learn(options, how, place, minutes=minutes or 0.0, seed=seed)
        if as_json:
            print(json.dumps(figures))
        return
    from steerkit.learning import report, rundir
    from steerkit.learning.experiment import Experiment

    if config is None:
        world = _scenario(ctx)
        time = 11.0 if minutes is None else minutes
        experiment = Experiment(setting=named(setting), world=world, minutes=time, rounds=rounds, seed=seed)
    else:
        experiment = rundir.from_plain(_toml(config), str(config), Experiment)
    experiment = replace(experiment, setting=changed(experiment.setting, changes or ()))
    name = "-".join((experiment.setting.name, *(changes or ())))
    place = out or Path("runs") / f"{name}-{_driven_on(experiment.world, conditions)}-seed{experiment.seed}"
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
    ctx: typer.Context,
    name: Annotated[str, typer.Argument(metavar="CONTROLLER", show_default=False, help=_CONTROLLERS)] = "",
    controller: Annotated[
        str, typer.Option(help="The same as an option; nfq: what `learn`, called alike, has learned.")
    ] = "",
    car: Car = "",
    quiet: Quiet = False,
    as_json: Machine = False,
    course: Course = "paper",
    vehicle: Vehicle = "vw-passat",
    conditions: Disturbed = Conditions.clean,
    scenario_file: ScenarioFile = None,
    delay: Annotated[float, typer.Option(help="Steering delay (s).", rich_help_panel=_SIMULATED)] = 0.0,
    rounds: Annotated[
        float | None, typer.Option(help="Rounds to drive; default: the scenario's, 1.", rich_help_panel=_SIMULATED)
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of human and sensors.", rich_help_panel=_SIMULATED)] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Directory for the log and the picture.", rich_help_panel=_SIMULATED)
    ] = None,
    animate: Annotated[
        Path | None,
        typer.Option(help="Film of the drive to write: .gif, or .mp4 with ffmpeg.", rich_help_panel=_SIMULATED),
    ] = None,
    recovery: Recovery = "stanley",
    minutes: Annotated[float, typer.Option(help="How many minutes; 0: until `q`.", rich_help_panel=_CAR)] = 0.0,
    simulated: Simulated = False,
    socket: Socket = "",
    recording: RecordTo = "",
    channel: Channel = "",
    time_scale: Scale = 1.0,
    realtime: Realtime = False,
) -> None:
    """Drive with any controller: a course in simulation, or with --car FILE a car, armed and engaged by keys."""
    _check_options(
        ctx,
        car,
        not_on_a_car={
            "seed": "nothing is drawn by lot there",
            "out": "say --recording FILE",
            "animate": "a recording holds the drive",
            "delay": "a car brings its own",
        },
        on_a_car_only=("minutes",),
    )
    if name and controller and name != controller:
        raise ValueError(f"two controllers, '{name}' and --controller {controller}; name one")
    name = name or controller
    if car:
        from steerkit.on_car import loop as loops
        from steerkit.on_car import session as car_session

        if not name:
            raise ValueError(f"drive: with which controller? valid: {loops.VALID}")
        figures = car_session.drive(_car_options(ctx), name, minutes=minutes)
        if as_json:
            print(json.dumps(figures))
        return
    from steerkit.catalogue import CONTROLLERS
    from steerkit.learning import report
    from steerkit.simulation import Log

    if not name:
        valid = ", ".join(CONTROLLERS)
        own = "the directory of a learning run, my_file.py:make"
        raise ValueError(f"drive: with which controller? valid: {valid}, nfq, {own}")
    world = _scenario(ctx)
    where = _driven_on(world, conditions)
    if name == "nfq":
        name = str(Path("runs") / f"default-{where}-seed{seed}")
        if not Path(name).is_dir():
            raise ValueError(f"drive nfq: there is no {name}; `steerkit learn` with the same options makes it")
    place = out or Path("runs") / f"drive-{Path(name).name.replace(':', '-')}-{where}-seed{seed}"
    report.console.stderr = as_json
    row = report.drive_and_draw(name, world, place, rounds=rounds, seed=seed, quiet=quiet)
    if animate is not None:
        p, log = world.nominal, Log.load(place / "drive.npz")
        log.animate(
            world.path(), animate, wheelbase=p.wheelbase, l_f=p.l_f, steer_ratio=p.steer_ratio, progress=not quiet
        )
    if as_json:
        print(json.dumps(row))


def _scenario(ctx: typer.Context) -> Scenario:
    """The scenario that the options describe: that of the file, if one is named, changed by what is given besides."""
    from steerkit.scenario import CONDITIONS, Scenario
    from steerkit.scenario.file import read_scenario

    sources = {name: ctx.get_parameter_source(name) for name in ("course", "vehicle", "delay", "conditions")}
    given = [name for name, source in sources.items() if source is not None and source.name == "COMMANDLINE"]
    changes = {name: ctx.params[name] for name in given if name != "conditions"}
    if ctx.params["scenario_file"] is None:
        return Scenario.under(ctx.params["conditions"].value, **changes)
    if "conditions" in given:
        changes |= CONDITIONS[ctx.params["conditions"].value]
    return replace(read_scenario(ctx.params["scenario_file"]), **changes)


def _driven_on(scenario: Scenario, conditions: Conditions) -> str:
    """Course and conditions as a part of a directory's name."""
    return f"{scenario.course.removesuffix('.csv')}-{conditions.value}"


def _check_options(
    ctx: typer.Context,
    car: str,
    *,
    not_on_a_car: Mapping[str, str] = MappingProxyType({}),
    on_a_car_only: Sequence[str] = (),
) -> None:
    """Refuse options of the simulation on a car, and the other way round, saying what there is instead."""
    for name in ctx.params:
        source = ctx.get_parameter_source(name)
        if source is None or source.name != "COMMANDLINE":
            continue
        option = f"--{name.removesuffix('_file').replace('_', '-')}"
        instead = {**_NOT_ON_A_CAR, **not_on_a_car}.get(name)
        if car and instead:
            raise ValueError(f"{option} is for simulations: {instead}; leave it out, or leave out --car")
        if not car and name in (*_ON_A_CAR_ONLY, *on_a_car_only):
            raise ValueError(f"{option} is for a car; name its file: --car dbw-kit.toml, or leave {option} out")


def _car_options(ctx: typer.Context) -> Any:
    from steerkit.on_car.session import Options

    p = ctx.params
    return Options(config=p["car"], **{n: p[n] for n in (*_ON_A_CAR_ONLY, "quiet")})


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
        from steerkit.learning.pictures.run import draw_all

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
    from steerkit.cli import demo as story

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
