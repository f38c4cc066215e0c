"""The command `steerkit drive`: any controller drives, in simulation or a car."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from steerkit.cli.options import (
    ON_CAR,
    SIMULATED,
    Car,
    Channel,
    Conditions,
    Course,
    Disturbed,
    Machine,
    Quiet,
    Realtime,
    RecordTo,
    Recovery,
    Scale,
    ScenarioFile,
    Simulated,
    Socket,
    Vehicle,
    car_options,
    check_options,
    driven_on,
    scenario_of,
)

_CONTROLLERS = (
    "stanley, stanley-textbook, stanley-delay, lqr, pure-pursuit, mpc, nonlinear-mpc, nfq, a run's directory, "
    "or your own: my_file.py:make."
)


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
    delay: Annotated[float, typer.Option(help="Steering delay (s).", rich_help_panel=SIMULATED)] = 0.0,
    rounds: Annotated[
        float | None, typer.Option(help="Rounds to drive; default: the scenario's, 1.", rich_help_panel=SIMULATED)
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of human and sensors.", rich_help_panel=SIMULATED)] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Directory for the log and the picture.", rich_help_panel=SIMULATED)
    ] = None,
    animate: Annotated[
        Path | None,
        typer.Option(help="Film of the drive to write: .gif, or .mp4 with ffmpeg.", rich_help_panel=SIMULATED),
    ] = None,
    recovery: Recovery = "stanley",
    minutes: Annotated[float, typer.Option(help="How many minutes; 0: until `q`.", rich_help_panel=ON_CAR)] = 0.0,
    simulated: Simulated = False,
    socket: Socket = "",
    recording: RecordTo = "",
    channel: Channel = "",
    time_scale: Scale = 1.0,
    realtime: Realtime = False,
) -> None:
    """Drive with any controller: a course in simulation, or with --car FILE a car, armed and engaged by keys."""
    check_options(
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
        figures = car_session.drive(car_options(ctx), name, minutes=minutes)
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
    world = scenario_of(ctx)
    where = driven_on(world, conditions)
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
