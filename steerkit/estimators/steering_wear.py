"""Friction and free play of the steering, from the loops that they leave between an angle and what follows it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, ClassVar, NamedTuple

from steerkit._support.errors import require, require_within, whole_samples
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.estimators.bank import Fit, Valley, Weighed, at, fits, learned, size, valley
from steerkit.estimators.estimate import NORMAL_95
from steerkit.estimators.way import arrived
from steerkit.estimators.yaw_model import SLOWEST, steady_gain, yaw_step
from steerkit.vehicles import Vehicle, require_vehicle

_GAIN = 1.0 / 0.3**2
"""Precision of the response's gain, 1 +- 0.3."""
_LATE = 1.0 / 0.1**2
"""Precision of the delay that is still wrong, 0 +- 0.1 s [1/s^2]."""
_CANDIDATES = 9
_MOMENTS = size(3)
_SETTLED = 3.0
"""How long the commands have to have acted before they teach [s]: the operators have to get at an end of their gaps."""
_SHARE, _SMALL = 0.1, radians_of(0.25)
"""Valid: the interval reaches at most this share of the half width to either side, or ends below this [rad]."""
_TRIED = 15.0
"""Driving that taught, after which a lag is judged by what it leaves over [s]."""
_OFF, _STEP, _LEFT = 0.003, 0.05, 0.3
"""A lag is another one where it is off by so much at least [s]; the largest step [s]; what of it may still be wrong."""
_LATE_LEFT = radians_of(1.5)
"""By how much a half width is off, for each second by which a delay was told wrong [rad/s]: b p_0' is not all of it."""
_CLOSE = 0.0015
"""Deviation of a lag that was judged to be right [s]."""


class Known(NamedTuple):
    """What a bank remembers of the samples before, besides angles, operators and moments."""

    held: Scalar
    """The last angle that could be read [rad]."""
    since: Scalar
    """Samples for which the angle has acted."""
    missing: Scalar
    sums: tuple[Scalar, Scalar, Scalar, Scalar]
    """`Weighed`."""
    speed: Scalar
    """SLOWEST at least [m/s]."""
    unworn: Scalar
    """What the candidate without a gap answers [rad]."""
    rate: Scalar
    """Its derivative [rad/s]."""
    slow: Scalar
    """That, behind the lag once more [rad/s]."""
    doubt: Scalar
    """Deviation of the lag [s]."""
    told: Scalar
    """Delay and lag that were told when the sums began, together [s]."""
    own: Scalar
    """The lag that was found [s]; 0: none yet."""
    clock: Scalar
    """Driving that has taught since the sums began [s]."""


_FILTERS = len(Known._fields) + 3


@dataclass(frozen=True, eq=False, kw_only=True)
class GapBank(Block):
    """The half width of the loop that a play operator leaves, by least squares for a bank of widths; abstract.

    x is `angle` behind `lag` and `delay`, held for dt. For each candidate half width g = 0, widest/8, ... widest, with
    P_g x = x - clip(x - P_g x(t - dt), -g, g) the play operator, and p_g what the car makes of P_g x,

        response(t) = a p_g(t) + b p_0'(t) + c z(t) + constant

    is regressed as in `DelayBank`, with priors a = 1 +- 0.3, b = 0 +- 0.1 s, c = 0 +- `beyond`, g = prior +-
    prior_deviation; z is what else may be wrong. The loop of a delay that is told wrong grows with the wheel's speed,
    that of a gap does not, which tells them apart. A parabola through the lowest cost and its neighbours gives g and
    its variance; where more is left over than the noise explains, the deviation grows by that; 1.5 degrees/s of b are
    in it, and `per_lag` times the lag's deviation, as a lag that is taken for delay leaves a loop that hardly differs
    from a gap's. Without steering to and fro the prior stays. Where the sum of delay and lag that is told moves by
    `anew`, all begins anew.

    A sample teaches where all is finite, v is 3 m/s or more, and `active` was 1 for 3 s. Valid: the 95 % interval is
    within a tenth of the half width or ends below 0.25 degrees, and half of the response's variance is explained.

    Inputs: angle [rad]; delay, lag, lag_deviation [s]; v [m/s]; active [1]. State: filters, the angles on their way,
    the operators, the cars behind them, moments. Raises ValueError for parameters out of range. Source: as for
    `SteeringColumn` (Nordin, Gutman 2002; Visintin 1994) and `DelayBank`.
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

    behind: ClassVar[int] = 0
    """Numbers in the state of the car behind each operator."""
    beyond: ClassVar[float]
    """Standard deviation of c, in the unit that z makes."""
    anew: ClassVar[float]
    """How far the sum of delay and lag that is told may move [s]."""
    untold: ClassVar[float]
    """Deviation of the half width for what lies between samples and is no play operator [rad]."""

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

    @cached_property
    def _places(self) -> list[tuple[int, int]]:
        """Where in the state the angles on their way, the operators, the cars and the moments stand."""
        lengths = (_FILTERS, self._line, _CANDIDATES, self.behind * _CANDIDATES, _MOMENTS * _CANDIDATES)
        return list(pairwise(accumulate(lengths)))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero = m.filled(0.0, batch)
        start: list[Scalar] = [zero] * self._places[-1][1]
        start[7] = m.filled(SLOWEST, batch)
        return tuple(start)

    def _known(self, x: State) -> Known:
        return Known._make((*x[:3], x[3:7], *x[7:_FILTERS]))

    # ---- what the blocks have of their own ---------------------------------------------------------------------

    def _answer(self, operator: Scalar, car: State, v: Scalar) -> Scalar:
        """p_g [rad] of one candidate: its operator's angle and the state of its car."""
        return operator

    def _driven(self, mean: Scalar, car: State, v: Scalar) -> State:
        """The car of one candidate a sample later; mean: its operator's angle meanwhile [rad]."""
        return car

    def _else(self, known: Known, answer: Scalar) -> Scalar:
        """z of one candidate."""
        raise NotImplementedError

    def _judged(self, known: Known, lag: Scalar, moments: State) -> tuple[Known, Scalar]:
        """What is known of the lag after this sample, and does another one have to be tried?"""
        return known, known.clock < 0.0

    # ---- what they share ---------------------------------------------------------------------------------------

    def _fitted(self, sums: Sequence[Scalar], moments: State) -> tuple[Valley, list[Fit]]:
        every = fits(moments, (_GAIN, _LATE, 1.0 / self.beyond**2), (1.0, 0.0, 0.0))
        saved = [fit.saved for fit in every]
        return valley(Weighed._make(sums), saved, self._step, self.prior, self.prior_deviation), every

    def _cars(self, flat: State) -> list[State]:
        n = self.behind
        return [flat[i * n : (i + 1) * n] for i in range(_CANDIDATES)]

    def _learn(self, x: State, u: Any, response: Scalar, weight: Scalar, read: Scalar) -> State:
        """The next state. response [rad] and weight [1/rad^2] of this sample; read: was it finite?"""
        dt, known = self.dt, self._known(x)
        line, operators, flat, moments = (x[a:b] for a, b in self._places)
        cars = self._cars(flat)
        told = m.every(*map(m.is_finite, (u.delay, u.lag, u.lag_deviation)))
        heard = m.both(m.is_finite(u.angle), told)
        read = m.every(read, heard, m.is_finite(u.v), m.is_finite(u.active))
        acts = m.both(heard, u.active > 0.5)
        teaches = m.every(read, known.since * dt > _SETTLED, acts, u.v >= SLOWEST)
        answers = [self._answer(operator, car, known.speed) for operator, car in zip(operators, cars)]
        weighed, after = learned(
            Weighed._make(known.sums),
            moments,
            [(answer, known.rate, self._else(known, answer)) for answer in answers],
            response,
            weight=weight,
            share=dt / self.correlated,
            keep=math.exp(-dt / self.memory),
            teaches=teaches,
        )
        # the lag, and whether all that was learned is of another way than the angle goes now
        lag = m.where(told, m.clip(u.lag, 0.0, 2.0), 0.0)
        both = m.where(told, u.delay + lag, known.told)
        doubt = m.where(m.both(told, known.own <= 0.0), u.lag_deviation, known.doubt)
        lag = m.where(known.own > 0.0, known.own, lag)
        clock = known.clock + m.where(teaches, dt, 0.0)
        known = known._replace(sums=tuple(weighed), doubt=doubt, clock=clock)
        known, other = self._judged(known, lag, tuple(after))
        anew = m.either(other, m.both(teaches, m.absolute(both - known.told) > self.anew))
        lag = m.where(known.own > 0.0, known.own, lag)
        # the next sample's angle, and what the operators and the cars make of it
        angle = m.where(m.is_finite(u.angle), u.angle, known.held)
        speed = m.where(m.is_finite(u.v), m.maximum(u.v, SLOWEST), known.speed)
        delay = both - lag - (0.0 if self.held else dt)
        line, (corner, part, tap) = arrived(line, angle, delay, lag, dt, held=self.held)
        gaps = [i * self._step for i in range(_CANDIDATES)]
        turns = [corner - m.clip(corner - before, -gap, gap) for before, gap in zip(operators, gaps)]
        ends = [tap - m.clip(tap - turn, -gap, gap) for turn, gap in zip(turns, gaps)]
        means = [0.5 * (turn + part * before + (1.0 - part) * end) for before, turn, end in zip(operators, turns, ends)]
        cars = [self._driven(*one, speed) for one in zip(means, cars)]
        unworn = self._answer(ends[0], cars[0], speed)
        rate = (unworn - known.unworn) / dt
        known = Known(
            angle,
            m.where(acts, m.minimum(known.since + 1.0, 1e6), 0.0),
            m.where(read, 0.0, 1.0),
            (*[m.where(anew, 0.0, value) for value in weighed],),
            speed,
            unworn,
            rate,
            rate + (known.slow - rate) * m.exp(-dt / m.maximum(lag, 1e-3)),
            known.doubt,
            m.where(anew, both, known.told),
            known.own,
            m.where(anew, 0.0, known.clock),
        )
        moved = [number for car in cars for number in car]
        kept = [m.where(anew, 0.0, value) for value in after]
        return (*known[:3], *known.sums, *known[4:], *line, *ends, *moved, *kept)

    def _found(self, x: State) -> tuple[Scalar, Scalar, Scalar]:
        """The half width [rad], its deviation [rad] and its validity."""
        known, (begin, end) = self._known(x), self._places[-1]
        (best, excess, explained), every = self._fitted(known.sums, x[begin:end])
        width, aside = best.place * self._step, self.per_lag * known.doubt
        late = _LATE_LEFT * at(best.number, [fit.coefficients[1] for fit in every])
        deviation = m.sqrt(excess * best.variance * self._step**2 + self.untold**2 + aside * aside + late * late)
        reach = NORMAL_95 * deviation
        precise = m.either(reach <= _SHARE * width, width + reach <= _SMALL)
        return width, deviation, m.where(m.both(precise, explained), 1.0, 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringFriction(GapBank):
    """The twist that friction holds between motor and steering wheel, from the command against the measured wheel.

    As `GapBank` says, with angle = the command, delay and lag those of the motor (`WheelDelay`), response =
    delta_sw_meas, p_g = P_g x. friction [rad] is what `SteeringColumn` calls so: half the loop's width.

    The lag that is told is where it begins: with z = x' - x' behind the lag once more, c is how much the lag is longer,
    at the same sum of delay and lag. After 15 s that taught, where c is more than 3 ms and two of its deviations, all
    begins anew with that lag, again and again; so friction is known better than any lag that is told.

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

    beyond: ClassVar[float] = 0.05
    anew: ClassVar[float] = 0.005
    untold: ClassVar[float] = radians_of(0.012)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("SteeringFriction", "noise", self.noise, "rad", 1e-6, 1.0, "radians: radians_of(0.1)")

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*self._found(x), x[2])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return self._learn(x, u, u.delta_sw_meas, 1.0 / self.noise**2, m.is_finite(u.delta_sw_meas))

    def _else(self, known: Known, answer: Scalar) -> Scalar:
        return known.rate - known.slow

    def _judged(self, known: Known, lag: Scalar, moments: State) -> tuple[Known, Scalar]:
        (best, excess, _), every = self._fitted(known.sums, moments)
        gain = m.maximum(at(best.number, [fit.coefficients[0] for fit in every]), 0.3)
        longer = at(best.number, [fit.coefficients[2] for fit in every]) / gain
        unsure = m.sqrt(excess * at(best.number, [fit.last_variance for fit in every])) / gain
        due = known.clock >= _TRIED
        other = m.both(due, m.absolute(longer) > m.maximum(_OFF, 2.0 * unsure))
        step = m.where(other, m.clip(longer, -_STEP, _STEP), 0.0)
        doubt = m.where(due, m.maximum(_LEFT * m.absolute(step), _CLOSE), known.doubt)
        return known._replace(own=m.where(due, m.clip(lag + step, 0.02, 2.0), known.own), doubt=doubt), other


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringPlay(GapBank):
    """The free play of the steering, from the steering wheel's angle against the yaw rate.

    As `GapBank` says, with angle = the measured wheel, delay = the age of r, lag = 0; or with the command and the delay
    and lag of `YawDelay`, and then friction and play are found as one, nearly their sum. p_g is P_g x behind the linear
    single track of the data sheet, response = r n (L + K v^2)/v, and z = p_g v^2/L: K may be another. play [rad] is the
    whole loop, as `SteeringColumn` has it. Of tyres that are a quarter softer the yaw rate is late by another time at
    each speed: a drive between 6 and 25 m/s leaves 0.3 degrees too much or too little, one at 5 to 12 m/s next to none.

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
    correlated: float = 0.07
    noise: float = radians_of(0.2)
    """Standard deviation of the white noise on r [rad/s]."""

    behind: ClassVar[int] = 2
    beyond: ClassVar[float] = 0.001
    anew: ClassVar[float] = 0.02
    untold: ClassVar[float] = radians_of(0.03)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vehicle(self.vehicle, "SteeringPlay")
        require_within("SteeringPlay", "noise", self.noise, "rad/s", 1e-6, 1.0, "radians: radians_of(0.2)")

    def output(self, t: Any, x: State, u: Any) -> Any:
        width, deviation, valid = self._found(x)
        return self.Y(2.0 * width, 2.0 * deviation, valid, x[2])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        gain = steady_gain(self.vehicle, m.where(m.is_finite(u.v), m.maximum(u.v, SLOWEST), x[7]))
        return self._learn(x, u, u.r / gain, gain * gain / self.noise**2, m.is_finite(u.r))

    def _answer(self, operator: Scalar, car: State, v: Scalar) -> Scalar:
        return car[1] / steady_gain(self.vehicle, v)

    def _driven(self, mean: Scalar, car: State, v: Scalar) -> State:
        beta, r = car
        return yaw_step(self.vehicle, beta, r, mean / self.vehicle.steer_ratio, v, self.dt)

    def _else(self, known: Known, answer: Scalar) -> Scalar:
        return answer * known.speed * known.speed / self.vehicle.wheelbase
