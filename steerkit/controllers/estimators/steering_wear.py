"""Friction and free play of the steering, from the loops that they leave between an angle and what follows it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from steerkit import maths as m
from steerkit.block import Block, In, Out, State
from steerkit.controllers.estimators.bank import Weighed, fits, learned, size, valley
from steerkit.controllers.estimators.way import arrived
from steerkit.controllers.estimators.yaw_model import SLOWEST, steady_gain, yaw_step
from steerkit.errors import require, require_within, whole_samples
from steerkit.maths import Scalar
from steerkit.units import radians_of
from steerkit.vehicles import Vehicle, require_vehicle

_GAIN = 1.0 / 0.3**2
"""Precision of the response's gain, 1 +- 0.3."""
_LATE = 1.0 / 0.1**2
"""Precision of the delay that is still wrong, 0 +- 0.1 s [1/s^2]."""
_CANDIDATES = 9
_MOMENTS, _FILTERS = size(2), 14
_SETTLED = 3.0
"""How long the commands have to have acted before they teach [s]: the operators have to get at an end of their gaps."""
_UNTOLD = radians_of(0.06)
"""Deviation for what lies between samples and is no play operator [rad]."""
_SHARE, _LEAST = 0.1, radians_of(0.1)
"""Valid: the deviation is at most this share of the gap, or this [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GapBank(Block):
    """The half width of the loop that a play operator leaves, by least squares for a bank of widths; abstract.

    x is `angle` behind `lag` and `delay`, held for dt. For each candidate half width g = 0, widest/8, ... widest, with
    P_g x = x - clip(x - P_g x(t - dt), -g, g) the play operator,

        response(t) = a P_g x(t) + b x'(t) + constant

    is regressed as in `DelayBank`, with priors a = 1 +- 0.3, b = 0 +- 0.1 s, g = prior +- prior_deviation. The loop of
    a delay that is told wrong grows with the wheel's speed, that of a gap does not, which tells them apart. A parabola
    through the lowest cost and its neighbours gives g and its variance; where more is left over than the noise
    explains, the deviation grows by that; and `per_lag` times lag_deviation is in it, as a lag that is taken for delay
    leaves a loop that hardly differs from a gap's. Without steering to and fro the prior stays.

    A sample teaches where all is finite, v is 3 m/s or more, and `active` was 1 for 3 s. Valid: the deviation is at
    most a tenth of the value, or 0.1 degrees, and half of the response's variance is explained.

    Inputs: angle [rad]; delay, lag, lag_deviation [s]; v [m/s]; active [1]. State: filters, the angles on their way,
    the operators, moments. Raises ValueError for parameters out of range. Source: as for `SteeringColumn` (Nordin,
    Gutman 2002; Visintin 1994) and `DelayBank`.
    """

    angle = In("rad", direct=False)
    delay = In("s", direct=False)
    lag = In("s", direct=False)
    lag_deviation = In("s", direct=False)
    v = In("m/s", direct=False)
    active = In("1", direct=False)

    prior: float = radians_of(0.5)
    """Half width to begin with [rad], 0 to widest."""
    prior_deviation: float = radians_of(0.5)
    """Its standard deviation [rad]."""
    widest: float = radians_of(1.6)
    """Largest half width that is tried [rad]."""
    memory: float = 600.0
    """Seconds of driving that taught, after which their weight has fallen to 1/e."""
    correlated: float = 0.15
    """For how long the errors of the response hang together [s], dt at least."""
    per_lag: float = radians_of(9.0)
    """By how much the half width is off, for each second of a lag that is taken for delay [rad/s]."""
    longest: float = 1.0
    """Longest delay [s], a multiple of dt; a longer one is taken for this."""
    held: bool = True
    """Is the angle a command, held for dt? Else it is measured, and at least dt late."""

    def __post_init__(self) -> None:
        where = type(self).__name__
        require_within(where, "dt", self.dt, "s", 1e-3, 0.2)
        longest = whole_samples(where, "longest", self.longest, self.dt)
        require(1 <= longest <= 100, where, f"longest = {self.longest} [s], expected 1 to 100 samples of {self.dt:g} s")
        require_within(where, "widest", self.widest, "rad", 1e-4, 1.0, "radians: radians_of(1.6)")
        require_within(where, "prior", self.prior, "rad", 0.0, self.widest, "0 to widest")
        require_within(where, "prior_deviation", self.prior_deviation, "rad", 1e-6, 1.0)
        require_within(where, "per_lag", self.per_lag, "rad/s", 0.0, 10.0, "radians: radians_of(9)")
        require_within(where, "memory", self.memory, "s", 1.0, 1e6)
        require_within(where, "correlated", self.correlated, "s", self.dt, 10.0, "at least dt")

    @cached_property
    def _line(self) -> int:
        return round(self.longest / self.dt) + 1

    @property
    def _step(self) -> float:
        return self.widest / (_CANDIDATES - 1)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero = m.filled(0.0, batch)
        rest = self._line + _CANDIDATES * (1 + _MOMENTS)
        return (*(zero,) * 7, m.filled(SLOWEST, batch), *(zero,) * (_FILTERS - 8 + rest))

    def _front(self, x: State, tap: Scalar, v: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """(beta, r) of the car's model and x, of the next sample; `tap` is the angle that arrives then."""
        return x[9], x[10], tap

    def _learn(self, x: State, u: Any, response: Scalar, weight: Scalar, read: Scalar) -> State:
        """The next state. response [rad] and weight [1/rad^2] of this sample; read: was it finite?"""
        n, dt = self._line, self.dt
        held, since, _, *sums, speed, _, _, _, front, rate, split = x[:_FILTERS]
        line, behind = x[_FILTERS : _FILTERS + n], x[_FILTERS + n : _FILTERS + n + _CANDIDATES]
        told = m.every(*map(m.is_finite, (u.delay, u.lag, u.lag_deviation)))
        known = m.both(m.is_finite(u.angle), told)
        read = m.every(read, known, m.is_finite(u.v), m.is_finite(u.active))
        acts = m.both(known, u.active > 0.5)
        teaches = m.every(read, since * dt > _SETTLED, acts, u.v >= SLOWEST)
        weighed, moments = learned(
            Weighed._make(sums),
            x[_FILTERS + n + _CANDIDATES :],
            [(twisted, rate) for twisted in behind],
            response,
            weight=weight,
            share=dt / self.correlated,
            keep=math.exp(-dt / self.memory),
            teaches=teaches,
        )
        # the next sample's angle and what the operators make of it
        held = m.where(m.is_finite(u.angle), u.angle, held)
        speed = m.where(m.is_finite(u.v), m.maximum(u.v, SLOWEST), speed)
        delay, lag = m.where(told, u.delay, 0.0), m.where(told, m.clip(u.lag, 0.0, 2.0), 0.0)
        line, tap = arrived(line, held, delay - (0.0 if self.held else dt), lag, dt)
        beta, r, after = self._front(x, tap, speed)
        gaps = [i * self._step for i in range(_CANDIDATES)]
        behind = tuple([after - m.clip(after - before, -gap, gap) for before, gap in zip(behind, gaps)])
        since = m.where(acts, m.minimum(since + 1.0, 1e6), 0.0)
        missing = m.where(read, 0.0, 1.0)
        filters = (held, since, missing, *weighed, speed, tap, beta, r)
        split = m.where(m.is_finite(u.lag_deviation), u.lag_deviation, split)
        return (*filters, after, (after - front) / dt, split, *line, *behind, *moments)

    def _found(self, x: State) -> tuple[Scalar, Scalar, Scalar]:
        """The half width [rad], its deviation [rad] and its validity."""
        moments = x[_FILTERS + self._line + _CANDIDATES :]
        saved = [fit.saved for fit in fits(moments, (_GAIN, _LATE), (1.0, 0.0))]
        sums = Weighed._make(x[3:7])
        best, excess, explained = valley(sums, saved, self._step, self.prior, self.prior_deviation)
        width, aside = best.place * self._step, self.per_lag * x[13]
        deviation = m.sqrt(excess * best.variance * self._step**2 + _UNTOLD**2 + aside * aside)
        precise = deviation <= m.maximum(_SHARE * width, _LEAST)
        return width, deviation, m.where(m.both(precise, explained), 1.0, 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringFriction(GapBank):
    """The twist that friction holds between motor and steering wheel, from the command against the measured wheel.

    As `GapBank` says, with angle = the command, delay and lag those of the motor (`WheelDelay`), response =
    delta_sw_meas. friction [rad] is what `SteeringColumn` calls so: half the loop's width.

    Inputs: angle, delta_sw_meas [rad]; delay, lag, lag_deviation [s]; v [m/s]; active [1]. Outputs, of state only:
    friction, friction_deviation [rad]; friction_valid, missing [1], the last 1 where the sample before held a NaN.
    """

    delta_sw_meas = In("rad", direct=False)
    friction = Out("rad", direct=())
    friction_deviation = Out("rad", direct=())
    friction_valid = Out("1", direct=())
    missing = Out("1", direct=())

    noise: float = radians_of(0.1)
    """Standard deviation of delta_sw_meas about what friction leaves of the command [rad]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("SteeringFriction", "noise", self.noise, "rad", 1e-6, 1.0, "radians: radians_of(0.1)")

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*self._found(x), x[2])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return self._learn(x, u, u.delta_sw_meas, 1.0 / self.noise**2, m.is_finite(u.delta_sw_meas))


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringPlay(GapBank):
    """The free play of the steering, from the steering wheel's angle against the yaw rate.

    As `GapBank` says, with angle = the measured wheel, delay = the age of r, lag = 0; or with the command and the delay
    and lag of `YawDelay`, and then friction and play are found as one, nearly their sum. x is behind the linear single
    track of the data sheet, response = r n (L + K v^2)/v. play [rad] is the whole loop, as `SteeringColumn` has it.

    Inputs: angle [rad]; delay, lag, lag_deviation [s]; v [m/s]; r [rad/s]; active [1]. Outputs, of state only: play,
    play_deviation [rad]; play_valid, missing [1], the last 1 where the sample before held a NaN.
    """

    r = In("rad/s", direct=False)
    play = Out("rad", direct=())
    play_deviation = Out("rad", direct=())
    play_valid = Out("1", direct=())
    missing = Out("1", direct=())

    vehicle: Vehicle
    """The car by its data sheet."""
    held: bool = False
    noise: float = radians_of(0.2)
    """Standard deviation of the white noise on r [rad/s]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vehicle(self.vehicle, "SteeringPlay")
        require_within("SteeringPlay", "noise", self.noise, "rad/s", 1e-6, 1.0, "radians: radians_of(0.2)")

    def output(self, t: Any, x: State, u: Any) -> Any:
        width, deviation, valid = self._found(x)
        return self.Y(2.0 * width, 2.0 * deviation, valid, x[2])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        gain = steady_gain(self.vehicle, x[7])
        return self._learn(x, u, u.r / gain, gain * gain / self.noise**2, m.is_finite(u.r))

    def _front(self, x: State, tap: Scalar, v: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        beta, r = yaw_step(self.vehicle, x[9], x[10], 0.5 * (x[8] + tap) / self.vehicle.steer_ratio, v, self.dt)
        return beta, r, r / steady_gain(self.vehicle, v)
