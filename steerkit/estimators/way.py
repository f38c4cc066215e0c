"""An angle on its way from where it is known to where it acts: behind a lag and a dead time that may change."""

from __future__ import annotations

from typing import NamedTuple

from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.maths import Scalar
from steerkit.estimators.bank import at


class Arrived(NamedTuple):
    """How the angle that arrives goes on within a sample: one way to the corner, then another to the end."""

    corner: Scalar
    """It, where the angle on its way was a whole number of samples old [rad]; a held command changes only there."""
    first: Scalar
    """Share of the sample until then [1]."""
    end: Scalar
    """It, at the end of the sample [rad]."""


def arrived(
    line: State, command: Scalar, delay: Scalar, lag: Scalar, dt: float, *, held: bool
) -> tuple[State, Arrived]:
    """The line a sample later, and the angle that arrives in it.

    line: the angle behind the lag, now and at the samples before, newest first; command: the angle of now. The lag [s]
    is exact where that is `held` for dt [s]; between samples then goes what arrives, too:

        angle(t + s) = x(t) + (x(t + dt) - x(t)) (1 - exp(-s/lag))/(1 - exp(-dt/lag)),  0 <= s <= dt,

    else in a line. The delay [s] is cut to the line's length. Each part of the way, up to the corner and from there to
    the end, has no extremum inside.
    """
    keep = m.exp(-dt / m.maximum(lag, 1e-3))
    lagged = command + (line[0] - command) * keep
    line = (lagged, *line[:-1])
    place = m.clip(delay / dt, 0.0, len(line) - 1.0)
    entry = m.floor(place)
    first = place - entry
    newer, older = at(entry, line), at(m.minimum(entry + 1.0, len(line) - 1.0), line)
    share = (1.0 - m.exp(-(1.0 - first) * dt / m.maximum(lag, 1e-3))) / (1.0 - keep) if held else 1.0 - first
    return line, Arrived(older, first, older + share * (newer - older))
