"""The human at the pedals, who sets the speed: wandering, recorded, or steady."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from steerkit._support.errors import require, require_within
from steerkit._support.random import normals, seed_state
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar, Table
from steerkit.task import DT

_STREAM = 1  # of `seed_state`: the humans'
_FASTEST = 60.0  # m/s


@dataclass(frozen=True, eq=False, kw_only=True)
class SpeedDriver(Block):
    """A human who wanders between two speeds, with a bounded and continuous pace.

    z(t + dt) = f z(t) + sqrt(1 - f^2) n,  f = exp(-dt/wander_time),  n standard normal   (Ornstein-Uhlenbeck)
    g(t + dt) = a g(t) + (1 - a) z(t),  a = exp(-dt/foot_time)                            (the foot lags behind)
    v = (v_min + v_max)/2 + (v_max - v_min)/2 tanh(g/s),  s^2 = the stationary variance of g,

    so that v never leaves [v_min, v_max], and |v'| is typically (v_max - v_min)/(2 sqrt(wander_time*foot_time)),
    0.4 m/s^2 by default.

    no inputs. output, of state only: v [m/s]. state: z, g, the random generator's six numbers; it starts anywhere in
    the stationary distribution. In a batch, car i draws as a human of seed + i does; v_min and v_max may be `(N,)`
    arrays. errors: ValueError for parameters out of range. source: Uhlenbeck, Ornstein 1930; Gillespie 1996 (exact
    discretisation).
    """

    v = Out("m/s", direct=())

    v_min: Scalar = 4.0
    """Slowest speed [m/s]."""
    v_max: Scalar = 7.5
    """Fastest speed [m/s]."""
    wander_time: float = 10.0
    """Correlation time of the speed that the human has in mind [s]."""
    foot_time: float = 2.0
    """Time constant of the foot [s]."""
    seed: int = 0
    """Seed of the random numbers."""
    dt: float = DT

    def __post_init__(self) -> None:
        where = "SpeedDriver"
        require_within(where, "v_min", self.v_min, "m/s", 0.0, _FASTEST)
        require_within(where, "v_max", self.v_max, "m/s", self.v_min, _FASTEST, "at least v_min")
        require_within(where, "dt", self.dt, "s", 1e-6, 1.0)
        for name in ("wander_time", "foot_time"):
            require_within(where, name, getattr(self, name), "s", 2.0 * self.dt, 1e4, "at least 2 dt")
        seed_state(self.seed)

    @cached_property
    def _moments(self) -> tuple[float, float, float, float, float]:
        """f, sqrt(1 - f^2), a, and the stationary covariance of g with z and with itself."""
        f, a = math.exp(-self.dt / self.wander_time), math.exp(-self.dt / self.foot_time)
        cross = (1.0 - a) * f / (1.0 - a * f)
        variance = (2.0 * a * cross + 1.0 - a) / (1.0 + a)
        return f, math.sqrt(1.0 - f * f), a, cross, variance

    def init(self, batch: tuple[int, ...] = ()) -> State:
        _, _, _, cross, variance = self._moments
        n1, n2, random = normals(seed_state(self.seed, batch, stream=_STREAM))
        return (n1, cross * n1 + math.sqrt(variance - cross * cross) * n2, *random)

    def output(self, t: Any, x: State, u: Any) -> Any:
        half = 0.5 * (self.v_max - self.v_min)
        return self.Y(self.v_min + half * (1.0 + m.tanh(x[1] / math.sqrt(self._moments[4]))))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        f, spread, a, _, _ = self._moments
        z, g, *random = x
        n, _, after = normals(tuple(random))
        return (f * z + spread * n, a * g + (1.0 - a) * z, *after)


@dataclass(frozen=True, eq=False, kw_only=True)
class ConstantSpeed(Block):
    """A human who keeps one speed: v = speed.

    no inputs. output, and state: v [m/s]. errors: ValueError for a speed out of range.
    """

    v = Out("m/s", direct=())

    speed: Scalar = 5.0
    """The speed [m/s]; an `(N,)` array for a batch of different humans."""
    dt: float = DT

    def __post_init__(self) -> None:
        require_within("ConstantSpeed", "speed", self.speed, "m/s", 0.0, _FASTEST)
        require_within("ConstantSpeed", "dt", self.dt, "s", 1e-6, 1.0)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(self.speed, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0])


@dataclass(frozen=True, eq=False, kw_only=True)
class _Profile(Block):
    """A speed looked up between evenly spaced samples; abstract. `v(p)` is linear between `speeds`."""

    speeds: tuple[float, ...]
    """Speeds [m/s] at p = 0, spacing, 2 spacing, ...; two at least."""
    spacing: float
    """Distance between them, in the unit of what they are recorded over."""
    repeat: bool = False
    """After the last sample, go on with the first (which it should equal)? Otherwise hold the last."""
    dt: float = DT

    def __post_init__(self) -> None:
        where = type(self).__name__
        require(np.ndim(self.speeds) == 1 and len(self.speeds) >= 2, where, "speeds, expected two numbers or more")
        require_within(where, "speeds", np.asarray(self.speeds), "m/s", 0.0, _FASTEST)
        require_within(where, "spacing", self.spacing, "s or m", 1e-6, 1e6)
        require_within(where, "dt", self.dt, "s", 1e-6, 1.0)

    @classmethod
    def from_samples(cls, at: ArrayLike, speeds: ArrayLike, *, spacing: float = 0.1, repeat: bool = False) -> Self:
        """The human of an unevenly spaced record: `speeds` [m/s] at rising `at`, made even every `spacing` or less.

        `at` counts from its first entry. Raises ValueError for different lengths or an `at` that does not rise.
        """
        p, v = np.asarray(at, dtype=float), np.asarray(speeds, dtype=float)
        rising = p.ndim == 1 and p.shape == v.shape and len(p) >= 2 and bool((np.diff(p) > 0.0).all())
        require(rising, cls.__name__, f"at {p.shape} and speeds {v.shape}, expected equally long, at rising strictly")
        require_within(cls.__name__, "spacing", spacing, "s or m", 1e-6, 1e6)
        even = np.linspace(p[0], p[-1], 1 + max(1, math.ceil((p[-1] - p[0]) / spacing - 1e-9)))
        return cls(speeds=tuple(np.interp(even, p, v).tolist()), spacing=float(even[1] - even[0]), repeat=repeat)

    @cached_property
    def _table(self) -> Table:
        return Table(np.column_stack((self.speeds[:-1], np.diff(self.speeds))))

    def _speed(self, p: Scalar) -> Scalar:
        """v at p; a NaN p gives NaN."""
        n = float(len(self._table))
        z = p / self.spacing
        z = z - n * m.floor(z / n) if self.repeat else m.clip(z, 0.0, n)
        i = m.clip(m.where(m.is_finite(z), m.floor(z), 0.0), 0.0, n - 1.0)
        start, rise = self._table(i)
        return start + (z - i) * rise


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedSpeed(_Profile):
    """A human who repeats a record of speed over time: v(t + start), linear between samples every `spacing` [s].

    no inputs. output: v [m/s]. state: start [s]. Before the first and after the last sample their speeds hold, or
    with `repeat` the record begins again. errors: ValueError for speeds, spacing, start or dt out of range.
    """

    v = Out("m/s", direct=())

    start: Scalar = 0.0
    """Where in the record to begin [s]; an `(N,)` array for a batch of cars at different places of it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("RecordedSpeed", "start", self.start, "s", -1e6, 1e6)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(self.start, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(self._speed(t + x[0]))


@dataclass(frozen=True, eq=False, kw_only=True)
class SpeedProfile(_Profile):
    """A human who knows the course: speed over progress, v(p), linear between samples every `spacing` [m].

    input: progress [m] along the path (a `PathTracker`'s). output: v [m/s]. no state. Beyond the ends the speeds
    hold, or with `repeat` the profile begins again, for rounds: `spacing*(len(speeds) - 1)` should be the course's
    length. A NaN progress gives NaN. errors: ValueError for speeds, spacing or dt out of range.
    """

    progress = In("m")
    v = Out("m/s")

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(self._speed(u.progress))
