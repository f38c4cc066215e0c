"""A human who slows down for bends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Table
from steerkit.paths.path import Array, Path
from steerkit.plants.speed_driver import SpeedDriver
from steerkit.task import A_Y_MAX


@dataclass(frozen=True, eq=False, kw_only=True)
class CurveSpeedDriver(Block):
    """Wraps a human so that bends are taken at no more than a comfortable lateral acceleration.

    v = min(v of `human`, ceiling(s)),  ceiling(s)^2 <= a_y_max/|kappa(s')| + 2 a_x_max |s - s'|  for every s',

    so that braking for a bend and leaving it both cost at most a_x_max. The ceiling is tabled every metre.

    Input: s [m] along `path` (a `PathTracker`'s). Output: v [m/s]. State: that of `human`. Valid for s on the path.
    Raises ValueError unless a_y_max and a_x_max are positive. Source: the curvature-speed bound |kappa| <= a_y/v^2
    of ISO 11270:2014 (a_y at most 3 m/s^2), with the forward and backward pass of Kapania et al. 2016.
    """

    s = In("m")
    v = Out("m/s")

    path: Path
    """The course."""
    driver: SpeedDriver
    """Who sets the speed where there is no bend."""
    a_y_max: float = A_Y_MAX
    """Largest lateral acceleration in a bend [m/s^2]."""
    a_x_max: float = 1.5
    """Largest acceleration and braking for it [m/s^2]."""

    def __post_init__(self) -> None:
        require(
            self.a_y_max > 0.0 and self.a_x_max > 0.0, "CurveSpeedDriver", "a_y_max and a_x_max, expected > 0 m/s^2"
        )
        require(
            self.dt == self.driver.dt, "CurveSpeedDriver", f"dt = {self.dt} s, but its human has {self.driver.dt} s"
        )

    @cached_property
    def _ceiling(self) -> Table:
        """Rows of ceiling [m/s] and its rise to the next row."""
        v = ceiling(self.path, self.a_y_max, self.a_x_max)
        return Table(np.column_stack((v, np.roll(v, -1) - v if self.path.closed else np.append(np.diff(v), 0.0))))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return self.driver.init(batch)

    def output(self, t: Any, x: State, u: Any) -> Any:
        rows = float(len(self._ceiling))
        z = m.clip(u.s * (rows / self.path.length), 0.0, rows)
        i = m.minimum(m.where(m.is_finite(z), m.floor(z), 0.0), rows - 1.0)
        start, rise = self._ceiling(i)
        return self.Y(m.minimum(start + (z - i) * rise, self.driver.output(t, x, ())[0]))  # a NaN in s stays NaN

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return self.driver.update(t, x, (), ())


def ceiling(path: Path, a_y_max: float, a_x_max: float, limit: Array | None = None) -> Array:
    """Fastest speed [m/s] about every metre of a path, (n,) at s = k length/n, as in `CurveSpeedDriver`.

    a_y_max, a_x_max [m/s^2]; limit: speed that is allowed there besides (n,) [m/s].
    """
    n = max(2, round(path.length))
    ds = path.length / n
    kappa = np.abs(path.kappa(np.linspace(0.0, path.length, n, endpoint=False)))
    bound = a_y_max / np.maximum(kappa, 1e-4)
    if limit is not None:
        bound = np.minimum(bound, limit * limit)
    v2: list[float] = bound.tolist()  # an array is slow entry by entry
    gain = 2.0 * a_x_max * ds
    rounds = 2 if path.closed else 1  # the second carries a ceiling across the start
    for _ in range(rounds):
        for i in range(0 if path.closed else 1, n):  # leaving a bend
            v2[i] = min(v2[i], v2[i - 1] + gain)
        for i in range(n - 1 if path.closed else n - 2, -1, -1):  # braking for one
            v2[i] = min(v2[i], v2[(i + 1) % n] + gain)
    return np.asarray(np.sqrt(v2))
