"""The film of a learning run, for a page's first screen: who steers, how far off the path, how often it failed."""

from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.learning.pictures.run import Record
from steerkit.plots.animation import animate, film_writer


def film_of(place: str | FilePath, file: str | FilePath, *, lasts: float = 20.0, fps: float = 8.0) -> FilePath:
    """Write the film of a run directory to `file`, .gif or .mp4: to its first whole round, or to the run's end.

    The beginning, until the learner has the wheel again after its first failure, runs in real time; all after it as
    fast as the film's length needs. lasts: how long it is [s], 2 to 120. fps: pictures a second, 1 to 60.
    Returns the file. Raises ValueError for another ending, length or rate, and for what is no run directory.
    """
    film_writer(file)
    require(2.0 <= lasts <= 120.0, "film", f"lasts = {lasts} s, expected 2 to 120")
    record = Record.read(place)
    done = rundir.document(FilePath(place))["counts"]["first_round_done"]
    t, car = record.log.t, record.experiment.scenario.nominal
    require(len(t) >= 2, "film", f"{place}: nothing has been driven yet")
    moments = moments_of(record, float(t[-1] if done is None else min(done, t[-1])), lasts, fps)
    return animate(with_heading(record), record.path, file, vehicle=car, fps=fps, moments=moments)


def with_heading(record: Record) -> Log:
    """The run's signals, and the car's heading, which it does not record."""
    log = record.log
    psi = record.path.psi(log["path.s"]) + log["path.psi_e"]
    return Log(log.t, {**log.signals, "car.psi": psi}, {**log.units, "car.psi": "rad"})


def moments_of(record: Record, until: float, lasts: float, fps: float) -> NDArray[np.float64]:
    """Driving time of each picture [s]: the beginning in real time, if that takes up to half the film; else evenly."""
    t = record.log.t
    again = t[record.learning & (t > t[record.failed_at[0]])] if len(record.failed_at) else t[:0]
    begin = min(until, (float(again[0]) if len(again) else 0.0) + 4.0)
    first = np.arange(0.0, begin, max(1.0, begin / (0.5 * lasts)) / fps)
    return np.concatenate((first, np.linspace(begin, until, max(2, round(lasts * fps) - len(first)))))
