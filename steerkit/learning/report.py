"""What a person sees of a run: a bar, lines, TensorBoard's curves while it learns; tables and pictures after it."""

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path as FilePath
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table

from steerkit._support.console import console
from steerkit._support.errors import optional
from steerkit.diagram.loop import Sample
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.learning.data.distance import Distance, states_of
from steerkit.learning.experiment import Experiment, LearningRun, Watcher
from steerkit.learning.learn import learn
from steerkit.learning.pictures import beside_the_data
from steerkit.plots.drive import learning, round_driven
from steerkit.scenario import drive as evaluate

LAST = 10.0
"""Driving time over which the RMS e of the moment is taken [s]."""


# ---- while it learns -------------------------------------------------------------------------------------------------


def learn_with_progress(
    experiment: Experiment,
    place: FilePath,
    *,
    quiet: bool = False,
    live: bool = False,
    each: Callable[[Sample], None] | None = None,
) -> LearningRun:
    """`learn`, with a bar on a terminal and a line for every fifth failure and every round elsewhere.

    live: write learning curves for TensorBoard too, into the run's directory. Raises ValueError without its package.
    """
    with contextlib.ExitStack() as stack:
        watchers: list[Watcher] = []
        if live:
            watchers.append(stack.enter_context(in_tensorboard(place)))
        if not quiet and console.is_terminal:
            watchers.append(stack.enter_context(on_terminal(experiment, console)))
        elif not quiet:
            watchers.append(in_lines(lambda line: console.print(line, soft_wrap=True)))

        def watch(what: str, run: LearningRun) -> None:
            for watcher in watchers:
                watcher(what, run)

        return learn(experiment, place, watch=watch, each=each)


class Lately:
    """The learner's RMS e and its share of the time in the last LAST seconds driven; `see` the run each second."""

    def __init__(self) -> None:
        self._totals: deque[tuple[float, int, float]] = deque()

    def see(self, run: LearningRun) -> None:
        """Take up what the run has counted since."""
        episodes = run.counts.episodes
        self._totals.append((run.t, sum(one.samples for one in episodes), sum(one.sum_e2 for one in episodes)))
        while len(self._totals) > 2 and self._totals[1][0] <= run.t - LAST:
            self._totals.popleft()
        self._period = run.ticks * run.loop.dt

    def figures(self) -> tuple[float, float]:
        """RMS e while the learner steered [m], NaN where it did not; share of the time in which it did [1]."""
        (t0, samples0, sum0), (t1, samples1, sum1) = self._totals[0], self._totals[-1]
        samples = samples1 - samples0
        rms = math.sqrt(max(0.0, sum1 - sum0) / samples) if samples else math.nan
        return rms, samples * self._period / (t1 - t0) if t1 > t0 else math.nan


@contextlib.contextmanager
def in_tensorboard(place: FilePath) -> Iterator[Watcher]:
    """Learning curves as TensorBoard event files in `place`, a point a second of driving (the step, in seconds).

    A run that goes on continues its curves. Raises ValueError where the package tensorboard is missing.
    """
    optional("tensorboard", "learn --live", "live")
    from torch.utils.tensorboard import SummaryWriter

    lately, writers = Lately(), list[Any]()

    def watch(what: str, run: LearningRun) -> None:
        if what != "second":
            return
        if not writers:  # what was driven after the last checkpoint of an interrupted run is driven again
            writers.append(SummaryWriter(str(place), purge_step=int(run.t)))
        lately.see(run)
        rms_e, share = lately.figures()
        counts = run.counts
        curves = {
            "rms_e [m]": rms_e,
            "learner steers [share of the time]": share,
            "failures": counts.failures,
            "rounds": counts.rounds,
            "trainings": counts.updates,
            "transitions": len(run.transitions),
        }
        for name, value in curves.items():
            if math.isfinite(value):
                writers[0].add_scalar(name, value, int(run.t))
        writers[0].flush()

    try:
        yield watch
    finally:
        for writer in writers:
            writer.close()


@contextlib.contextmanager
def on_terminal(experiment: Experiment, console: Console) -> Iterator[Watcher]:
    """A bar of the driving time with who steers, how well, the counts, and the computing time to go."""
    lately = Lately()
    words = TextColumn("{task.description}", table_column=Column())
    bar = Progress(words, BarColumn(16), TimeRemainingColumn(), console=console)
    task = bar.add_task("begins", total=60.0 * experiment.minutes, start=False)

    def watch(what: str, run: LearningRun) -> None:
        if line := trouble(what, run):
            bar.console.print(line, soft_wrap=True, style="yellow")
        if what == "second":
            lately.see(run)
            if not bar.tasks[0].started:  # at its first second, that of a run that goes on too
                bar.reset(task, completed=int(run.t))
            bar.update(task, completed=run.t, description=in_words(run, lately.figures()[0]))

    with bar:
        yield watch


def trouble(what: str, run: LearningRun) -> str:
    """Why recovery cannot hand over, or what the safety filter has just found of the car beyond its doubts; else ""."""
    doubt = f"safety filter, at {run.t:.1f} s: {run.doubted}" if what == "doubted" else ""
    return run.counts.stuck[-1] if what == "stuck" else doubt


def in_words(run: LearningRun, rms_e: float) -> str:
    """A run at this moment in one line. rms_e: over the last LAST seconds [m]."""
    counts = run.counts
    who = "learner" if counts.episode is not None else "recovery"
    error = "" if math.isnan(rms_e) else f", RMS e {rms_e:.3f} m"
    done = f"failures {counts.failures}, rounds {counts.rounds}, trainings {counts.updates}"
    return f"{run.t / 60.0:.1f} of {run.experiment.minutes:g} min: {who} steers{error}; {done}"


def in_lines(say: Callable[[str], None]) -> Watcher:
    """A line for every round, every fifth failure, and whenever the recovery controller does not get to hand over or
    the safety filter finds its doubts too small."""

    def watch(what: str, run: LearningRun) -> None:
        if line := trouble(what, run):
            say(line)
        if what == "round" or (what == "failed" and run.counts.failures % 5 == 0):
            say(f"{what}: {in_words(run, run.counts.episodes[-1].rms_e)}")

    return watch


# ---- afterwards ------------------------------------------------------------------------------------------------------


def figures_of_merit(run: LearningRun) -> dict[str, Any]:
    """The numbers of a run that a program would read."""
    counts = run.counts
    return {
        "setting": run.experiment.setting.name,
        "course": run.experiment.scenario.course.name,
        "seed": run.experiment.seed,
        "driving_minutes": run.t / 60.0,
        "failures": counts.failures,
        "stuck": len(counts.stuck),
        "rounds": counts.rounds,
        "first_round_begun_s": counts.first_round_begun,
        "first_round_done_s": counts.first_round_done,
        "failures_to_round": counts.failures_to_round,
        "transitions": len(run.transitions),
        "updates": counts.updates,
        "training_seconds": counts.train_seconds,
    }


def show(place: FilePath, *, quiet: bool = False) -> dict[str, Any]:
    """Print a run's counts and the final policy against Stanley, and draw the run's pictures beside its data.

    Returns the same for a program: `figures_of_merit`, and under `drives` a row for each of the two.
    """
    run = rundir.load(place)
    merit = figures_of_merit(run)
    if run.source is not None:
        merit = {"log": run.source["log"]} | merit
    console.print(_side_by_side({f"{place}": merit}))
    scenario = run.experiment.scenario
    logs = {
        "learned": _final_drive(place, run),
        "stanley": evaluate.drive(scenario, scenario.recovery_controller(alone=True)),
    }
    net = "the final net" if run.counts.updates else "a net that was never trained"
    console.print(evaluate.comparison(f"one round of {scenario.course.name}, {net}", logs))
    name = run.experiment.setting.name
    pictures = {
        "round": round_driven(logs["learned"], logs["stanley"], title=f"{name} on {scenario.course.name}: final net")
    }
    if run.counts.episodes:
        title = f"{name} on {scenario.course.name}: from the first second"
        pictures["learning"] = learning(rundir.drive_log(place, until=run.t), title=title)
    far = {}
    if len(run.transitions):
        apart = distance_to(run, logs["learned"], "the final net's drive")
        far = {"distance": apart.figures()}
        pictures["data"] = beside_the_data(
            run.transitions, logs["learned"], apart, title=f"{place.name}: its data, and a drive"
        )
        console.print(f"this drive's {apart}", soft_wrap=True, highlight=False)
    for file, figure in pictures.items():
        figure.savefig(place / f"{file}.png")
    if not quiet:
        console.print(f"pictures: {', '.join(f'{place}/{file}.png' for file in pictures)}", soft_wrap=True)
    return merit | far | {"drives": [evaluate.row_of(name, log) for name, log in logs.items()]}


def distance_to(run: LearningRun, log: Log, where: str) -> Distance:
    """How far from what a run has recorded a drive's samples lie."""
    return Distance.of(states_of(log, where), run.transitions, run.experiment.setting.description())


def _final_drive(place: FilePath, run: LearningRun) -> Log:
    """A test drive of the net that a run had when it was loaded, where it was learned."""
    scenario = run.experiment.scenario
    policy = rundir.final_policy(place, run.counts.updates)
    return evaluate.drive(scenario, policy, doe=run.experiment.setting.element(scenario.nominal))


def show_several(places: Sequence[FilePath]) -> list[dict[str, Any]]:
    """Print several runs side by side: what learning took, and a test drive of each one's final net."""
    runs = {str(place): rundir.load(place) for place in places}
    merits = {name: figures_of_merit(run) for name, run in runs.items()}
    console.print(_side_by_side(merits))
    logs = {name: _final_drive(FilePath(name), run) for name, run in runs.items()}
    console.print(evaluate.comparison("a test drive of each one's final net", logs))
    return [merit | {"run": name, "drive": evaluate.row_of(name, logs[name])} for name, merit in merits.items()]


def _side_by_side(merits: dict[str, dict[str, Any]]) -> Table:
    """A column a run: a row a run is wider than a terminal."""
    columns = [Column(escape(name), overflow="fold") for name in merits]
    table = Table("", *columns, title=f"{len(merits)} runs" if len(merits) > 1 else None)
    for key in next(iter(merits.values())):
        cells = [merit[key] for merit in merits.values()]
        table.add_row(key.replace("_", " "), *(f"{x:.2f}" if isinstance(x, float) else str(x) for x in cells))
    return table
