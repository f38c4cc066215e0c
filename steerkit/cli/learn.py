"""The command `steerkit learn`: a car learns to steer, in simulation or on a car."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    scenario_of,
    streamed,
)

if TYPE_CHECKING:
    from steerkit.learning.experiment import Experiment, LearningRun


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
        str,
        typer.Option(
            help="Minutes of driving, recovery and waiting included, or +5: so many more than the run in --out has; "
            "default: 11, on a car until `q`."
        ),
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option(
            help="Run directory. A run that is there goes on, as it was begun: only what ends it may be given anew. "
            "On a car: runs/car."
        ),
    ] = None,
    rounds: Annotated[int, in_simulation("End after so many complete rounds by the learner; 0: never.")] = 0,
    config: Annotated[
        Path | None, in_simulation("TOML file with an experiment; options given besides change it.")
    ] = None,
    live: Annotated[
        bool, in_simulation("Write learning curves into the run directory while it learns: tensorboard --logdir RUN.")
    ] = False,
    stream: Stream = "",
) -> None:
    """Let a car learn to steer a course from nothing, the recovery controller catching it."""
    check_options(ctx)
    if options.car:
        from steerkit.car import loop as loops
        from steerkit.car import session as car_session
        from steerkit.learning.settings import changed
        from steerkit.learning.settings import setting as named

        place = out or loops.LEARNED
        chosen = changed(named(setting), changes or ())
        figures = car_session.learn(
            car_options(ctx), chosen, place, minutes=_minutes(minutes, None) or 0.0, seed=options.seed
        )
        if options.as_json:
            print(json.dumps(figures))
        return
    from steerkit._support.console import console
    from steerkit.learning import report
    from steerkit.learning.experiment import SAFETY_SIGNALS, SIGNALS

    experiment = _experiment(ctx, config, out)
    name = "-".join((experiment.setting.name, *(changes or ())))
    place = out or Path("runs") / f"{name}-{driven_on(experiment.scenario, options.conditions)}-seed{experiment.seed}"
    console.stderr = options.as_json
    signals = (*SIGNALS, *SAFETY_SIGNALS * experiment.setting.safe)
    with streamed(stream, signals=signals) as each:
        if live:
            console.print(f"live: tensorboard --logdir {place}", soft_wrap=True)
        run = _learned(experiment, place, quiet=options.quiet, live=live, each=each)
        report.show(place, quiet=options.quiet)
    if options.as_json:
        print(json.dumps(report.figures_of_merit(run)), flush=True)


def _learned(experiment: Experiment, place: Path, *, quiet: bool, live: bool, each: Any) -> LearningRun:
    from steerkit.learning import report

    try:
        return report.learn_with_progress(experiment, place, quiet=quiet, live=live, each=each)
    except KeyboardInterrupt:
        print(f"steerkit: interrupted; the same with --out {place} goes on from the last training", file=sys.stderr)
        raise
    except OSError as error:
        error.add_note(f"the run is kept up to its last training; the same with --out {place} goes on from there")
        raise


def _experiment(ctx: typer.Context, config: Path | None, out: Path | None) -> Experiment:
    """The experiment of the run in `out`, of the file, or of the defaults, changed by the options that are given."""
    from steerkit._support.files import read_toml
    from steerkit.learning import rundir
    from steerkit.learning.experiment import Experiment
    from steerkit.learning.settings import changed
    from steerkit.learning.settings import setting as named

    base: Experiment | None = None
    if out is not None and (out / "run.json").is_file():
        base = rundir.experiment_of(out)
    if config is not None:
        base = rundir.from_plain(read_toml(config, f"--config {config}"), str(config), Experiment)
    names, p = given(ctx), ctx.params
    scenario = scenario_of(ctx) if base is None else scenario_of(ctx, base.scenario)
    if base is None or "setting" in names:
        setting = named(p["setting"])
    else:
        setting = base.setting
    ends: dict[str, Any] = {name: p[name] for name in ("rounds", "seed") if base is None or name in names}
    minutes = _minutes(p["minutes"], base)
    if minutes is not None or base is None:
        ends["minutes"] = 11.0 if minutes is None else minutes
    setting = changed(setting, p["changes"] or ())
    return replace(base or Experiment(), setting=setting, scenario=scenario, **ends)


def _minutes(text: str, base: Experiment | None) -> float | None:
    """The minutes that are asked for; None: none are. `+5` is five more than those of `base`."""
    if not text:
        return None
    try:
        minutes = float(text)
    except ValueError:
        raise ValueError(f"--minutes {text}: expected a number, or +5 for five more") from None
    more = text.startswith("+") and base is not None
    return minutes + base.minutes if more and base is not None else minutes
