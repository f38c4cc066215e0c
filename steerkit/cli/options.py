"""Options that commands share, and what they mean together: a scenario, or a session on a car."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from steerkit.scenario import Scenario


class Conditions(StrEnum):
    """Named disturbances."""

    clean = "clean"
    hard = "hard"
    real = "real"


SIMULATED, ON_CAR = "In simulation (without --car)", "On a car (with --car)"
Seed = Annotated[int, typer.Option(help="Seed of nets, human and sensors.")]
Course = Annotated[
    str, typer.Option(help="Course: a name of `steerkit courses`, random-7, or a CSV file.", rich_help_panel=SIMULATED)
]
Vehicle = Annotated[
    str,
    typer.Option(
        help="Car: a name of `steerkit vehicles`, fleet-17, or a vehicle file (its [steering] is then the motor).",
        rich_help_panel=SIMULATED,
    ),
]
ScenarioFile = Annotated[
    Path | None,
    typer.Option(
        "--scenario", help="TOML file of a scenario; options given besides change it.", rich_help_panel=SIMULATED
    ),
]
Disturbed = Annotated[
    Conditions,
    typer.Option(
        help="hard: 1 cm noise, 50 ms sensor delay, 0.15 s lag; real: and noisy v, no sideslip, lost samples.",
        rich_help_panel=SIMULATED,
    ),
]
Machine = Annotated[bool, typer.Option("--json", help="Print one JSON object, and all that is for people on stderr.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print results only, no progress.")]
Car = Annotated[
    str,
    typer.Option(
        "--car", help="TOML file of a car on a CAN bus, or a shipped one: dbw-kit.toml; read docs/real-car.md first."
    ),
]
Recovery = Annotated[str, typer.Option(help="Who catches a learner: stanley, stanley-delay.", rich_help_panel=ON_CAR)]
Simulated = Annotated[
    bool, typer.Option("--simulated", help="A simulated car on a bus, started for it.", rich_help_panel=ON_CAR)
]
Socket = Annotated[str, typer.Option(help="Unix socket of the car server.", rich_help_panel=ON_CAR)]
RecordTo = Annotated[str, typer.Option(help="MCAP file to record to; default: under runs/.", rich_help_panel=ON_CAR)]
Channel = Annotated[
    str,
    typer.Option(
        help="slcan device or socket://, or INTERFACE:CHANNEL, instead of the file's bus.", rich_help_panel=ON_CAR
    ),
]
Scale = Annotated[
    float, typer.Option(help="How many times faster than real time; simulated cars only.", rich_help_panel=ON_CAR)
]
Realtime = Annotated[
    bool, typer.Option("--realtime", help="Run under SCHED_FIFO, if the system lets us.", rich_help_panel=ON_CAR)
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


def scenario_of(ctx: typer.Context) -> Scenario:
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


def driven_on(scenario: Scenario, conditions: Conditions) -> str:
    """Course and conditions as a part of a directory's name."""
    return f"{scenario.course.removesuffix('.csv')}-{conditions.value}"


def check_options(
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


def car_options(ctx: typer.Context) -> Any:
    """The options of a session on a car, `steerkit.on_car.session.Options`."""
    from steerkit.on_car.session import Options

    p = ctx.params
    return Options(config=p["car"], **{n: p[n] for n in (*_ON_A_CAR_ONLY, "quiet")})
