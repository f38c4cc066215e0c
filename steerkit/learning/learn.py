"""Run a learning experiment to its end, and keep it."""

from __future__ import annotations

from pathlib import Path as FilePath

from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment, LearningRun, Watcher


def learn(
    experiment: Experiment, directory: str | FilePath | None = None, *, watch: Watcher | None = None
) -> LearningRun:
    """Run an experiment to its end and return the run; with a `directory`, keep everything there.

    A directory that holds an unfinished run of the same experiment is resumed from its last training, with the
    same numbers as if it had never stopped. watch: called with "failed", "trained" or "round" and the run.
    Raises ValueError when the directory holds something else.
    """
    place = None if directory is None else FilePath(directory)
    if place is not None and (place / "run.json").exists():
        run = rundir.load(place, watch=watch)
        if run.experiment != experiment:
            raise ValueError(f"learn: {place} holds a run of another experiment; choose another directory")
    else:
        if place is not None:
            if place.exists() and any(place.iterdir()):
                raise ValueError(f"learn: {place} is not empty and holds no run; choose a new directory")
            place.mkdir(parents=True, exist_ok=True)
        run = LearningRun(experiment, watch)
        if place is not None:
            rundir.keep_in(run, place)
    while not run.done():
        run.drive()
    if run.keep is not None:
        run.keep(run)
    return run
