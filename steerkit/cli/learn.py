"""The commands `steerkit learn`, `show` and `demo`: a car learns to steer, in simulation or on a car."""

import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from multiprocessing import get_context
from pathlib import Path
from pathlib import Path as FilePath
from typing import Annotated, Any

import typer
from rich.markup import escape

from steerkit._support.console import console
from steerkit._support.errors import require
from steerkit._support.files import read_toml
from steerkit._support.plugins import is_outside, mine, named_in
from steerkit.car import loop as loops
from steerkit.car import session as car_session
from steerkit.cli import options as shared
from steerkit.cli.log import column_map
from steerkit.diagram.simulation import Log
from steerkit.learning import report, rundir
from steerkit.learning.data.from_log import Excitation
from steerkit.learning.experiment import SAFETY_SIGNALS, SIGNALS, Experiment
from steerkit.learning.learn import UPDATES, from_log
from steerkit.learning.learn import learn as learned_in
from steerkit.learning.pictures import draw_all, film_of
from steerkit.learning.report import in_lines, show_several
from steerkit.learning.settings import BANG_BANG, DEFAULT, changed
from steerkit.learning.settings import setting as named
from steerkit.logs import read_drive
from steerkit.plots import drive as figures
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate
from steerkit.task import DT


@shared.drive_options
def learn(
    ctx: typer.Context,
    options: shared.DriveOptions,
    setting: Annotated[str, typer.Option(help="How to learn: default, paper, bang-bang, ...")] = "default",
    changes: Annotated[
        list[str] | None,
        typer.Option("--with", metavar="NAME=VALUE", help="Change the setting: fit.nets=3, after_failure=reset, ..."),
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
    rounds: Annotated[int, shared.in_simulation("End after so many complete rounds by the learner; 0: never.")] = 0,
    config: Annotated[
        Path | None, shared.in_simulation("TOML file with an experiment; options given besides change it.")
    ] = None,
    live: Annotated[
        bool, shared.in_simulation("Write learning curves while it learns: tensorboard --logdir RUN.")
    ] = False,
    stream: shared.Stream = "",
    source: Annotated[
        list[str] | None, shared.from_a_log("A recorded drive: what `steerkit log` reads; repeatable.", "--from")
    ] = None,
    delay: Annotated[
        float | None, shared.from_a_log("Of a recorded wheel: the steering's delay (s), which the log cannot show.")
    ] = None,
    lag: Annotated[float, shared.from_a_log("Of a recorded wheel: the steering's lag behind its command (s).")] = 0.0,
    updates: Annotated[int, shared.from_a_log("Updates of the Q-function.")] = UPDATES,
    columns: Annotated[Path | None, shared.from_a_log("TOML file: which column is what, its unit.", "--map")] = None,
    column: Annotated[list[str] | None, shared.from_a_log("QUANTITY=COLUMN[:UNIT[:SCALE]]; repeatable.")] = None,
    dbc: Annotated[list[str] | None, shared.from_a_log("What is in CAN frames; repeatable.")] = None,
) -> None:
    """Let a car learn to steer a course from nothing; the recovery controller takes over where it fails.

    With --from LOG it learns from recorded driving alone: of the car --vehicle, shown on --course.
    """
    shared.check_options(ctx)
    if source:
        for name in shared.given(ctx) & {"car", "minutes", "rounds", "config", "live", "stream"}:
            raise ValueError(f"--{name} is for a car that drives: leave it out, or leave out --from")
        _from_log(ctx, options)
        return
    if options.car:
        chosen, on_a_car = changed(named(setting), changes or ()), shared.car_options(options, options.car)
        lasts = _minutes(minutes, None) or 0.0
        figures = car_session.learn(on_a_car, chosen, out or loops.LEARNED, minutes=lasts, seed=options.seed)
        if options.as_json:
            print(json.dumps(figures))
        return
    experiment = _experiment(ctx, config, out)
    name = "-".join((experiment.setting.name, *(changes or ())))
    where = shared.driven_on(experiment.scenario, options.conditions)
    place = out or Path("runs") / f"{name}-{where}-seed{experiment.seed}"
    console.stderr = options.as_json
    signals = (*SIGNALS, *SAFETY_SIGNALS * experiment.setting.safe)
    with shared.streamed(stream, signals=signals) as each:
        if live:
            console.print(f"live: tensorboard --logdir {place}", soft_wrap=True)
        try:
            run = report.learn_with_progress(experiment, place, quiet=options.quiet, live=live, each=each)
        except KeyboardInterrupt:
            print(f"steerkit: interrupted; the same with --out {place} goes on from the last training", file=sys.stderr)
            raise
        except OSError as error:
            begun = (place / "run.json").exists()
            kept = f"the run is kept up to its last training; the same with --out {place} goes on from there"
            error.add_note(
                kept if begun else f"nothing was learned: --out {place} cannot be written; give another directory"
            )
            raise
        report.show(place, quiet=options.quiet)
    if options.as_json:
        print(json.dumps(report.figures_of_merit(run)), flush=True)


def _from_log(ctx: typer.Context, options: shared.DriveOptions) -> None:
    """Learn from a recorded drive, and show what came of it."""
    console.stderr = options.as_json
    experiment = replace(_experiment(ctx, None, None), minutes=1.0)
    p, ratio = ctx.params, float(experiment.scenario.nominal.steer_ratio)
    columns, delay, lag = column_map(p["columns"], p["column"]), p["delay"], p["lag"]
    drive = read_drive(p["source"], columns, dbc=p["dbc"] or (), dt=DT, steer_ratio=ratio)
    told = delay is not None or lag > 0.0
    said = "delta_sw is a command by its channel's name; --delay and --lag are for the angle of a wheel"
    require(not (drive.commanded and told), drive.name, said)
    late = (
        f"taken to follow its command {delay or 0.0:g} s later with a lag of {lag:g} s"
        if told
        else "taken for the command: how late the steering is does not show in it; say so: --delay 0.1 --lag 0.2"
    )
    assumed = "" if drive.commanded else f"delta_sw is the angle of a wheel, by its channel's name; {late}"
    if not options.quiet:
        for note in (*drive.notes, *filter(None, [assumed])):
            console.print(note, soft_wrap=True, highlight=False, markup=False)
    name = Path(p["source"][0]).name.partition(".")[0]
    default = f"from-{name}-{shared.driven_on(experiment.scenario, options.conditions)}-seed{options.seed}"
    place = Path(p["out"] or Path("runs") / default)
    how: dict[str, Any] = {"delay": delay or 0.0, "lag": lag, "updates": p["updates"]}
    run = from_log(drive, experiment, place, progress=not options.quiet, **how)
    assert run.source is not None
    if not options.quiet:
        shown = Excitation(**{f.name: run.source[f.name] for f in fields(Excitation)})
        console.print(f"{drive.name}: {shown}", soft_wrap=True, highlight=False)
    figures = report.show(place, quiet=options.quiet)
    if options.as_json:
        print(json.dumps(figures | {"from_log": run.source, "assumed": assumed, "run": str(place)}))


def _experiment(ctx: typer.Context, config: Path | None, out: Path | None) -> Experiment:
    """The experiment of the run in `out`, of the file, or of the defaults, changed by the options that are given."""
    base: Experiment | None = None
    for change in filter(is_outside, ctx.params["changes"] or ()):
        mine(change.partition("=")[2])
    if out is not None and (out / "run.json").is_file():
        base = rundir.experiment_of(out)
    if config is not None:
        with named_in(f"{config}"):
            base = rundir.from_plain(read_toml(config, f"--config {config}"), str(config), Experiment)
    names, p = shared.given(ctx), ctx.params
    scenario = shared.scenario_of(ctx) if base is None else shared.scenario_of(ctx, base.scenario)
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
    return minutes + base.minutes if base is not None and text.startswith("+") else minutes


def show(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Directories of learning runs.")],
    diagnostics: Annotated[
        bool, typer.Option(help="Draw what the net believes, and where and when it failed.")
    ] = False,
    film: Annotated[
        Path | None, typer.Option(help="Film of the run to write, from its first second on (.gif).")
    ] = None,
    film_lasts: Annotated[float, typer.Option(help="Length of the film in s, 2 to 120.")] = 20.0,
    distance: Annotated[
        Path | None,
        typer.Option(help="Log of a policy's drive (drive.npz): say only how far from the run's data it is."),
    ] = None,
    quiet: shared.Quiet = False,
    as_json: shared.Machine = False,
) -> None:
    """Show a learning run: counts, episodes, learned against Stanley, and its pictures; several as one table."""
    console.stderr = as_json
    if len(runs) > 1:
        require(not diagnostics, "show --diagnostics", "takes one run")
        require(film is None, "show --film", "takes one run")
        require(distance is None, "show --distance", "takes one run")
        rows = report.show_several(runs)
        if as_json:
            print(json.dumps({"runs": rows}))
        return
    (run,) = runs
    if distance is not None:
        apart = report.distance_to(rundir.load(run), Log.load(distance), str(distance))
        console.print(f"{distance}: {apart}", soft_wrap=True, highlight=False)
        if as_json:
            print(json.dumps(apart.figures()))
        return
    if film is not None:  # before what takes longer, as its name may be refused
        console.print(f"film: {film_of(run, film, lasts=film_lasts)}", soft_wrap=True)
    figures = report.show(run, quiet=quiet)
    if diagnostics:
        drawn = draw_all(run)
        console.print(f"diagnostics: {', '.join(map(str, drawn))}", soft_wrap=True)
    if as_json:
        print(json.dumps(figures))


EXPERIMENTS = {
    "I-DOE, 800 m course": Experiment(setting=DEFAULT, minutes=11.0),
    "bang-bang, 800 m course": Experiment(setting=BANG_BANG, minutes=11.0),
    "I-DOE, recorded lap": Experiment(
        setting=DEFAULT, scenario=Scenario(course="genesis", driver={"v_min": 6.0, "v_max": 9.0}), minutes=20.0
    ),
}


def demo(
    seed: shared.Seed = 0,
    out: Annotated[FilePath, typer.Option(help="Where runs and pictures go.")] = FilePath("runs/demo"),
    quiet: shared.Quiet = False,
) -> None:
    """Learn on the 800 m course and on a real recorded lap; compare with Stanley; redraw the paper's figures.

    An interrupted demonstration goes on where it was.
    """
    if not quiet:
        console.print(
            f"Three cars learn to steer from nothing: {'; '.join(map(escape, EXPERIMENTS))}. Each drives for "
            "11 to 20 minutes, two at a time; no real car is driven. Lines begin with the seconds since now.",
            soft_wrap=True,
        )
    out.mkdir(parents=True, exist_ok=True)
    began = None if quiet else time.time()
    jobs = [(name, replace(each, seed=seed), out / _slug(name), began) for name, each in EXPERIMENTS.items()]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        drives = dict(zip(EXPERIMENTS, pool.map(_part, jobs)))
    show_several([out / _slug(name) for name in EXPERIMENTS])
    for name, logs in drives.items():
        console.print(evaluate.comparison(name, logs))
    idoe, bang, _ = drives
    place = out / _slug(idoe)
    log, counts = rundir.drive_log(place), rundir.document(place)["counts"]
    pictures = {
        "figure-3-bang-bang.png": figures.trace(drives[bang]["learned"], title="Bang-bang actions, final net"),
        "figure-4-i-doe.png": figures.trace(drives[idoe]["learned"], title="Integrating DOE, final net"),
        "figure-5-learning.png": figures.learning(
            log, title="Learning from the first second, recovery shaded", seconds=350.0
        ),
        "figure-6-first-round.png": figures.first_round(
            log, began=counts["first_round_begun"], done=counts["first_round_done"], title="First complete round"
        ),
    }
    for name, logs in drives.items():
        title = f"{name}: final net and Stanley"
        pictures[f"round-{_slug(name)}.png"] = figures.round_driven(*logs.values(), title=title)
    for name, figure in pictures.items():
        figure.savefig(out / name)
    if not quiet:
        console.print(f"pictures: {', '.join(pictures)} in {out}", soft_wrap=True)


def _part(job: tuple[str, Experiment, FilePath, float | None]) -> dict[str, Log]:
    """Learn, as far as that is not done; the drives that the final policy and Stanley make."""
    name, experiment, place, began = job

    def say(line: str) -> None:
        if began is not None:
            said = f"[dim]{time.time() - began:4.0f} s[/]  [bold]{escape(name)}[/]: {escape(line)}"
            console.print(said, soft_wrap=True, highlight=False)

    say("begins to learn")
    run = learned_in(experiment, place, watch=in_lines(say))
    counts = run.counts
    say(f"has learned: rounds {counts.rounds}, failures {counts.failures}; drives a round, and Stanley beside it")
    scenario = experiment.scenario
    doe = experiment.setting.element(scenario.nominal)
    learned = evaluate.drive(scenario, rundir.final_policy(place), doe=doe, seed=experiment.seed)
    stanley = evaluate.drive(scenario, scenario.recovery_controller(alone=True), seed=experiment.seed)
    return {who: Log(g.t, g.signals, g.units) for who, g in (("learned", learned), ("Stanley", stanley))}


def _slug(name: str) -> str:
    return name.lower().replace(",", "").replace(" ", "-")
