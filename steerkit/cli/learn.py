"""The command `steerkit learn`: a car learns to steer, in simulation or on a car."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from steerkit.cli.options import (
    DriveOptions,
    car_options,
    check_options,
    drive_options,
    driven_on,
    in_simulation,
    scenario_of,
)


@drive_options
def learn(
    ctx: typer.Context,
    options: DriveOptions,
    setting: Annotated[str, typer.Option(help="How to learn: default, paper, bang-bang, ...")] = "default",
    changes: Annotated[
        list[str] | None,
        typer.Option("--with", metavar="NAME=VALUE", help="Change the setting: fit.nets=3, after_failure=shift, ..."),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(help="Minutes of driving, recovery and waiting included; default: 11, on a car until `q`."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Run directory; an unfinished run there is resumed. On a car: runs/car.")
    ] = None,
    rounds: Annotated[int, in_simulation("End after so many complete rounds by the learner; 0: never.")] = 0,
    config: Annotated[Path | None, in_simulation("TOML file with an experiment; other options give way.")] = None,
) -> None:
    """Let a car learn to steer a course from nothing, the recovery controller catching it."""
    from steerkit.learning.settings import changed
    from steerkit.learning.settings import setting as named

    check_options(ctx)
    if options.car:
        from steerkit.on_car import loop as loops
        from steerkit.on_car import session as car_session

        place = out or loops.LEARNED
        chosen = changed(named(setting), changes or ())
        figures = car_session.learn(car_options(ctx), chosen, place, minutes=minutes or 0.0, seed=options.seed)
        if options.as_json:
            print(json.dumps(figures))
        return
    from steerkit.files import read_toml
    from steerkit.learning import report, rundir
    from steerkit.learning.experiment import Experiment

    if config is None:
        world = scenario_of(ctx)
        time = 11.0 if minutes is None else minutes
        experiment = Experiment(setting=named(setting), world=world, minutes=time, rounds=rounds, seed=options.seed)
    else:
        experiment = rundir.from_plain(read_toml(config, f"--config {config}"), str(config), Experiment)
    experiment = replace(experiment, setting=changed(experiment.setting, changes or ()))
    name = "-".join((experiment.setting.name, *(changes or ())))
    place = out or Path("runs") / f"{name}-{driven_on(experiment.world, options.conditions)}-seed{experiment.seed}"
    report.console.stderr = options.as_json
    try:
        run = report.learn_with_progress(experiment, place, quiet=options.quiet)
    except KeyboardInterrupt:
        print(f"steerkit: interrupted; the same with --out {place} goes on from the last training", file=sys.stderr)
        raise
    except OSError as error:
        error.add_note(f"the run is kept up to its last training; the same with --out {place} goes on from there")
        raise
    report.show(place, quiet=options.quiet)
    if options.as_json:
        print(json.dumps(report.figures_of_merit(run)))
