"""Friction and free play of the steering, from the loops that they leave between an angle and what follows it."""

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, ClassVar, NamedTuple

from steerkit._support.errors import number
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.estimators.bank import MOMENTS, Bank, Fit, OfWheel, OfYawRate, Sums, Valley
from steerkit.estimators.estimate import NORMAL_95, estimate_ports
from steerkit.estimators.steering_response import SLOWEST, arrived, at, steady_gain, yaw_step

_GAIN = 1.0 / 0.3**2
"""Precision of the response's gain, 1 +- 0.3."""
_LATE = 1.0 / 0.1**2
"""Precision of the delay that is still wrong, 0 +- 0.1 s [1/s^2]."""
WIDEST = radians_of(1.6)
"""Largest half width that is tried [rad]."""
_CANDIDATES = 9
_STEP = WIDEST / (_CANDIDATES - 1)
_SETTLED = 3.0
"""How long the commands have to have acted before a sample is used [s]: operators reach an end of their gaps."""
_SHARE, _SMALL = 0.1, radians_of(0.25)
"""Valid: the interval reaches at most this share of the half width to either side, or ends below this [rad]."""
_TRIED = 15.0
"""Driving that was used, after which a lag is judged by what it leaves over [s]."""
_OFF, _LONGER, _LEFT = 0.003, 0.05, 0.3
"""A lag is another one where it is off by so much at least [s]; the largest step [s]; what of it may still be wrong."""
PER_LAG = radians_of(9.0)
"""By how much the half width is off, for each second of a lag that is taken for delay [rad/s]."""
_LATE_LEFT = radians_of(1.5)
"""By how much a half width is off, for each second by which a delay is given wrong [rad/s]: b p_0' is not all of it."""
_CLOSE = 0.0015
"""Deviation of a lag that was judged to be right [s]."""


class Known(NamedTuple):
    """What is kept of the samples before, besides sums, angles, operators and moments.

    held: the last angle that could be read [rad]; since: samples for which it has acted; missing; speed: SLOWEST at
    least [m/s]; tight: the answer of the candidate without a gap [rad]; rate: its derivative, and slow, behind the lag
    once more [rad/s]; doubt: deviation of the lag [s]; both: delay and lag together that were given when the sums began
    [s]; own: the lag that was found, 0: none yet [s]; clock: driving that was used since the sums began [s].
    """

    held: Scalar
    since: Scalar
    missing: Scalar
    speed: Scalar
    tight: Scalar
    rate: Scalar
    slow: Scalar
    doubt: Scalar
    both: Scalar
    own: Scalar
    clock: Scalar


_SUMS = len(Sums._fields)
_FILTERS = _SUMS + len(Known._fields)


@dataclass(frozen=True, eq=False, kw_only=True)
class HysteresisBank(Bank):
    """The half width of the loop that a play operator leaves, by least squares for a bank of widths; abstract.

    x is `angle` behind `lag` and `delay`, held for dt. For each candidate half width g = 0, 0.2, ... 1.6 degrees, with
    P_g x = x - clip(x - P_g x(t - dt), -g, g) the play operator, and p_g what the car makes of P_g x,

        response(t) = a p_g(t) + b p_0'(t) + c z(t) + constant

    is regressed as in `DelayBank`, with priors a = 1 +- 0.3, b = 0 +- 0.1 s, c = 0 +- `beyond`, g = prior +-
    prior_deviation; z is what else may be wrong. The loop of a delay that is given wrong grows with the wheel's speed,
    that of a gap does not, which separates them. A parabola through the lowest cost and its neighbours gives g and
    its variance; where more is left over than the noise explains, the deviation grows by that; 1.5 degrees/s of b are
    in it, and 9 degrees/s times the lag's deviation, as a lag that is taken for delay leaves a loop that hardly differs
    from a gap's. Without steering to and fro the prior stays. Where the given sum of delay and lag moves by
    `reset_at`, all sums are reset.

    A sample is used where all is finite, v is 3 m/s or more, and `active` was 1 for 3 s. Valid: the 95 % interval is
    within a tenth of the half width or ends below 0.25 degrees, and half of the response's variance is explained.

    Inputs: angle [rad]; delay, lag, lag_deviation [s]; v [m/s]; active [1]. State: filters, the angles on their way,
    the operators, the cars behind them, moments. Source: as for `SteeringColumn` (Nordin, Gutman 2002; Visintin 1994)
    and `DelayBank`.
    """

    angle = In("rad", direct=False)
    delay = In("s", direct=False)
    lag = In("s", direct=False)
    lag_deviation = In("s", direct=False)
    v = In("m/s", direct=False)
    active = In("1", direct=False)

    prior: float = number(radians_of(0.5), "rad", low=0.0, high=WIDEST)
    """Half width to begin with, and its standard deviation [rad]."""
    prior_deviation: float = number(radians_of(0.5), "rad", low=1e-6, high=1.0)
    memory: float = number(600.0, "s", low=1.0, high=1e6)
    longest: float = 1.0
    held: bool = True
    """Is the angle a command, held for dt? Else it is measured, and at least dt late."""

    behind: ClassVar[int] = 0
    """Numbers in the state of the car behind each operator."""
    sides: ClassVar[float] = 1.0
    """How many half widths the output is."""
    beyond: ClassVar[float]
    """Standard deviation of c, in the unit that z makes."""
    reset_at: ClassVar[float]
    """How far the given sum of delay and lag may move [s]."""
    coarse: ClassVar[float]
    """Deviation of the half width for what lies between samples and is no play operator [rad]."""

    @cached_property
    def _places(self) -> list[tuple[int, int]]:
        """Where in the state the angles on their way, the operators, the cars and the moments stand."""
        lengths = (_FILTERS, self._line, _CANDIDATES, self.behind * _CANDIDATES, MOMENTS * _CANDIDATES)
        return list(pairwise(accumulate(lengths)))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        start = [m.filled(0.0, batch)] * self._places[-1][1]
        start[_SUMS + Known._fields.index("speed")] = m.filled(SLOWEST, batch)
        return tuple(start)

    def _answer(self, operator: Scalar, car: State, v: Scalar) -> Scalar:
        """p_g [rad] of one candidate: its operator's angle and the state of its car."""
        return operator

    def _driven(self, mean: Scalar, car: State, v: Scalar) -> State:
        """The car of one candidate a sample later; mean: its operator's angle meanwhile [rad]."""
        return car

    def _else(self, known: Known, answer: Scalar) -> Scalar:
        """z of one candidate."""
        raise NotImplementedError

    def _lag_judged(self, sums: Sums, known: Known, lag: Scalar, moments: State) -> tuple[Known, Scalar]:
        """What is known of the lag after this sample, and does another one have to be tried?"""
        return known, known.clock < 0.0

    def _fitted(self, sums: Sums, moments: State) -> tuple[Valley, list[Fit]]:
        precision, places = (_GAIN, _LATE, 1.0 / self.beyond**2), (_STEP, self.prior, self.prior_deviation)
        return self._best(sums, moments, precision, (1.0, 0.0, 0.0), places)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        dt, sums, known = self.dt, Sums._make(x[:_SUMS]), Known._make(x[_SUMS:_FILTERS])
        line, operators, flat, moments = (x[a:b] for a, b in self._places)
        cars = [flat[i : i + self.behind] for i in range(0, len(flat), self.behind)] if flat else [()] * _CANDIDATES
        *measured, read = self._response(u, known.speed)
        given = m.every(*map(m.is_finite, (u.delay, u.lag, u.lag_deviation)))
        heard = m.both(m.is_finite(u.angle), given)
        read = m.every(read, heard, m.is_finite(u.v), m.is_finite(u.active))
        acts = m.both(heard, u.active > 0.5)
        used = m.every(read, known.since * dt > _SETTLED, acts, u.v >= SLOWEST)
        answers = [self._answer(operator, car, known.speed) for operator, car in zip(operators, cars)]
        rows = [(answer, known.rate, self._else(known, answer)) for answer in answers]
        sums, after = self._summed(sums, moments, rows, measured, used)
        # the lag, and whether all that was summed is of another way than the angle goes now
        lag = m.where(given, m.clip(u.lag, 0.0, 2.0), 0.0)
        both = m.where(given, u.delay + lag, known.both)
        doubt = m.where(m.both(given, known.own <= 0.0), u.lag_deviation, known.doubt)
        lag = m.where(known.own > 0.0, known.own, lag)
        known = known._replace(doubt=doubt, clock=known.clock + m.where(used, dt, 0.0))
        known, other = self._lag_judged(sums, known, lag, tuple(after))
        reset = m.either(other, m.both(used, m.absolute(both - known.both) > self.reset_at))
        lag = m.where(known.own > 0.0, known.own, lag)
        # the next sample's angle, and what the operators and the cars make of it
        angle = m.where(m.is_finite(u.angle), u.angle, known.held)
        speed = m.where(m.is_finite(u.v), m.maximum(u.v, SLOWEST), known.speed)
        delay = both - lag - (0.0 if self.held else dt)
        line, (corner, part, tap) = arrived(line, angle, delay, lag, dt, held=self.held)
        gaps = [i * _STEP for i in range(_CANDIDATES)]
        turns = [corner - m.clip(corner - before, -gap, gap) for before, gap in zip(operators, gaps)]
        ends = [tap - m.clip(tap - turn, -gap, gap) for turn, gap in zip(turns, gaps)]
        means = [0.5 * (turn + part * before + (1.0 - part) * end) for before, turn, end in zip(operators, turns, ends)]
        cars = [self._driven(*one, speed) for one in zip(means, cars)]
        tight = self._answer(ends[0], cars[0], speed)
        rate = (tight - known.tight) / dt
        known = known._replace(
            held=angle,
            since=m.where(acts, m.minimum(known.since + 1.0, 1e6), 0.0),
            missing=m.where(read, 0.0, 1.0),
            speed=speed,
            tight=tight,
            rate=rate,
            slow=rate + (known.slow - rate) * m.exp(-dt / m.maximum(lag, 1e-3)),
            both=m.where(reset, both, known.both),
            clock=m.where(reset, 0.0, known.clock),
        )
        summed = [m.where(reset, 0.0, value) for value in (*sums, *after)]
        moved = [number for car in cars for number in car]
        return (*summed[:_SUMS], *known, *line, *ends, *moved, *summed[_SUMS:])

    def _found(self, x: State) -> State:
        """All outputs."""
        known, (begin, end) = Known._make(x[_SUMS:_FILTERS]), self._places[-1]
        best, bank = self._fitted(Sums._make(x[:_SUMS]), x[begin:end])
        width, aside = best.place * _STEP, PER_LAG * known.doubt
        late = _LATE_LEFT * at(best.number, [fit.coefficients[1] for fit in bank])
        deviation = m.sqrt(best.excess * best.variance * _STEP**2 + self.coarse**2 + aside * aside + late * late)
        reach = NORMAL_95 * deviation
        precise = m.either(reach <= _SHARE * width, width + reach <= _SMALL)
        valid = m.where(m.both(precise, best.explained), 1.0, 0.0)
        return self.sides * width, self.sides * deviation, valid, known.missing


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringFriction(OfWheel, HysteresisBank):
    """The twist that friction holds between motor and steering wheel, from the command against the measured wheel.

    As `HysteresisBank` says, with angle = the command, delay and lag those of the motor (`WheelDelay`), response =
    delta_sw_meas, p_g = P_g x. friction [rad] is what `SteeringColumn` calls so: half the loop's width.

    It begins with the given lag: with z = x' - x' behind the lag once more, c is how much the lag is longer, at the
    same sum of delay and lag. After 15 s of driving, where c is more than 3 ms and two of its deviations, all sums are
    reset with that lag, again and again; so friction is known better than any lag that is given.

    Inputs: angle, delta_sw_meas [rad]; delay, lag, lag_deviation [s]; v [m/s]; active [1]. Outputs, of state only:
    friction, friction_deviation [rad]; friction_valid, missing [1], the last 1 where the sample before held a NaN.
    """

    friction, friction_deviation, friction_valid = estimate_ports("rad")
    missing = Out("1", direct=())

    beyond: ClassVar[float] = 0.05
    reset_at: ClassVar[float] = 0.005
    coarse: ClassVar[float] = radians_of(0.012)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*self._found(x))

    def _else(self, known: Known, answer: Scalar) -> Scalar:
        return known.rate - known.slow

    def _lag_judged(self, sums: Sums, known: Known, lag: Scalar, moments: State) -> tuple[Known, Scalar]:
        best, bank = self._fitted(sums, moments)
        gain = m.maximum(at(best.number, [fit.coefficients[0] for fit in bank]), 0.3)
        longer = at(best.number, [fit.coefficients[2] for fit in bank]) / gain
        unsure = m.sqrt(best.excess * at(best.number, [fit.last_variance for fit in bank])) / gain
        due = known.clock >= _TRIED
        other = m.both(due, m.absolute(longer) > m.maximum(_OFF, 2.0 * unsure))
        step = m.where(other, m.clip(longer, -_LONGER, _LONGER), 0.0)
        doubt = m.where(due, m.maximum(_LEFT * m.absolute(step), _CLOSE), known.doubt)
        return known._replace(own=m.where(due, m.clip(lag + step, 0.02, 2.0), known.own), doubt=doubt), other


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringPlay(OfYawRate, HysteresisBank):
    """The free play of the steering, from the steering wheel's angle against the yaw rate.

    As `HysteresisBank` says, with angle = the measured wheel, delay = the age of r, lag = 0; or with the command and
    the delay and lag of `YawDelay`, and then friction and play are found as one, nearly their sum. p_g is P_g x behind
    the linear single track of the data sheet, response = r n (L + K v^2)/v, and z = p_g v^2/L: K may be another. play
    [rad] is the whole loop, as `SteeringColumn` has it. With tyres that are a quarter softer the yaw rate's delay
    differs with the speed: a drive between 6 and 25 m/s is 0.3 degrees off, one at 5 to 12 m/s hardly at all.

    Inputs: angle [rad]; delay, lag, lag_deviation [s]; v [m/s]; r [rad/s]; active [1]. Outputs, of state only: play,
    play_deviation [rad]; play_valid, missing [1], the last 1 where the sample before held a NaN.
    """

    play, play_deviation, play_valid = estimate_ports("rad")
    missing = Out("1", direct=())

    held: bool = False

    correlated: ClassVar[float] = 0.07
    behind: ClassVar[int] = 2
    sides: ClassVar[float] = 2.0
    beyond: ClassVar[float] = 0.001
    reset_at: ClassVar[float] = 0.02
    coarse: ClassVar[float] = radians_of(0.03)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*self._found(x))

    def _answer(self, operator: Scalar, car: State, v: Scalar) -> Scalar:
        return car[1] / steady_gain(self.vehicle, v)

    def _driven(self, mean: Scalar, car: State, v: Scalar) -> State:
        beta, r = car
        return yaw_step(self.vehicle, beta, r, mean / self.vehicle.steer_ratio, v, self.dt)

    def _else(self, known: Known, answer: Scalar) -> Scalar:
        return answer * known.speed * known.speed / self.vehicle.wheelbase
