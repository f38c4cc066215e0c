"""Dead time and lag of the steering, from the commands and what the car makes of them."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from steerkit._support.errors import number, require_within
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.estimators.bank import MOMENTS, Bank, Sums
from steerkit.estimators.estimate import estimate_ports
from steerkit.estimators.steering_response import SLOWEST, at, steady_gain, yaw_delay, yaw_step
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


class _Before(NamedTuple):
    """What is kept of the samples before.

    command; since: samples for which the commands have acted; missing; speed: SLOWEST at least [m/s]; wheel: the
    commands behind the lag, and behind the free play [rad]; beta, r and play_beta, play_r: the car's model under the
    one and the other; w: what the response should be, and again, behind the lag once more [rad].
    """

    command: Scalar
    since: Scalar
    missing: Scalar
    speed: Scalar
    wheel: Scalar
    behind: Scalar
    beta: Scalar
    r: Scalar
    play_beta: Scalar
    play_r: Scalar
    w: Scalar
    again: Scalar


_FIRST = len(Sums._fields) + len(_Before._fields)


@dataclass(frozen=True, eq=False, kw_only=True)
class DelayBank(Bank):
    """Dead time and lag of what follows the steering commands, by least squares for a bank of dead times; abstract.

    With w the commands behind a lag L0 = prior_lag (and the car), s = dw/dL0 = -(w - w')/L0 where w' is w behind that
    lag once more, and h what a free play of 2 degrees between motor and car takes of w, each candidate d = 0, dt,
    ... longest regresses

        response(t) = a (w - play_share h)(t - d) + b s(t - d) + c h(t - d) + constant

    by recursive least squares, with forgetting over `memory` seconds of driving. Its cost U(d) is the weighted sum of
    squares left over and the priors' (a = 1 +- 0.3, b = 0 +- prior_lag_deviation, c = 0 +- 0.5, d = prior_delay +-
    prior_delay_deviation). A parabola through the lowest U and its neighbours gives the delay between samples and, by
    its curvature, the variance. Delay and lag are those with the regression's first two moments: with B = b/a their sum
    is d + L0 + B, and L = sqrt(L0^2 + 2 L0 B - B^2): near L0 + B, 1.4 L0 at most, drawn to L0 where it is short.
    Without excitation U is the priors' own parabola, so they come out. Where more is left over than the noise explains,
    deviations grow by that.

    A sample is used where all is finite, v is 3 m/s or more, and the commands have acted for longest + 4 L0 +
    0.3 s: `active` was 1, |delta_sw_cmd| at most the stop, no faster than `rate_limit`. Else nothing changes.

    Outputs, of state only: delay, delay_deviation, lag, lag_deviation, and of their sum delay_lag, delay_lag_deviation
    [s]; delay_valid, lag_valid, delay_lag_valid [1]; missing [1]: 1 where the last sample held a NaN. The sum is known
    far better than its parts, which only fast steering separates. Valid: the deviation is at most `enough` (twice
    that for the parts), the commands explain half of the response's variance, and the sum is not at an end of what the
    candidates reach, 0.59 L0 and longest + 2 L0. State: filters, delay lines, moments.

    Source: Ljung 1999, sections 7.3 and 11.2 (regression, forgetting); Golub, Pereyra 1973 (linear parameters solved
    for). openpilot's lag estimation (comma.ai 2025) has the same task and correlates two accelerations.
    """

    delta_sw_cmd = In("rad", direct=False)
    active = In("1", direct=False)
    delay, delay_deviation, delay_valid = estimate_ports("s")
    lag, lag_deviation, lag_valid = estimate_ports("s")
    delay_lag, delay_lag_deviation, delay_lag_valid = estimate_ports("s")
    missing = Out("1", direct=())

    prior_delay: float = 0.15
    """Dead time to begin with [s], 0 to longest."""
    prior_delay_deviation: float = number(0.2, "s", low=1e-4, high=5.0)
    """Its standard deviation [s]."""
    prior_lag: float = number(0.2, "s", low=0.01, high=1.0)
    """Lag to begin with [s]."""
    prior_lag_deviation: float = number(0.06, "s", low=1e-4, high=1.0)
    """Its standard deviation [s]."""
    longest: float = 0.75
    memory: float = number(120.0, "s", low=1.0, high=1e6)
    enough: float = number(0.02, "s", low=1e-4, high=1.0)
    """Deviation from which on the sum is valid [s]."""
    rate_limit: float = number(radians_of(550.0), "rad/s", low=1e-3, high=200.0)
    """Fastest command that is followed [rad/s]."""

    play_share: ClassVar[float] = 0.0
    """Share of that free play which is expected between command and response."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(type(self).__name__, "prior_delay", self.prior_delay, "s", 0.0, self.longest, "0 to longest")

    def init(self, batch: tuple[int, ...] = ()) -> State:
        start = [m.filled(0.0, batch)] * (_FIRST + self._line * (3 + MOMENTS))
        start[len(Sums._fields) + _Before._fields.index("speed")] = m.filled(SLOWEST, batch)
        return tuple(start)

    def _response(self, u: Any, speed: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """What is measured, as an angle [rad]; its weight [1/rad^2]; could it be read?"""
        raise NotImplementedError

    def _followed(self, before: _Before, wheel: Scalar, behind: Scalar, speed: Scalar) -> tuple[State, Scalar, Scalar]:
        """The model's car under this wheel, and under that behind the free play; w and h [rad]."""
        return before[6:10], wheel, wheel - behind

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        n, before = self._line, _Before._make(x[len(Sums._fields) : _FIRST])
        lines = [x[_FIRST + i * n : _FIRST + (i + 1) * n] for i in range(3)]
        *measured, read = self._response(u, before.speed)
        read = m.every(read, m.is_finite(u.v), m.is_finite(u.active))
        known = m.is_finite(u.delta_sw_cmd)
        command = m.where(known, u.delta_sw_cmd, before.command)
        turned = m.absolute(command - before.command)
        calm = m.both(m.absolute(command) <= STOP, turned <= self.rate_limit * self.dt)
        acts = m.every(u.active > 0.5, known, calm, u.v >= SLOWEST)
        settled = before.since * self.dt > self.longest + 4.0 * self.prior_lag + 0.3
        used = m.every(settled, read, acts)
        old = x[_FIRST + 3 * n : _FIRST + (3 + MOMENTS) * n]
        sums, moments = self._summed(Sums._make(x[: len(Sums._fields)]), old, list(zip(*lines)), measured, used)
        # filters and lines of the next sample
        speed = m.where(m.is_finite(u.v), m.maximum(u.v, SLOWEST), before.speed)
        keep = math.exp(-self.dt / self.prior_lag)
        wheel = keep * before.wheel + (1.0 - keep) * command
        behind = wheel - m.clip(wheel - before.behind, -_GAP, _GAP)
        cars, w, h = self._followed(before, wheel, behind, speed)
        share = self.prior_lag / self.dt * (1.0 - keep)  # exact for a w that is linear between samples
        again = keep * before.again + (share - keep) * before.w + (1.0 - share) * w
        fresh = (w - self.play_share * h, h, (again - w) / self.prior_lag)
        since = m.where(acts, m.minimum(before.since + 1.0, 1e6), 0.0)
        missing = m.where(m.both(read, known), 0.0, 1.0)
        pushed = [value for line, new in zip(lines, fresh) for value in (new, *line[:-1])]
        filters = (command, since, missing, speed, wheel, behind, *cars, w, again)
        return (*sums, *filters, *pushed, *moments)

    def _car_unknown(self, speed: Scalar) -> Scalar:
        """Deviation of what the car's model adds to the delay [s]."""
        return 0.0

    def _found(self, x: State) -> State:
        """All outputs."""
        dt, n, precision = self.dt, self._line, (_GAIN, _SHARE, 1.0 / self.prior_lag_deviation**2)
        sums, before = Sums._make(x[:4]), _Before._make(x[4:_FIRST])
        moments = x[_FIRST + 3 * n : _FIRST + (3 + MOMENTS) * n]
        prior_delay = dt, self.prior_delay, self.prior_delay_deviation
        best, bank = self._best(sums, moments, precision, (1.0, 0.0, 0.0), prior_delay)
        excess, explained, unknown = best.excess, best.explained, self._car_unknown(before.speed)
        gains = [m.maximum(fit.coefficients[0], _LEAST_GAIN) for fit in bank]
        lags = [fit.coefficients[2] / gain for fit, gain in zip(bank, gains)]
        spreads = [fit.last_variance / (gain * gain) for fit, gain in zip(bank, gains)]
        low, here, high = (at(best.number + step, lags) for step in (-1.0, 0.0, 1.0))
        slope = 0.5 * (high - low) / dt  # of b/a over the delay, along the valley
        variance, spread = excess * best.variance * dt * dt, excess * at(best.number, spreads)
        prior = self.prior_lag
        moved = m.clip(here + slope * (best.place - best.number) * dt, -0.41 * prior, prior)
        both = best.place * dt + prior + moved
        first, last = m.both(best.place < 0.5, moved <= -0.41 * prior), m.both(best.place > n - 1.5, moved >= prior)
        lag = m.sqrt(prior * prior + 2.0 * prior * moved - moved * moved)
        stretch = (prior - moved) / m.maximum(lag, 0.1 * prior)  # of the lag over b/a
        odd = _NO_SINGLE_LAG * m.maximum(stretch, 1.0)
        trust = 1.0 / (1.0 + odd * odd / self.prior_lag_deviation**2)  # in a lag that second moments hardly show
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
        explained = m.both(explained, m.either(first, last) < 0.5)
        valid = [m.where(m.both(explained, d <= most), 1.0, 0.0) for d, most in zip(deviations, enough)]
        found = zip((both - lag, lag, both), deviations, valid)
        return (*[number for estimate in found for number in estimate], before.missing)


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

    noise: float = number(radians_of(0.1), "rad", low=1e-6, high=1.0)
    """Standard deviation of delta_sw_meas about what the model makes of the command [rad]."""

    def _response(self, u: Any, speed: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return u.delta_sw_meas, 1.0 / self.noise**2, m.is_finite(u.delta_sw_meas)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*self._found(x))


@dataclass(frozen=True, eq=False, kw_only=True)
class YawDelay(DelayBank):
    """Dead time and lag from the steering command to the measured yaw rate, for any car with a gyro.

    As `DelayBank` says, with response = r n (L + K v^2)/v and w the commands behind lag and linear single track, both
    by the data sheet. So a wrong ratio does no harm, a wrong tyre does: `yaw_unknown` of the car's own delay is in all
    intervals. The age of what is measured is part of the delay, as controllers need it.

    Inputs: delta_sw_cmd [rad]; r [rad/s]; v [m/s]; active [1]. Outputs: delay, lag, delay_lag [s] and what belongs to
    them; missing [1].
    """

    r = In("rad/s", direct=False)
    v = In("m/s", direct=False)

    vehicle: Vehicle
    """The car by its data sheet."""
    noise: float = number(radians_of(0.2), "rad/s", low=1e-6, high=1.0)
    """Standard deviation of the white noise on r [rad/s]."""
    yaw_unknown: float = number(0.15, "1", low=0.0, high=1.0)
    """Standard deviation of the car's own delay, as a share of the data sheet's: mostly of the tyres' stiffness [1]."""
    play_share: ClassVar[float] = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vehicle(self.vehicle, type(self).__name__)

    def _response(self, u: Any, speed: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        gain = steady_gain(self.vehicle, m.where(m.is_finite(u.v), m.maximum(u.v, SLOWEST), speed))
        return u.r / gain, gain * gain / self.noise**2, m.is_finite(u.r)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*self._found(x))

    def _car_unknown(self, speed: Scalar) -> Scalar:
        return self.yaw_unknown * yaw_delay(self.vehicle, speed)

    def _followed(self, before: _Before, wheel: Scalar, behind: Scalar, speed: Scalar) -> tuple[State, Scalar, Scalar]:
        p, gain = self.vehicle, steady_gain(self.vehicle, speed)
        middle, play_middle = 0.5 * (before.wheel + wheel), 0.5 * (before.behind + behind)
        car = yaw_step(p, before.beta, before.r, middle / p.steer_ratio, speed, self.dt)
        play_car = yaw_step(p, before.play_beta, before.play_r, play_middle / p.steer_ratio, speed, self.dt)
        return (*car, *play_car), car[1] / gain, (car[1] - play_car[1]) / gain
