"""A process without dead time: recorded transitions in which what a car does is beside the command that it answers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit.controllers.forecast import LONGEST, Forecast
from steerkit.controllers.policy import COLUMNS, DOE, E_DOT
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.model import CarModel, earlier_doe, follow
from steerkit.learning.nfq.patterns import StateDescription
from steerkit.task import DT

FEWEST = 15
"""Transitions from which a dead time is looked for."""
AS_GOOD = 1.02
"""A longer dead time is preferred to a shorter one that explains the car better by less than this factor: the model's
three angles can stand for a sample of it, and the process that is learned is the simpler, the less of it is left."""
TRUST = 0.5
"""Share of what is seen in the filtered values (see `Forecast.trust`)."""


class Process(NamedTuple):
    """What a learner makes of its record: transitions without dead time, and how to act on a car that has some."""

    record: Transitions
    """Aligned transitions of the columns that a net sees, with doe counted from the angle of going straight on."""
    model: CarModel
    """The car of that record."""
    forecast: Forecast


def process_of(record: Transitions, description: StateDescription, longest: float, dt: float = DT) -> Process:
    """The process without dead time behind recorded transitions, and the dead time, up to `longest` [s].

    The dead time is the one whose model leaves the least of the car's turning unexplained, all judged on the same
    samples. record: with the column kappa. A record too short to tell is taken to have none.
    """
    known = [aligned(record, n) for n in range(min(LONGEST, round(longest / dt)) + 1)]
    while len(known) > 1 and len(known[-1]) < FEWEST:
        known.pop()
    models = [CarModel.fit(part, description, dt) for part in known]
    last = len(known) - 1
    errors = [_unexplained(model, part, last - n) for n, (model, part) in enumerate(zip(models, known, strict=True))]
    best = int(np.argmin(errors))
    while best < last and errors[best + 1] <= AS_GOOD * min(errors):
        best += 1
    model, part = models[best], known[best]
    numbers = {name: getattr(model, name) for name in ("now", "before", "earlier", "back", "yaw", "straight")}
    forecast = Forecast(samples=best, trust=TRUST, dt=dt, **numbers)
    s, s_next = part.s[:, : len(COLUMNS)].copy(), part.s_next[:, : len(COLUMNS)].copy()
    s[:, DOE] -= model.straight
    s_next[:, DOE] -= model.straight
    straightened = Transitions(COLUMNS)
    straightened.extend(s, part.a, s_next, part.episode)
    return Process(straightened, model, forecast)


def aligned(record: Transitions, samples: int) -> Transitions:
    """The transitions as they would be without `samples` of dead time.

    The output element's angle and the action of a sample are put beside the car's motion of `samples` later, which is
    the motion that the next angle begins to change. The last samples of each episode's angles have no such motion.
    """
    if samples == 0:
        return record
    episode = np.cumsum(~follow(record))
    row = np.arange(max(0, len(record) - samples))
    row = row[episode[row] == episode[row + samples]]
    s, s_next = record.s[row + samples].copy(), record.s_next[row + samples].copy()
    s[:, DOE], s_next[:, DOE] = record.s[row, DOE], record.s_next[row, DOE]
    part = Transitions(record.names)
    part.extend(s, record.a[row], s_next, record.episode[row])
    return part


def _unexplained(model: CarModel, part: Transitions, skipped: int) -> float:
    """RMS of what the model leaves of the course's change in a sample [rad], without each episode's first samples.

    A model in which the wheel turns the car the wrong way explains nothing.
    """
    if model.ratio <= 0.0:
        return np.inf
    columns = slice(len(COLUMNS))
    s, s_next = part.s[:, columns].copy(), part.s_next[:, columns]
    s[:, DOE] -= model.straight
    foreseen = model.step(s, part.a, earlier_doe(part) - model.straight)
    error: NDArray[np.float64] = (s_next[:, E_DOT] - foreseen[:, E_DOT]) / np.maximum(s[:, 2], 1.0)
    starts = np.flatnonzero(~follow(part))
    place = np.arange(len(part)) - np.repeat(starts, np.diff([*starts, len(part)]))
    judged = error[place >= skipped]
    return float(np.sqrt(np.mean(judged**2))) if len(judged) else np.inf
