"""The commands `steerkit drive` and `steerkit sweep`: any controller drives, in simulation or a car; or hundreds do."""

import itertools
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from steerkit._support.console import console
from steerkit._support.errors import in_one_line, require
from steerkit._support.files import write_rows
from steerkit._support.plugins import is_outside
from steerkit.car import loop as loops
from steerkit.car import session as car_session
from steerkit.cli import options as shared
from steerkit.compiled import TraceError
from steerkit.diagram.loop import Loop, Sample
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.plots.animation import film_writer
from steerkit.plots.drive import round_driven, rounds_driven
from steerkit.scenario import Scenario, lateral
from steerkit.scenario import drive as evaluate
from steerkit.scenario.catalogue import CONTROLLERS
from steerkit.scenario.drive import USUAL
from steerkit.scenario.drive import sweep as swept

_VALID = f"{', '.join(CONTROLLERS)}, nfq, the directory of a learning run, or your own: my_file.py:make"


@shared.drive_options
def drive(
    ctx: typer.Context,
    options: shared.DriveOptions,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="CONTROLLER...", show_default=False, help=f"{_VALID}.")
    ] = None,
    controller: Annotated[
        str, typer.Option(help="The same as an option; nfq: what `learn`, called alike, has learned.")
    ] = "",
    delay: Annotated[float, shared.in_simulation("Steering delay (s).")] = 0.0,
    rounds: Annotated[float | None, shared.in_simulation("Rounds to drive; default: the scenario's, 1.")] = None,
    out: Annotated[Path | None, shared.in_simulation("Directory for the log and the picture.")] = None,
    animate: Annotated[
        Path | None, shared.in_simulation("Film of the drive to write: .gif, or .mp4 with ffmpeg.")
    ] = None,
    stream: shared.Stream = "",
    target: Annotated[
        str,
        shared.in_simulation("A target of lateral acceleration instead of the course: drawn-7, lap, or a CSV file."),
    ] = "",
    minutes: Annotated[float, shared.on_car("How many minutes; 0: until `q`.")] = 0.0,
) -> None:
    """Drive with any controller: a course in simulation, or with --car FILE a car, armed and engaged by keys.

    Several controllers drive the same course under the same conditions: one table, one picture.
    """
    elsewhere = {"seed": "nothing is drawn by lot there", "out": "say --recording FILE"}
    shared.check_options(ctx, elsewhere)
    asked = list(names or ())
    if asked and controller and asked != [controller]:
        raise ValueError(f"two controllers, '{asked[0]}' and --controller {controller}; name one")
    asked = asked or [controller] * bool(controller)
    name = asked[0] if asked else ""
    if options.car:
        require(len(asked) < 2, "drive", f"{len(asked)} controllers ({', '.join(asked)}), expected one on a car")
        require(name, "drive", f"with which controller? valid: {loops.VALID}")
        figures = car_session.drive(shared.car_options(options, options.car), name, minutes=minutes)
        if options.as_json:
            print(json.dumps(figures))
        return
    require(name, "drive", f"with which controller? valid: {_VALID}")
    if animate is not None:
        film_writer(animate)
    folder = out is None or out.is_dir() or not out.exists()
    require(folder, f"--out {out}", "is a file, expected a directory for log and picture")
    require(not (stream and len(asked) > 1), f"--stream {stream}", "shows one controller; name one")
    scenario = shared.scenario_of(ctx)
    if target:
        of_courses = {"rounds", "animate", "stream"} | (set() if target == "lap" else {"course", "speed", "v_max"})
        idle = ", ".join(f"--{name.replace('_', '-')}" for name in sorted(shared.given(ctx) & of_courses))
        require(not idle, f"--target {target}", f"leave {idle} out: it is no course")
        console.stderr = options.as_json
        rows = _lateral(asked, scenario, target, out, options.seed)
        if options.as_json:
            print(json.dumps(rows[0] if len(asked) == 1 else {"drives": rows}))
        return
    where = shared.driven_on(scenario, options.conditions)
    asked = [_learned(where, options.seed) if one == "nfq" else one for one in asked]
    require(len(set(asked)) == len(asked), "drive", f"a controller stands twice in {', '.join(asked)}")
    who = "+".join(map(_file_name, asked))
    place = out or _place_of_its_own(Path("runs") / f"drive-{who}-{where}-seed{options.seed}")
    console.stderr = options.as_json
    require(len(asked) == 1 or animate is None, "--animate", "films one controller; name one")
    with shared.streamed(stream, in_time=True) as each:
        rows = driven(asked, scenario, place, rounds=rounds, seed=options.seed, quiet=options.quiet, each=each)
    if animate is not None:
        log = Log.load(place / "drive.npz")
        log.animate(scenario.path(), animate, vehicle=scenario.nominal, progress=not options.quiet)
    if options.as_json:
        print(json.dumps(rows[0] if len(asked) == 1 else {"drives": rows}))


def driven(
    names: Sequence[str],
    scenario: Scenario,
    place: Path,
    *,
    rounds: float | None,
    seed: int,
    quiet: bool = False,
    each: Callable[[Sample], None] | None = None,
) -> list[dict[str, Any]]:
    """Test drives of named controllers, or of runs' final policies: one table, one picture, a log of each in `place`.

    Returns a row for each, as `--json` prints it.
    """
    one = len(names) == 1
    files = {name: place / ("drive.npz" if one else f"{_file_name(name)}.npz") for name in names}
    require(len(set(files.values())) == len(files), "drive", f"two of {', '.join(names)} would have one log's name")
    logs = {name: _drive(name, scenario, rounds=rounds, seed=seed, progress=not quiet, each=each) for name in names}
    place.mkdir(parents=True, exist_ok=True)
    for name, log in logs.items():
        log.save(files[name])
    if one:
        picture = round_driven(logs[names[0]], title=f"{names[0]} on {scenario.course.name}")
    else:
        picture = rounds_driven(logs, title=f"on {scenario.course.name}")
    picture.savefig(place / "drive.png")
    console.print(evaluate.comparison(f"{rounds or scenario.course.rounds:g} round(s) of {scenario.course.name}", logs))
    if not quiet:
        if one and scenario.path().origin_deg:
            console.print(f"course: {scenario.path()!r}", soft_wrap=True)
        kept = ", ".join(map(str, files.values()))
        console.print(f"{'log' if one else 'logs'}: {kept}; picture: {place}/drive.png", soft_wrap=True)
    return [evaluate.row_of(name, log) for name, log in logs.items()]


def _lateral(
    names: Sequence[str], scenario: Scenario, target: str, out: Path | None, seed: int
) -> list[dict[str, Any]]:
    """Drives after a target: a table of their costs, and a log of each in `out`."""
    aim, rows = lateral.LateralTarget.read(target, scenario), list[dict[str, Any]]()
    for name in names:
        log = lateral.lateral_drive(scenario, aim, lateral.lateral_controller(name, scenario), seed=seed)
        rows.append({"controller": name, **lateral.lateral_cost_of(log)})
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            log.save(out / f"{_file_name(name)}.npz")
    table = Table(*rows[0], title=f"target {target}, {aim.seconds:g} s")
    for row in rows:
        table.add_row(*[value if isinstance(value, str) else f"{value:.2f}" for value in row.values()])
    console.print(table)
    return rows


def _drive(name: str, scenario: Scenario, **how: Any) -> Log:
    if name not in CONTROLLERS and Path(name).is_dir():  # a run
        doe = rundir.experiment_of(Path(name)).setting.element(scenario.nominal)
        return evaluate.drive(scenario, rundir.final_policy(Path(name)), doe=doe, **how)
    steering = evaluate.controller(name, scenario)
    try:
        return evaluate.drive(scenario, steering, **how)
    except Exception as error:
        if not is_outside(name):
            raise
        raise ValueError(f"controller '{name}' failed: {in_one_line(error, foreign=True)}") from error


def _file_name(name: str) -> str:
    """A controller's name, or that of a run's directory, as a part of a file's name."""
    return Path(name).name.replace(":", "-")


def _place_of_its_own(place: Path) -> Path:
    """`place`, or `place`-2 and so on where that is there: no drive is written over."""
    others = (place.with_name(f"{place.name}-{number}") for number in itertools.count(2))
    return next(free for free in itertools.chain([place], others) if not free.exists())


def _learned(where: str, seed: int) -> str:
    """The directory of the run that `learn`, called with the same options, makes."""
    place = Path("runs") / f"default-{where}-seed{seed}"
    if not place.is_dir():
        raise ValueError(f"drive nfq: there is no {place}; `steerkit learn` with the same options makes it")
    return str(place)


_SET = "NAME=LOW:HIGH:COUNT, NAME=LOW:HIGH:COUNT:log (evenly spaced in log) or NAME=VALUE,VALUE,..."


@shared.drive_options
def sweep(
    ctx: typer.Context,
    options: shared.SceneOptions,
    controller: Annotated[str, typer.Argument(help="As for `steerkit drive`; or your own: my_file.py:make.")],
    parameters: Annotated[
        list[str],
        typer.Option("--set", help=f"{_SET}: a field of the controller, or of a block: car.vehicle.m. Repeatable."),
    ],
    metrics: Annotated[list[str], typer.Option("--metric", help="Metric of docs/metrics.md; repeatable.")] = [*USUAL],  # noqa: B006 (typer copies it)
    delay: Annotated[float, shared.in_simulation("Steering delay (s).")] = 0.0,
    seconds: Annotated[float, typer.Option(help="How long each car drives (s); 0: as long as its course takes.")] = 0.0,
    out: Annotated[
        Path | None, typer.Option(help="Directory for sweep.csv and sweep.png; default: under runs/.")
    ] = None,
) -> None:
    """Drive with hundreds of values of a controller's or a car's parameters at once: a table and a picture.

    Several --set make a grid. All drives are compiled into one program and have the same driver, noise and gusts.
    """
    require(out is None or out.is_dir() or not out.exists(), f"--out {out}", "is a file, expected a directory")
    scenario = shared.scenario_of(ctx)
    loop = evaluate.drive_loop(scenario, evaluate.controller(controller, scenario), seed=options.seed)
    values = dict(_values(text, loop) for text in parameters)
    require(len(values) == len(parameters), "--set", f"a name stands twice in {', '.join(parameters)}")
    console.stderr = options.as_json
    try:
        lasts, show = seconds or scenario.seconds, not options.quiet
        found = swept(loop, values, lasts, metrics, distance=scenario.length, progress=show)
    except TraceError as error:
        raise ValueError(f"sweep {controller}: {error}") from error
    best = {metric: found.best(metric) for metric in metrics if np.isfinite(found[metric]).any()}
    default = f"sweep-{Path(controller).name.replace(':', '-')}-{shared.driven_on(scenario, options.conditions)}"
    place = out or Path("runs") / f"{default}-seed{options.seed}"
    place.mkdir(parents=True, exist_ok=True)
    write_rows(place / "sweep.csv", found.columns, list(found.columns.values()))
    kept = f"{math.prod(map(len, found.values.values()))} drives: {place}/sweep.csv"
    if len(values) <= 2:
        found.plot().savefig(place / "sweep.png")
        kept += f"; picture: {place}/sweep.png"
    shown = Table("best", *found.columns, title=f"{controller} on {scenario.course.name}")
    for metric, row in best.items():
        shown.add_row(metric, *(f"{value:.4g}" for value in row.values()))
    console.print(shown)
    if not options.quiet:
        console.print(kept, soft_wrap=True, markup=False)
    if options.as_json:
        columns = {name: [*map(_plain, column.tolist())] for name, column in found.columns.items()}
        rows = {metric: {name: _plain(x) for name, x in row.items()} for metric, row in best.items()}
        print(json.dumps({"controller": controller, "best": rows, "columns": columns}, allow_nan=False))


def _plain(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _values(text: str, loop: Loop) -> tuple[str, Any]:
    """What one --set says: the field's whole name, and its values."""
    name, equals, numbers = text.partition("=")
    words = numbers.split(":")
    try:
        if len(words) == 1:
            values: Any = [float(word) for word in numbers.split(",")]
        elif len(words) == 4 and words[3] == "log":
            values = np.geomspace(float(words[0]), float(words[1]), int(words[2]))
        else:
            low, high, count = words
            values = np.linspace(float(low), float(high), int(count))
        require(equals and name and len(values) and np.isfinite(values).all(), "", "")
    except ValueError:
        raise ValueError(f"--set {text}: expected {_SET}") from None
    field = name.partition(".")[0]
    if field not in loop.names:  # one of the controller, or of the one that it wraps
        inside, block = ["controller"], loop.blocks["controller"]
        while field not in block.__dataclass_fields__ and hasattr(block, "block"):
            inside, block = [*inside, "block"], block.block
        name = ".".join([*(inside if field in block.__dataclass_fields__ else inside[:1]), name])
    return name, values
