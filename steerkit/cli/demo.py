"""The demonstration: three learning runs side by side, a table against Stanley, the paper's four figures."""

import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path as FilePath
from typing import Annotated

import typer
from rich.markup import escape

from steerkit._support.console import console
from steerkit.cli.options import Quiet, Seed
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment
from steerkit.learning.learn import learn
from steerkit.learning.report import in_lines, show_several
from steerkit.learning.settings import BANG_BANG, DEFAULT
from steerkit.plots import drive as figures
from steerkit.plots.style import save
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate

EXPERIMENTS = {
    "I-DOE, 800 m course": Experiment(setting=DEFAULT, minutes=11.0),
    "bang-bang, 800 m course": Experiment(setting=BANG_BANG, minutes=11.0),
    "I-DOE, recorded lap": Experiment(
        setting=DEFAULT, scenario=Scenario(course="genesis", driver={"v_min": 6.0, "v_max": 9.0}), minutes=20.0
    ),
}


def demo(
    seed: Seed = 0,
    out: Annotated[FilePath, typer.Option(help="Where runs and pictures go.")] = FilePath("runs/demo"),
    quiet: Quiet = False,
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
    jobs = [(name, experiment, out / _slug(name), seed, began) for name, experiment in EXPERIMENTS.items()]
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
        save(figure, out / name)
    if not quiet:
        console.print(f"pictures: {', '.join(pictures)} in {out}", soft_wrap=True)


def _part(job: tuple[str, Experiment, FilePath, int, float | None]) -> dict[str, Log]:
    """Learn, as far as that is not done; the drives that the final policy and Stanley make."""
    name, experiment, place, seed, began = job

    def say(line: str) -> None:
        if began is not None:
            said = f"[dim]{time.time() - began:4.0f} s[/]  [bold]{escape(name)}[/]: {escape(line)}"
            console.print(said, soft_wrap=True, highlight=False)

    experiment = replace(experiment, seed=seed)
    say("begins to learn")
    run = learn(experiment, place, watch=in_lines(say))
    counts = run.counts
    say(f"has learned: rounds {counts.rounds}, failures {counts.failures}; drives a round, and Stanley beside it")
    scenario = experiment.scenario
    doe = experiment.setting.element(scenario.nominal)
    learned = evaluate.drive(scenario, rundir.final_policy(place), doe=doe, seed=seed)
    stanley = evaluate.drive(scenario, scenario.recovery_controller(alone=True), seed=seed)
    return {who: Log(g.t, g.signals, g.units) for who, g in (("learned", learned), ("Stanley", stanley))}


def _slug(name: str) -> str:
    return name.lower().replace(",", "").replace(" ", "-")
