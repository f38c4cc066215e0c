"""Options that commands share, and what they mean together: a scenario, a session on a car; and their reports."""

import contextlib
import functools
import inspect
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from steerkit._support.console import console
from steerkit._support.errors import known, require
from steerkit._support.files import read_text, write_text
from steerkit.cli import WORDS
from steerkit.plots.page import document, html, picture
from steerkit.scenario import CONDITIONS, Scenario, read_scenario
from steerkit.scenario.parts import Driver, profile_in

SIMULATED, ON_CAR, FROM_LOG = "In simulation", "On a car", "From a log (with --from)"
Seed = Annotated[int, typer.Option(help="Seed of driver and sensors, and of a learner's nets.")]
Machine = Annotated[bool, typer.Option("--json", help="Print one JSON object, and all that is for people on stderr.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print results only, no progress.")]

Stream = Annotated[
    str,
    typer.Option(
        metavar="[HOST:]PORT",
        help="Show it live in Foxglove: a read-only WebSocket, on the loopback unless a host is named.",
        rich_help_panel=SIMULATED,
    ),
]


def _only(panel: str) -> Callable[..., Any]:
    """Makes options that have a use there only: by their help, and their names if the variable's does not serve."""
    return lambda text, *names: typer.Option(*names, help=text, rich_help_panel=panel)


in_simulation, on_car, from_a_log = map(_only, (SIMULATED, ON_CAR, FROM_LOG))


def written(text: str, *endings: str) -> Any:
    """An option with the name of a file to write; one that ends otherwise is refused before anything is done."""
    valid = ", ".join(endings)

    def check(option: typer.CallbackParam, file: Path | None) -> Path | None:
        ok = file is None or file.suffix in endings
        require(ok, f"{option.opts[0]} {file}", f"expected a name that ends in {valid}")
        return file

    return typer.Option(help=f"{text} ({valid}).", callback=check)


Picture = Annotated[Path | None, written("Picture to write", ".png", ".pdf", ".svg")]
Report = Annotated[Path | None, written("All of it as one page to hand on", ".html")]


@dataclass(frozen=True)
class SceneOptions:
    """The options of all commands in which a simulated car drives: car, course, what disturbs it, what is printed.

    A command gets them by one parameter of this type, under `drive_options`.
    """

    seed: Seed = 0
    quiet: Quiet = False
    as_json: Machine = False
    course: Annotated[
        str, in_simulation("Course: a name of `steerkit courses`, random-7, a CSV file, or of a map: town.xodr#road=1.")
    ] = "paper"
    vehicle: Annotated[
        str, in_simulation("Car: of `steerkit vehicles`, fleet-17, or a vehicle file (the motor: its `steering`).")
    ] = "vw-passat"
    conditions: Annotated[
        str, in_simulation("clean; hard: 1 cm noise, 50 ms delay, 0.15 s lag; real: noisy v, no sideslip, losses too.")
    ] = "clean"
    estimator: Annotated[
        str, in_simulation("Between sensors and controllers: none, vehicle-state (a filter), adaptive-state (adapts).")
    ] = "none"
    speed: Annotated[
        str, in_simulation("A steady speed (m/s), `wander`, `recorded`, `limit`, or a CSV file of s (m) and v (m/s).")
    ] = "wander"
    v_max: Annotated[float, in_simulation("The driver's fastest speed (m/s).")] = 7.5
    scenario_file: Annotated[
        Path | None, in_simulation("TOML file of a scenario; options given besides change it.", "--scenario")
    ] = None


@dataclass(frozen=True)
class BusOptions:
    """What the process that owns a car's bus needs."""

    socket: Annotated[str, on_car("Unix socket of the car server.")] = ""
    recording: Annotated[str, on_car("MCAP file to record to; a drive's default: under runs/.")] = ""
    channel: Annotated[
        str, on_car("slcan device or socket://, or INTERFACE:CHANNEL of python-can, instead of the file's bus.")
    ] = ""
    time_scale: Annotated[float, on_car("How many times faster than real time; simulated cars only.")] = 1.0
    realtime: Annotated[bool, on_car("Run under SCHED_FIFO, if the system lets us.", "--realtime")] = False


@dataclass(frozen=True)
class CarOptions(BusOptions):
    """What a session on a car needs."""

    quiet: Quiet = False
    as_json: Machine = False
    simulated: Annotated[bool, on_car("A simulated car on a bus, started for it.", "--simulated")] = False


@dataclass(frozen=True)
class DriveOptions(CarOptions, SceneOptions):
    """The options of a drive, in simulation or on a car."""

    car: Annotated[
        str, typer.Option(help="TOML file of a car on a CAN bus, or a shipped one: dbw-kit.toml; see docs/real-car.md.")
    ] = ""
    recovery: Annotated[str, on_car("Of a learner: stanley, stanley-delay, adaptive, or auto.")] = "auto"


def drive_options(command: Callable[..., None]) -> Callable[..., None]:
    """Put the fields of one of these classes on the command line, where `command` has a parameter of it.

    typer reads a command's options off its signature, so the signature is written here: each field stands in it as a
    parameter of its own, in place of the one that gets them all.
    """
    own = inspect.signature(command).parameters
    (receiver,) = (p.name for p in own.values() if is_dataclass(p.annotation))
    kind = own[receiver].annotation
    shared = inspect.signature(kind).parameters

    @functools.wraps(command)
    def wrapper(**values: Any) -> None:
        options = kind(**{name: values.pop(name) for name in shared})
        command(**values, **{receiver: options})

    parameters = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for p in own.values()
        for parameter in (shared.values() if p.name == receiver else (p,))
    ]
    wrapper.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    wrapper.__annotations__ = {p.name: p.annotation for p in parameters}
    return wrapper


def given(ctx: typer.Context) -> set[str]:
    """The parameters that stand on the command line."""
    sources = {name: ctx.get_parameter_source(name) for name in ctx.params}
    return {name for name, source in sources.items() if source is not None and source.name == "COMMANDLINE"}


def scenario_of(ctx: typer.Context, base: Scenario | None = None) -> Scenario:
    """The scenario that the options describe: that of the file, if one is named, changed by what is given besides.

    base: the scenario to change instead, such as that of a run.
    """
    names, options = given(ctx), ctx.params
    changes: dict[str, Any] = {n: {"name": options[n]} for n in ("course", "vehicle") if n in names}
    if "delay" in names:
        changes["steering"] = {"delay": options["delay"]}
    if "estimator" in names:
        changes["sensors"] = {"estimator": options["estimator"]}
    if options["scenario_file"] is not None:
        base = read_scenario(options["scenario_file"])
    if names & {"speed", "v_max"}:
        changes["driver"] = _speeds(options["speed"], options["v_max"] if "v_max" in names else None, base)
    if base is None:
        return Scenario.under(options["conditions"], **changes)
    if "conditions" in names:
        base = base.with_(sensors=_UNDISTURBED).with_(
            **CONDITIONS[known(options["conditions"], CONDITIONS, "conditions")]
        )
    if "vehicle" in names:  # its file's [steering] comes with it
        base = base.with_(vehicle=changes["vehicle"])
        base = base.with_(steering=base.vehicle.steering_in_file())
    return base.with_(**changes)


_UNDISTURBED = {"noise": 0.0, "latency": 0.0, "kind": "hard"}


def _speeds(speed: str, v_max: float | None, base: Scenario | None) -> dict[str, Any]:
    """The fields of a scenario's driver that --speed and --v-max mean."""
    driver = Driver() if base is None else base.driver
    try:
        steady = float(speed)
    except ValueError:
        fields: dict[str, Any] = {"speed": speed}
        if speed.lower().endswith(".csv"):
            _, v = profile_in(read_text(speed, "speed", latin=True), speed)
            fields |= {"v_min": min(driver.v_min, float(v.min())), "v_max": max(driver.v_max, float(v.max()))}
        if v_max is not None:
            fields |= {"v_max": v_max, "v_min": min(fields.get("v_min", driver.v_min), v_max)}
        return fields
    require(v_max is None, f"--speed {speed}", "a steady speed; leave --v-max out")
    return {"speed": "wander", "v_min": steady, "v_max": steady}


def driven_on(scenario: Scenario, conditions: str) -> str:
    """Course and conditions as a part of a directory's name."""
    return f"{scenario.course.name.removesuffix('.csv')}-{conditions}"


@contextlib.contextmanager
def streamed(where: str, *, in_time: bool = False, signals: Sequence[str] | None = None) -> Iterator[Any]:
    """What shows each sample live at `[HOST:]PORT`; None for "". in_time: no faster than in reality."""
    if not where:
        yield None
        return
    from steerkit.logs.foxglove import Server, paced  # here, as it loads SciPy

    server = Server(where)
    console.print(f"live in Foxglove: open a connection to {server.address}", soft_wrap=True)

    each = functools.partial(server.sample, signals=signals)
    try:
        yield paced(each) if in_time else each
    finally:
        server.end()


def check_options(ctx: typer.Context, not_on_a_car: Mapping[str, str] = {}) -> None:
    """Refuse options of the simulation on a car, and those of a car or a log without one, saying what to do."""
    names, car, source = given(ctx), ctx.params["car"], ctx.params.get("source")
    for parameter in ctx.command.params:
        if parameter.name not in names:
            continue
        option, panel = parameter.opts[0], getattr(parameter, "rich_help_panel", None)
        instead = {**WORDS["not_on_a_car"], **not_on_a_car}.get(parameter.name)
        if car and instead:
            raise ValueError(f"{option} is for simulations: {instead}; leave it out, or leave out --car")
        if panel == ON_CAR and not car:
            raise ValueError(f"{option} is for a car; name its file: --car dbw-kit.toml, or leave {option} out")
        if panel == FROM_LOG and not source:
            raise ValueError(f"{option} is for a recorded drive; name it: --from FILE, or leave {option} out")


def car_options(options: CarOptions, config: str) -> Any:
    """What a session on the car of that file is given."""
    from steerkit.car.session import Options  # here, as it loads the learner

    shared = {f.name for f in fields(Options)} & vars(options).keys()
    return Options(config=config, **{name: getattr(options, name) for name in shared})


def write_page(file: Path, console: Any, title: str, verdict: Iterable[str], figures: Iterable[Any]) -> None:
    """Write the report of a command.

    console: a `rich.console.Console(record=True)` to which it printed. verdict: sentences. figures: of matplotlib.
    """
    sentences = "".join(f"<li>{html(sentence)}</li>" for sentence in verdict)
    pictures = "\n".join(picture(figure, alt=title) for figure in figures)
    printed = console.export_html(inline_styles=True, code_format="{code}")
    page = document(
        title,
        f"<h1>{html(title)}</h1>\n<ul>{sentences}</ul>\n{pictures}\n<pre>{printed}</pre>",
        command=shlex.join(["steerkit", *sys.argv[1:]]),
        closing="Simulated or computed from the recording; no car was driven.",
    )
    write_text(file, page)
