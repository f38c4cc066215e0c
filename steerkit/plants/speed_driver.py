"""Drivers who set the speed: wandering, steady, by place, careful in bends; and a recorded drive played back."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from steerkit._support.errors import number, require, require_within
from steerkit._support.random import normals, seed_state
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Array, Scalar, Table
from steerkit.paths.path import Path
from steerkit.task import A_Y_MAX

_STREAM = 1  # of `seed_state`: the drivers'
_FASTEST = 60.0  # m/s


@dataclass(frozen=True, eq=False, kw_only=True)
class SpeedDriver(Block):
    """A driver whose speed wanders between two bounds, continuously and with bounded acceleration.

    z(t + dt) = f z(t) + sqrt(1 - f^2) n,  f = exp(-dt/wander_time),  n standard normal   (Ornstein-Uhlenbeck)
    g(t + dt) = a g(t) + (1 - a) z(t),  a = exp(-dt/foot_time)                            (the pedal's lag)
    v = (v_min + v_max)/2 + (v_max - v_min)/2 tanh(g/s),  s^2 = the stationary variance of g,

    so that v never leaves [v_min, v_max], and |v'| is typically (v_max - v_min)/(2 sqrt(wander_time*foot_time)),
    0.4 m/s^2 by default.

    no inputs. output, of state only: v [m/s]. state: z, g, the random generator's six numbers; it starts anywhere in
    the stationary distribution. In a batch, car i draws as a driver of seed + i does; v_min and v_max may be `(N,)`
    arrays. source: Uhlenbeck, Ornstein 1930; Gillespie 1996 (exact discretisation).
    """

    v = Out("m/s", direct=())

    v_min: Scalar = number(4.0, "m/s", low=0.0, high=_FASTEST)
    """Slowest speed [m/s]."""
    v_max: Scalar = number(7.5, "m/s", low=0.0, high=_FASTEST)
    """Fastest speed [m/s]."""
    wander_time: float = number(10.0, "s", above=0.0, high=1e4)
    """Correlation time of the intended speed [s]."""
    foot_time: float = number(2.0, "s", above=0.0, high=1e4)
    """Time constant of the pedal [s]."""
    seed: int = 0
    """Seed of the random numbers."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("SpeedDriver", "v_max", self.v_max, "m/s", self.v_min, _FASTEST, "at least v_min")
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
    """A driver who keeps one speed: v = speed.

    no inputs. output, and state: v [m/s]. errors: ValueError for a speed out of range.
    """

    v = Out("m/s", direct=())

    speed: Scalar = number(5.0, "m/s", low=0.0, high=_FASTEST)
    """The speed [m/s]; an `(N,)` array for a batch of different drivers."""

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(self.speed, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0])


@dataclass(frozen=True, eq=False, kw_only=True)
class SpeedProfile(Block):
    """A driver with a speed for each place of the course: v(p), linear between samples every `spacing` [m].

    input: progress [m] along the path (a `PathTracker`'s). output: v [m/s]. no state. Beyond the ends the speeds
    hold, or with `repeat` the profile begins again, for rounds: `spacing*(len(speeds) - 1)` should be the course's
    length. A NaN progress gives NaN. errors: ValueError for speeds, spacing or dt out of range.
    """

    progress = In("m")
    v = Out("m/s")

    speeds: tuple[float, ...]
    """Speeds [m/s] at p = 0, spacing, 2 spacing, ...; two at least."""
    spacing: float = number(unit="m", low=1e-6, high=1e6)
    """Distance between them [m]."""
    repeat: bool = False
    """After the last sample, go on with the first (which it should equal)? Otherwise hold the last."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where = "SpeedProfile"
        require(np.ndim(self.speeds) == 1 and len(self.speeds) >= 2, where, "speeds, expected two numbers or more")
        require_within(where, "speeds", np.asarray(self.speeds), "m/s", 0.0, _FASTEST)

    @cached_property
    def _table(self) -> Table:
        return m.rising(self.speeds)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        n, z = float(len(self._table)), u.progress / self.spacing
        return self.Y(m.between(self._table, z - n * m.floor(z / n) if self.repeat else m.clip(z, 0.0, n)))


@dataclass(frozen=True, eq=False, kw_only=True)
class CurveSpeedDriver(Block):
    """Wraps a driver so that bends are taken at no more than a comfortable lateral acceleration.

    v = min(v of `driver`, ceiling(s)),  ceiling(s)^2 <= a_y_max/|kappa(s')| + 2 a_x_max |s - s'|  for every s',

    so that braking for a bend and leaving it both cost at most a_x_max. The ceiling is tabled every metre.

    Input: s [m] along `path` (a `PathTracker`'s). Output: v [m/s]. State: that of `driver`. Valid for s on the path.
    Raises ValueError unless a_y_max and a_x_max are positive. Source: the curvature-speed bound |kappa| <= a_y/v^2
    of ISO 11270:2014 (a_y at most 3 m/s^2), with the forward and backward pass of Kapania et al. 2016.
    """

    s = In("m")
    v = Out("m/s")

    path: Path
    """The course."""
    driver: SpeedDriver
    """The driver who sets the speed where there is no bend."""
    a_y_max: float = number(A_Y_MAX, "m/s^2", above=0.0)
    """Largest lateral acceleration in a bend [m/s^2]."""
    a_x_max: float = number(1.5, "m/s^2", above=0.0)
    """Largest acceleration and braking for it [m/s^2]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        dt = self.driver.dt
        require(self.dt == dt, "CurveSpeedDriver", f"dt = {self.dt} s, but its driver has {dt} s")

    @cached_property
    def _ceiling(self) -> Table:
        v = ceiling(self.path, self.a_y_max, self.a_x_max)
        return m.rising(np.append(v, v[0] if self.path.closed else v[-1]))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return self.driver.init(batch)

    def output(self, t: Any, x: State, u: Any) -> Any:
        rows = float(len(self._ceiling))
        most = m.between(self._ceiling, m.clip(u.s * (rows / self.path.length), 0.0, rows))
        return self.Y(m.minimum(most, self.driver.output(t, x, ())[0]))  # a NaN in s stays NaN

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


@dataclass(frozen=True, eq=False, kw_only=True)
class Playback(Block):
    """A recorded drive: steering-wheel angle and speed every dt, linear in between; the angle `delay` later.

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
    delay: Scalar = number(0.0, "s", low=-10.0, high=10.0)
    """How much later the angle acts [s]; below 0: earlier."""
    dt: float = number(0.01, "s", above=0.0, high=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        where, n = "Playback", len(self.angles)
        require(n == len(self.speeds) >= 2, where, f"{n} angles, {len(self.speeds)} speeds, expected as many, >= 2")
        require_within(where, "angles", np.array(self.angles), "rad", -100.0, 100.0)
        require_within(where, "speeds", np.array(self.speeds), "m/s", 0.0, 100.0)

    @cached_property
    def _table(self) -> Table:
        return _recorded(self.angles, self.speeds)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(self._at(t - self.delay, 0), self._at(t, 1))

    def _at(self, t: Scalar, column: int) -> Scalar:
        """A column of the record at time t [s]."""
        return m.between(self._table, m.clip(t / self.dt + 1e-9, 0.0, float(len(self._table))), column)


@lru_cache(maxsize=4)
def _recorded(angles: tuple[float, ...], speeds: tuple[float, ...]) -> Table:
    """A record's table: identification plays the same record a hundred times, each time with another delay."""
    return m.rising(angles, speeds)
