"""An angle on its way from where it is known to where it acts: behind a lag and a dead time that may change."""

from __future__ import annotations

from steerkit import maths as m
from steerkit.block import State
from steerkit.controllers.estimators.bank import at
from steerkit.maths import Scalar


def arrived(line: State, command: Scalar, delay: Scalar, lag: Scalar, dt: float) -> tuple[State, Scalar]:
    """The line a sample later, and the angle [rad] that arrives then.

    line: the angle behind the lag, now and at the samples before, newest first; command: the angle that is held for
    dt [s]. The lag [s] is exact, the delay [s] interpolated in the line, and cut to its length.
    """
    lagged = command + (line[0] - command) * m.exp(-dt / m.maximum(lag, 1e-3))
    line = (lagged, *line[:-1])
    place = m.clip(delay / dt, 0.0, len(line) - 1.0)
    entry = m.floor(place)
    before, after = at(entry, line), at(m.minimum(entry + 1.0, len(line) - 1.0), line)
    return line, before + (place - entry) * (after - before)
