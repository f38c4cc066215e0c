"""Dead time and lag of the steering, from the commands and what the car makes of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

from steerkit._support.errors import require, require_within, whole_samples
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.estimators.bank import Weighed, at, fits, learned, size, valley
from steerkit.estimators.yaw_model import SLOWEST, steady_gain, yaw_delay, yaw_step
from steerkit.task import STOP
from steerkit.vehicles import Vehicle, require_vehicle

_GAP = radians_of(1.0)
"""Half of the free play whose loop is a regressor [rad]."""
_GAIN, _SHARE = 1.0 / 0.3**2, 1.0 / 0.5**2
"""Precisions of the gain, 1 +- 0.3, and of the share of that free play which the car has."""
_NO_SINGLE_LAG = 0.01
"""Deviation of delay and of lag for what is no single lag, with their sum the same [s]."""
_CUBIC = 0.06
"""Deviation of the sum over how far the lag is from the prior's: the regression knows two moments of the answer."""
_TIMING = 0.0015
"""Deviation of all delays for what happens between samples [s]."""
_LEAST_GAIN = 0.3
_FILTERS, _MOMENTS = 16, size(3)


class _Followed(NamedTuple):
    """What a command comes to a sample later."""

    wheel: Scalar
    """Behind the lag [rad]."""
    behind: Scalar
    """That, behind the free play [rad]."""
    car: tuple[Scalar, Scalar]
    """(beta, r) of the car's model under the one and the other."""
    worn_car: tuple[Scalar, Scalar]
    w: Scalar
    """What the response should be [rad], and what of it the free play takes."""
    h: Scalar


@dataclass(frozen=True, eq=False, kw_only=True)
class DelayBank(Block):
    """Dead time and lag of what follows the steering commands, by least squares for a bank of dead times; abstract.

    With w the commands behind a lag L0 = prior_lag (and the car), s = dw/dL0 = -(w - w')/L0 where w' is w behind that
    lag once more, and h what a free play of 2 degrees between motor and car takes of w, each candidate d = 0, dt, ...
    longest regresses

        response(t) = a (w - worn h)(t - d) + b s(t - d) + c h(t - d) + constant

    by recursive least squares, with forgetting over `memory` seconds that taught. Its cost U(d) is the weighted sum of
    squares left over and the priors' (a = 1 +- 0.3, b = 0 +- prior_lag_deviation, c = 0 +- 0.5, d = prior_delay +-
    prior_delay_deviation). A parabola through the lowest U and its neighbours gives the delay between samples and, by
    its curvature, the variance. Delay and lag are those with the regression's first two moments: with B = b/a their sum
    is d + L0 + B, and L = sqrt(L0^2 + 2 L0 B - B^2): near L0 + B, 1.4 L0 at most, drawn to L0 where it is short.
    Without excitation U is the priors'
    own parabola, so they come out. Where more is left over than the noise explains, deviations grow by that.

    A sample teaches where all is finite, v is 3 m/s or more, and for longest + 4 L0 + 0.3 s the commands have acted:
    `active` was 1, |delta_sw_cmd| at most `limit`, no faster than `rate_limit`. Else nothing changes or is forgotten.

    Outputs, of state only: delay, delay_deviation, lag, lag_deviation, and of their sum delay_lag, delay_lag_deviation
    [s]; delay_valid, lag_valid, delay_lag_valid [1]; missing [1]: 1 where the last sample held a NaN. The sum is known
    far better than its parts, which only fast steering tells apart. Valid: the deviation is at most `enough` (twice
    that for the parts), and the commands explain half of the response's variance. State: filters, delay lines, moments.
    Raises ValueError for parameters out of range.

    Source: Ljung 1999, sections 7.3 and 11.2 (regression, forgetting); Golub, Pereyra 1973 (linear parameters solved
    for). openpilot's lag estimation (comma.ai 2025) has the same task and correlates two accelerations.
    """

    delta_sw_cmd = In("rad", direct=False)
    active = In("1", direct=False)
    delay = Out("s", direct=())
    delay_deviation = Out("s", direct=())
    delay_valid = Out("1", direct=())
    lag = Out("s", direct=())
    lag_deviation = Out("s", direct=())
    lag_valid = Out("1", direct=())
    delay_lag = Out("s", direct=())
    delay_lag_deviation = Out("s", direct=())
    delay_lag_valid = Out("1", direct=())
    missing = Out("1", direct=())

    prior_delay: float = 0.15
    """Dead time to begin with [s], 0 to longest."""
    prior_delay_deviation: float = 0.2
    """Its standard deviation [s]."""
    prior_lag: float = 0.2
    """Lag to begin with [s]."""
    prior_lag_deviation: float = 0.06
    """Its standard deviation [s]."""
    longest: float = 0.75
    """Longest dead time that is tried [s], a multiple of dt."""
    memory: float = 120.0
    """Seconds of driving that taught, after which their weight has fallen to 1/e."""
    correlated: float = 0.15
    """For how long the errors of the response hang together [s], dt at least: what free play and roads add to noise."""
    enough: float = 0.02
    """Deviation from which on the sum is valid [s]."""
    limit: float = STOP
    """Largest command that is followed [rad]."""
    rate_limit: float = radians_of(550.0)
    """Fastest command that is followed [rad/s]."""

    worn: ClassVar[float] = 0.0
    """Share of that free play which is expected between command and response."""

    def __post_init__(self) -> None:
        where = type(self).__name__
        require_within(where, "dt", self.dt, "s", 1e-3, 0.2)
        longest = whole_samples(where, "longest", self.longest, self.dt)
        require(2 <= longest <= 60, where, f"longest = {self.longest} [s], expected 2 to 60 samples of {self.dt:g} s")
        require_within(where, "prior_delay", self.prior_delay, "s", 0.0, self.longest, "0 to longest")
        require_within(where, "prior_lag", self.prior_lag, "s", 0.01, 1.0)
        for name, high in (("prior_delay_deviation", 5.0), ("prior_lag_deviation", 1.0), ("enough", 1.0)):
            require_within(where, name, getattr(self, name), "s", 1e-4, high)
        require_within(where, "memory", self.memory, "s", 1.0, 1e6)
        require_within(where, "correlated", self.correlated, "s", self.dt, 10.0, "at least dt")
        require_within(where, "limit", self.limit, "rad", 1e-3, 30.0, "radians: radians_of(520)")
        require_within(where, "rate_limit", self.rate_limit, "rad/s", 1e-3, 200.0, "radians: radians_of(550)")

    @cached_property
    def _count(self) -> int:
        return round(self.longest / self.dt) + 1

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero = m.filled(0.0, batch)
        return (*(zero,) * 6, m.filled(SLOWEST, batch), *(zero,) * (_FILTERS - 7 + self._count * (3 + _MOMENTS)))

    def _follow(self, x: State, command: Scalar, v: Scalar) -> _Followed:
        """What the command comes to in the next sample."""
        keep = math.exp(-self.dt / self.prior_lag)
        wheel = keep * x[7] + (1.0 - keep) * command
        behind = wheel - m.clip(wheel - x[12], -_GAP, _GAP)
        return _Followed(wheel, behind, (x[8], x[9]), (x[14], x[15]), wheel, wheel - behind)

    def _learn(self, x: State, u: Any, response: Scalar, weight: Scalar, v: Scalar, read: Scalar) -> State:
        """The next state. response [rad] and weight [1/rad^2] of this sample; read: were its inputs all finite?"""
        n = self._count
        before, since, _, *sums, _, wheel, _, _, w, again, behind, power, _, _ = x[:_FILTERS]
        lines = [x[_FILTERS + i * n : _FILTERS + (i + 1) * n] for i in range(3)]
        known = m.is_finite(u.delta_sw_cmd)
        command = m.where(known, u.delta_sw_cmd, before)
        calm = m.both(m.absolute(command) <= self.limit, m.absolute(command - before) <= self.rate_limit * self.dt)
        acts = m.every(u.active > 0.5, known, calm, v >= SLOWEST)
        teaches = m.every(since * self.dt > self.longest + 4.0 * self.prior_lag + 0.3, read, acts)
        weighed, moments = learned(
            Weighed._make((*sums, power)),
            x[_FILTERS + 3 * n :],
            list(zip(*lines)),
            response,
            weight=weight,
            share=self.dt / self.correlated,
            keep=math.exp(-self.dt / self.memory),
            teaches=teaches,
        )
        # filters and lines of the next sample
        speed = m.where(m.is_finite(v), m.maximum(v, SLOWEST), x[6])
        wheel, behind, car, worn_car, after, h = self._follow(x, command, speed)
        keep = math.exp(-self.dt / self.prior_lag)
        share = self.prior_lag / self.dt * (1.0 - keep)  # exact for a w that is linear between samples
        again = keep * again + (share - keep) * w + (1.0 - share) * after
        fresh = (after - self.worn * h, h, (again - after) / self.prior_lag)
        since = m.where(acts, m.minimum(since + 1.0, 1e6), 0.0)
        missing = m.where(m.both(read, known), 0.0, 1.0)
        *sums, power = weighed
        filters = (command, since, missing, *sums, speed, wheel, *car, after, again, behind, power, *worn_car)
        pushed = [value for line, new in zip(lines, fresh) for value in (new, *line[:-1])]
        return (*filters, *pushed, *moments)

    def _found(self, x: State, unknown: Scalar) -> State:
        """All outputs. unknown: deviation of what the car's model adds to the delay [s]."""
        dt, precision = self.dt, (_GAIN, _SHARE, 1.0 / self.prior_lag_deviation**2)
        bank = fits(x[_FILTERS + 3 * self._count :], precision, (1.0, 0.0, 0.0))
        saved = [fit.saved for fit in bank]
        sums = Weighed._make((*x[3:6], x[13]))
        best, excess, explained = valley(sums, saved, dt, self.prior_delay, self.prior_delay_deviation)
        gains = [m.maximum(fit.coefficients[0], _LEAST_GAIN) for fit in bank]
        lags = [fit.coefficients[2] / gain for fit, gain in zip(bank, gains)]
        spreads = [fit.last_variance / (gain * gain) for fit, gain in zip(bank, gains)]
        low, here, high = (at(best.number + step, lags) for step in (-1.0, 0.0, 1.0))
        slope = 0.5 * (high - low) / dt  # of b/a over the delay, along the valley
        variance, spread = excess * best.variance * dt * dt, excess * at(best.number, spreads)
        prior = self.prior_lag
        moved = m.clip(here + slope * (best.place - best.number) * dt, -0.41 * prior, prior)
        both = best.place * dt + prior + moved
        lag = m.sqrt(prior * prior + 2.0 * prior * moved - moved * moved)
        stretch = (prior - moved) / m.maximum(lag, 0.1 * prior)  # of the lag over b/a
        odd = _NO_SINGLE_LAG * m.maximum(stretch, 1.0)
        trust = 1.0 / (1.0 + odd * odd / self.prior_lag_deviation**2)  # in a lag that second moments hardly tell
        lag = prior + trust * (lag - prior)
        stretch = trust * stretch
        cubic = _CUBIC * (lag - prior)
        own = m.sqrt(unknown * unknown + _TIMING**2 + cubic * cubic)
        sum_variance = (1.0 + slope) * (1.0 + slope) * variance + spread + own * own
        lag_variance = stretch * stretch * (slope * slope * variance + spread) + trust * odd * odd
        less = 1.0 - stretch
        rest = (1.0 + less * slope) * (1.0 + less * slope) * variance + less * less * spread
        deviations = [m.sqrt(rest + trust * odd * odd + own * own), m.sqrt(lag_variance), m.sqrt(sum_variance)]
        enough = (2.0 * self.enough, 2.0 * self.enough, self.enough)
        valid = [m.where(m.both(explained, d <= most), 1.0, 0.0) for d, most in zip(deviations, enough)]
        found = zip((both - lag, lag, both), deviations, valid)
        return (*[number for estimate in found for number in estimate], x[2])


@dataclass(frozen=True, eq=False, kw_only=True)
class WheelDelay(DelayBank):
    """Dead time and lag from the steering command to the measured steering wheel, for a car that measures it.

    As `DelayBank` says, with response = delta_sw_meas and w the commands behind the lag alone. To be preferred where
    the wheel is measured: a sensor's quantum is all its noise, and neither tyres nor free play come into it. The age of
    what is measured of the car's motion is not in it (`YawDelay` has it in).

    Inputs: delta_sw_cmd, delta_sw_meas [rad]; v [m/s]; active [1]. Outputs: delay, lag, delay_lag [s] and what belongs
    to them; missing [1].
    """

    delta_sw_meas = In("rad", direct=False)
    v = In("m/s", direct=False)

    noise: float = radians_of(0.1)
    """Standard deviation of delta_sw_meas about the lagged command [rad]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("WheelDelay", "noise", self.noise, "rad", 1e-6, 1.0, "radians: radians_of(0.1)")

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*self._found(x, 0.0))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        read = m.every(*map(m.is_finite, (u.delta_sw_meas, u.v, u.active)))
        return self._learn(x, u, u.delta_sw_meas, 1.0 / self.noise**2, u.v, read)


@dataclass(frozen=True, eq=False, kw_only=True)
class YawDelay(DelayBank):
    """Dead time and lag from the steering command to the measured yaw rate, for any car with a gyro.

    As `DelayBank` says, with response = r n (L + K v^2)/v and w the commands behind lag and linear single track, both
    by the data sheet. So a wrong ratio does no harm, a wrong tyre does: `yaw_unknown` of the car's own delay is in all
    intervals. The age of what is measured is part of the delay, as controllers have to be told it.

    Inputs: delta_sw_cmd [rad]; r [rad/s]; v [m/s]; active [1]. Outputs: delay, lag, delay_lag [s] and what belongs to
    them; missing [1].
    """

    r = In("rad/s", direct=False)
    v = In("m/s", direct=False)

    vehicle: Vehicle
    """The car by its data sheet."""
    noise: float = radians_of(0.2)
    """Standard deviation of the white noise on r [rad/s]."""
    yaw_unknown: float = 0.15
    """Standard deviation of the car's own delay, as a share of the data sheet's: mostly of the tyres' stiffness [1]."""
    worn: ClassVar[float] = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vehicle(self.vehicle, "YawDelay")
        require_within("YawDelay", "noise", self.noise, "rad/s", 1e-6, 1.0, "radians: radians_of(0.2)")
        require_within("YawDelay", "yaw_unknown", self.yaw_unknown, "1", 0.0, 1.0)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*self._found(x, self.yaw_unknown * yaw_delay(self.vehicle, x[6])))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        read = m.every(*map(m.is_finite, (u.r, u.v, u.active)))
        gain = steady_gain(self.vehicle, m.where(m.is_finite(u.v), m.maximum(u.v, SLOWEST), x[6]))
        return self._learn(x, u, u.r / gain, gain * gain / self.noise**2, u.v, read)

    def _follow(self, x: State, command: Scalar, v: Scalar) -> _Followed:
        p, gain = self.vehicle, steady_gain(self.vehicle, v)
        wheel, behind, car, worn_car, _, _ = super()._follow(x, command, v)
        car = yaw_step(p, *car, 0.5 * (x[7] + wheel) / p.steer_ratio, v, self.dt)
        worn_car = yaw_step(p, *worn_car, 0.5 * (x[12] + behind) / p.steer_ratio, v, self.dt)
        return _Followed(wheel, behind, car, worn_car, car[1] / gain, (car[1] - worn_car[1]) / gain)
