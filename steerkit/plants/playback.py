"""A recorded drive, played back into a plant."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from steerkit._support.errors import require, require_within
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, Out
from steerkit.diagram.maths import Scalar, Table


@dataclass(frozen=True, eq=False, kw_only=True)
class Playback(Block):
    """Steering-wheel angle and speed as they were recorded every dt, linear in between; the angle `delay` later.

    delta_sw(t) = angle(t - delay),  v(t) = speed(t).

    Before the first and after the last sample their values hold.

    no inputs. outputs: delta_sw [rad], v [m/s]. no state. delay need not be a multiple of dt, and may be negative (the
    record is known ahead); it may be an `(N,)` array for a batch. errors: ValueError for samples that are not finite
    or not equally many, delay or dt out of range.
    """

    delta_sw = Out("rad", direct=())
    v = Out("m/s", direct=())

    angles: tuple[float, ...]
    """Steering-wheel angles [rad] at t = 0, dt, 2 dt, ..."""
    speeds: tuple[float, ...]
    """Speeds [m/s] at the same times."""
    delay: Scalar = 0.0
    """How much later the angle acts [s]; below 0: earlier."""
    dt: float = 0.01

    def __post_init__(self) -> None:
        where = "Playback"
        _ = self._table
        require_within(where, "delay", self.delay, "s", -10.0, 10.0)
        require_within(where, "dt", self.dt, "s", 1e-6, 1.0)

    @cached_property
    def _table(self) -> Table:
        """A row from each sample to the next: angle, its rise, speed, its rise."""
        return _recorded(tuple(self.angles), tuple(self.speeds))

    def output(self, t: Any, x: Any, u: Any) -> Any:
        i, part = self._place(t - self.delay)
        angle, rise, _, _ = self._table(i)
        k, share = self._place(t)
        _, _, speed, gain = self._table(k)
        return self.Y(angle + part * rise, speed + share * gain)

    def _place(self, t: Scalar) -> tuple[Scalar, Scalar]:
        """The row for time t, and how far into it, 0 to 1."""
        z = m.clip(t / self.dt + 1e-9, 0.0, float(len(self._table)))
        i = m.minimum(m.floor(z), float(len(self._table)) - 1.0)
        return i, z - i


@lru_cache(maxsize=4)
def _recorded(angles: tuple[float, ...], speeds: tuple[float, ...]) -> Table:
    """The table of a recording, checked; one for all delays that it is played back with."""
    where, n = "Playback", len(angles)
    require(n == len(speeds) >= 2, where, f"{n} angles, {len(speeds)} speeds, expected equally many, >= 2")
    angle, speed = np.array(angles), np.array(speeds)
    require_within(where, "angles", angle, "rad", -100.0, 100.0)
    require_within(where, "speeds", speed, "m/s", 0.0, 100.0)
    return Table(np.column_stack((angle[:-1], np.diff(angle), speed[:-1], np.diff(speed))))
