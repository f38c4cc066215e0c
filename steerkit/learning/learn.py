"""Run a learning experiment to its end, and keep it; or learn from a record or a log, without driving."""

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.console import shown
from steerkit._support.errors import require
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.loop import Sample
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.learning.data.from_log import Excitation, transitions_of
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.experiment import SIGNALS, Experiment, LearningRun, Watcher
from steerkit.learning.learner_state import untrained
from steerkit.learning.nfq.iterate import Learned, update
from steerkit.learning.rundir import held, is_free
from steerkit.learning.settings import Setting
from steerkit.task import DT


def learn(
    experiment: Experiment,
    directory: str | FilePath | None = None,
    *,
    watch: Watcher | None = None,
    each: Callable[[Sample], None] | None = None,
) -> LearningRun:
    """Run an experiment to its end and return the run; with a `directory`, keep everything there.

    A directory that holds an unfinished run of the same experiment is resumed from its last training, with the same
    numbers as if it had never stopped. One that has come to its end learns on where `minutes`, `episodes` or `rounds`
    are more now, with the same numbers as if it had been so many from the start. watch: called with what has happened
    and the run: "failed", "trained", "lost" (a training without a result), "round", "stuck", "doubted" (the safety
    filter found its doubts too small), and "second" after each second of driving. each: called with every sample that
    is recorded, such as a live stream's. Raises ValueError when the directory holds something else, when another
    process learns in it, and for parts of your own that could not be found again when the run is read.
    """
    what = (
        f"{experiment!r:.60}, expected an Experiment, such as Experiment(scenario=Scenario(course='paper'), minutes=2)"
    )
    require(isinstance(experiment, Experiment), "learn", what)
    if directory is None:
        return _driven(LearningRun(experiment, watch), each)
    rundir.plain(experiment)
    place = FilePath(directory)
    made = f"{place} is a file, expected a directory for the run; choose another name"
    require(place.is_dir() or not place.exists(), "learn", made)
    begun = (place / "run.json").exists()
    free = begun or not place.exists() or is_free(place)
    require(free, "learn", f"{place} is not empty and holds no run; choose a new directory")
    place.mkdir(parents=True, exist_ok=True)
    with held(place):
        if (place / "run.json").exists():
            run = rundir.resumed(place, watch=watch)
            _check_same(run.experiment, experiment, place)
            run.experiment = experiment
        else:
            run = LearningRun(experiment, watch)
            rundir.keep_in(run, place)
        return _driven(run, each)


def _driven(run: LearningRun, each: Callable[[Sample], None] | None) -> LearningRun:
    run.each = each
    while not run.done():
        run.drive()
    if run.keep is not None:
        run.keep(run)
    return run


UPDATES = 4
"""Updates of the Q-function on a log."""
IMAGINED = 6000
"""Least `fit.imagined` on a log: nothing but imagined driving is fitted."""
ENDS = ("minutes", "episodes", "rounds")
"""What ends a run, and changes nothing in it until then."""


def _check_same(kept: Experiment, asked: Experiment, place: FilePath) -> None:
    """Raise ValueError unless a kept run can go on as the experiment that is asked for."""
    same = replace(asked, **{name: getattr(kept, name) for name in ENDS})
    differing = [name for name in ("setting", "scenario", "seed") if getattr(same, name) != getattr(kept, name)]
    verb = "differs" if len(differing) == 1 else "differ"
    what = f"{place} holds a run of another experiment: its {' and '.join(differing)} {verb}"
    require(not differing, "learn", f"{what}; choose another directory")
    # rounds = 0: never
    less = [name for name in ENDS if (getattr(kept, name) or math.inf) > (getattr(asked, name) or math.inf)]
    more = ", ".join(f"{name} {getattr(kept, name):g}, now {getattr(asked, name):g}" for name in less)
    cure = "give as much or more, or choose another directory"
    require(not less, "learn", f"{place} holds a run of more: {more}; {cure}")


def from_log(
    drive: Any,
    experiment: Experiment,
    directory: str | FilePath | None = None,
    *,
    delay: float = 0.0,
    lag: float = 0.0,
    updates: int = UPDATES,
    progress: bool = False,
) -> LearningRun:
    """Learn from a recorded drive alone, human or controller, and return a run that has driven that and no more.

    It learns a model of the car as a run does (`CarModel`), and imagines the driving. A run of a longer experiment may
    go on from its directory by `learn`, in simulation.

    drive, delay, lag: see `steerkit.learning.data.from_log.as_driven`. experiment: setting, car (whose data sheet is
    believed) and seed; the course is where it is shown, and `minutes` become the drive's. updates: of the Q-function,
    all on the same record. progress: show a bar on the terminal. Raises ValueError for a setting that learns no model
    of the car, a drive that shows too little of the car (`Excitation`), and a directory that is in use.
    """
    setting, scenario, where = experiment.setting, experiment.scenario, drive.name
    models = f"setting '{setting.name}' learns no model of the car; valid: default, smooth, low-pass"
    require(setting.models_recovery and setting.fit.dead_time > 0.0, "learn from a log", models)
    require(updates >= 1, "learn from a log", f"updates = {updates}, expected >= 1")
    place = None if directory is None else FilePath(directory)
    free = place is None or not place.exists() or (place.is_dir() and is_free(place))
    require(free, "learn from a log", f"{place} is not an empty directory; choose another")
    largest = max(map(abs, setting.actions))
    record, log = transitions_of(
        drive, scenario.nominal, setting.element(scenario.nominal), largest, delay=delay, lag=lag
    )
    found = Excitation.of(record, setting.description(), setting.fit.dead_time)
    found.require_enough(where)
    fit = replace(setting.fit, imagined=max(setting.fit.imagined, IMAGINED))
    changed = replace(experiment, setting=replace(setting, fit=fit), minutes=len(log.t) * DT / 60.0)
    run = LearningRun(changed)
    run.source = {"log": where, "delay": delay, "lag": lag, **asdict(found)}
    run.counts.k = len(log.t) * run.ticks
    run.learner_state.transitions = record
    for _ in shown(range(updates), "updates" * progress):
        run.learner_state.train(run.t, trusted=True)
        run.learner_state.take_over(math.inf, e=0.0, e_dot=0.0)
    run.steer()
    if place is not None:
        place.mkdir(parents=True, exist_ok=True)
        with held(place):
            rundir.keep_in(run, place)
            signals = {name: log[name] for name in SIGNALS}
            Log(log.t, signals, {name: run.loop.units[name] for name in SIGNALS}).save(rundir.part_file(place, 0))
    return run


def offline(record: Transitions, setting: Setting, updates: int, *, seed: int = 0) -> Iterator[NfqPolicy]:
    """The policies after each of `updates` updates on the same recorded transitions.

    record: of one run or of several, whatever steered. Policies are ready to drive, or to `save`. The same numbers for
    the same arguments. Raises ValueError as `nfq.iterate` does, or for updates < 1.
    """
    require(updates >= 1, "offline", f"updates = {updates}, expected >= 1")
    policy = untrained(setting, seed)
    problem, learned = setting.problem, Learned()
    for number in range(updates):
        learned = update(record, problem, learned, seed=seed * 100_003 + number)
        yield replace(policy, nets=learned.nets, forecast=learned.forecast)
