"""The command `steerkit drive`: any controller drives, in simulation or a car."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from steerkit.cli.options import (
    DriveOptions,
    Stream,
    car_options,
    check_options,
    drive_options,
    driven_on,
    given,
    in_simulation,
    on_car,
    scenario_of,
    streamed,
)

_CONTROLLERS = (
    "stanley, stanley-textbook, stanley-delay, lqr, pure-pursuit, mpc, nonlinear-mpc, "
    "stanley-offset-free, lqr-offset-free, mpc-offset-free, stanley-adaptive, lqr-adaptive, mpc-adaptive, "
    "nfq, a run's directory, or your own: my_file.py:make."
)


@drive_options
def drive(
    ctx: typer.Context,
    options: DriveOptions,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="CONTROLLER...", show_default=False, help=_CONTROLLERS)
    ] = None,
    controller: Annotated[
        str, typer.Option(help="The same as an option; nfq: what `learn`, called alike, has learned.")
    ] = "",
    delay: Annotated[float, in_simulation("Steering delay (s).")] = 0.0,
    rounds: Annotated[float | None, in_simulation("Rounds to drive; default: the scenario's, 1.")] = None,
    out: Annotated[Path | None, in_simulation("Directory for the log and the picture.")] = None,
    animate: Annotated[Path | None, in_simulation("Film of the drive to write: .gif, or .mp4 with ffmpeg.")] = None,
    stream: Stream = "",
    pace: Annotated[float, in_simulation("With --stream: times real time.")] = 1.0,
    minutes: Annotated[float, on_car("How many minutes; 0: until `q`.")] = 0.0,
) -> None:
    """Drive with any controller: a course in simulation, or with --car FILE a car, armed and engaged by keys.

    Several controllers drive the same course under the same conditions: one table, one picture.
    """
    check_options(
        ctx,
        not_on_a_car={
            "seed": "nothing is drawn by lot there",
            "out": "say --recording FILE",
            "animate": "a recording holds the drive",
            "delay": "a car brings its own",
            "pace": "a car has its own",
        },
        on_a_car_only=("minutes",),
    )
    asked = list(names or ())
    if asked and controller and asked != [controller]:
        raise ValueError(f"two controllers, '{asked[0]}' and --controller {controller}; name one")
    asked = asked or [controller] * bool(controller)
    name = asked[0] if asked else ""
    if options.car:
        if len(asked) > 1:
            raise ValueError(f"drive: {len(asked)} controllers ({', '.join(asked)}), expected one on a car")
        from steerkit.car import loop as loops
        from steerkit.car import session as car_session

        if not name:
            raise ValueError(f"drive: with which controller? valid: {loops.VALID}")
        figures = car_session.drive(car_options(ctx), name, minutes=minutes)
        if options.as_json:
            print(json.dumps(figures))
        return
    from steerkit._support.errors import require
    from steerkit.diagram.simulation import Log
    from steerkit.learning import report
    from steerkit.scenario.catalogue import CONTROLLERS

    if not name:
        valid = ", ".join(CONTROLLERS)
        own = "the directory of a learning run, my_file.py:make"
        raise ValueError(f"drive: with which controller? valid: {valid}, nfq, {own}")
    if animate is not None:
        from steerkit.plots.animation import film_writer

        require(animate.suffix in (".gif", ".mp4"), f"--animate {animate}", "expected a name that ends in .gif or .mp4")
        film_writer(animate)
    folder = out is None or out.is_dir() or not out.exists()
    require(folder, f"--out {out}", "is a file, expected a directory for log and picture")
    require(stream or "pace" not in given(ctx), "drive --pace", "is for --stream PORT; say that too")
    require(not (stream and len(asked) > 1), f"--stream {stream}", "shows one controller; name one")
    scenario = scenario_of(ctx)
    where = driven_on(scenario, options.conditions)
    asked = [_learned(where, options.seed) if one == "nfq" else one for one in asked]
    require(len(set(asked)) == len(asked), "drive", f"a controller stands twice in {', '.join(asked)}")
    who = "+".join(map(report.file_name, asked))
    what = report.described(asked, scenario, rounds=rounds, seed=options.seed)
    place = out or report.place_of_its_own(Path("runs") / f"drive-{who}-{where}-seed{options.seed}", what)
    report.console.stderr = options.as_json
    if len(asked) > 1:
        require(animate is None, "--animate", "films one controller; name one")
        rows = report.drive_and_compare(asked, scenario, place, rounds=rounds, seed=options.seed, quiet=options.quiet)
        if options.as_json:
            print(json.dumps({"drives": rows}))
        return
    (name,) = asked
    with streamed(stream, pace=pace) as each:
        row = report.drive_and_draw(
            name, scenario, place, rounds=rounds, seed=options.seed, quiet=options.quiet, each=each
        )
    if animate is not None:
        p, log = scenario.nominal, Log.load(place / "drive.npz")
        log.animate(
            scenario.path(),
            animate,
            wheelbase=p.wheelbase,
            l_f=p.l_f,
            steer_ratio=p.steer_ratio,
            progress=not options.quiet,
        )
    if options.as_json:
        print(json.dumps(row))


def _learned(where: str, seed: int) -> str:
    """The directory of the run that `learn`, called with the same options, makes."""
    place = Path("runs") / f"default-{where}-seed{seed}"
    if not place.is_dir():
        raise ValueError(f"drive nfq: there is no {place}; `steerkit learn` with the same options makes it")
    return str(place)
