"""Friction of the steering, from the loop that it leaves between the command and the measured wheel."""

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

from steerkit._support.errors import number
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.estimators.bank import MOMENTS, Bank, Fit, Sums, Valley
from steerkit.estimators.estimate import NORMAL_95, estimate_ports
from steerkit.estimators.steering_response import SLOWEST, arrived, at

_GAIN = 1.0 / 0.3**2
"""Precision of the response's gain, 1 +- 0.3."""
_LATE = 1.0 / 0.1**2
"""Precision of the delay that is still wrong, 0 +- 0.1 s [1/s^2]."""
_LAG = 1.0 / 0.05**2
"""Precision of how much the lag is longer, 0 +- 0.05 s [1/s^2]."""
_RESET_AT = 0.005
"""How far the given sum of delay and lag may move [s]."""
_COARSE = radians_of(0.012)
"""Deviation of the half width for what lies between samples and is no play operator [rad]."""
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
"""By how much a half width is off, for each second by which a delay is given wrong [rad/s]: b x' is not all of it."""
_CLOSE = 0.0015
"""Deviation of a lag that was judged to be right [s]."""


class Known(NamedTuple):
    """What is kept of the samples before, besides sums, angles, operators and moments.

    held: the last angle that could be read [rad]; since: samples for which it has acted; missing; speed: SLOWEST at
    least [m/s]; tight: the angle that arrives [rad]; rate: its derivative, and slow, behind the lag
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
class SteeringFriction(Bank):
    """The twist that friction holds between motor and steering wheel, from the command against the measured wheel.

    friction [rad] is what `SteeringColumn` calls so: half the width of the loop that a play operator leaves, by least
    squares for a bank of widths. x is `angle`, the command, held for dt, behind `lag` and `delay`, those of the motor
    (`WheelDelay`). For each candidate half width g = 0, 0.2, ... 1.6 degrees, with
    P_g x = x - clip(x - P_g x(t - dt), -g, g) the play operator,

        delta_sw_meas(t) = a P_g x(t) + b x'(t) + c z(t) + constant,  z = x' - x' behind the lag once more,

    is regressed as in `DelayBank`, with priors a = 1 +- 0.3, b = 0 +- 0.1 s, c = 0 +- 0.05 s, g = prior +-
    prior_deviation. The loop of a delay that is given wrong grows with the wheel's speed, that of a gap does not,
    which separates them. A parabola through the lowest cost and its neighbours gives g and its variance; where more is
    left over than the noise explains, the deviation grows by that; 1.5 degrees/s of b are in it, and 9 degrees/s times
    the lag's deviation, as a lag that is taken for delay leaves a loop that hardly differs from a gap's. Without
    steering to and fro the prior stays. Where the given sum of delay and lag moves by 5 ms, all sums are reset.

    It begins with the given lag: c is how much the lag is longer, at the same sum of delay and lag. After 15 s of
    driving, where c is more than 3 ms and two of its deviations, all sums are reset with that lag, again and again; so
    friction is known better than any lag that is given.

    A sample is used where all is finite, v is 3 m/s or more, and `active` was 1 for 3 s. Valid: the 95 % interval is
    within a tenth of the half width or ends below 0.25 degrees, and half of the response's variance is explained.

    Inputs: angle, delta_sw_meas [rad]; delay, lag, lag_deviation [s]; v [m/s]; active [1]. Outputs, of state only:
    friction, friction_deviation [rad]; friction_valid, missing [1], the last 1 where the sample before held a NaN.
    State: filters, the angles on their way, the operators, moments. Source: as for `SteeringColumn` (Nordin, Gutman
    2002; Visintin 1994) and `DelayBank`.
    """

    angle = In("rad", direct=False)
    delay = In("s", direct=False)
    lag = In("s", direct=False)
    lag_deviation = In("s", direct=False)
    v = In("m/s", direct=False)
    active = In("1", direct=False)
    delta_sw_meas = In("rad", direct=False)
    friction, friction_deviation, friction_valid = estimate_ports("rad")
    missing = Out("1", direct=())

    prior: float = number(radians_of(0.5), "rad", low=0.0, high=WIDEST)
    """Half width to begin with, and its standard deviation [rad]."""
    prior_deviation: float = number(radians_of(0.5), "rad", low=1e-6, high=1.0)
    memory: float = number(600.0, "s", low=1.0, high=1e6)
    longest: float = 1.0
    noise: float = number(radians_of(0.1), "rad", low=1e-6, high=1.0)
    """Standard deviation of delta_sw_meas about what the model makes of the command [rad]."""

    @cached_property
    def _places(self) -> list[tuple[int, int]]:
        """Where in the state the angles on their way, the operators and the moments stand."""
        return list(pairwise(accumulate((_FILTERS, self._line, _CANDIDATES, MOMENTS * _CANDIDATES))))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        start = [m.filled(0.0, batch)] * self._places[-1][1]
        start[_SUMS + Known._fields.index("speed")] = m.filled(SLOWEST, batch)
        return tuple(start)

    def _fitted(self, sums: Sums, moments: State) -> tuple[Valley, list[Fit]]:
        places = (_STEP, self.prior, self.prior_deviation)
        return self._best(sums, moments, (_GAIN, _LATE, _LAG), (1.0, 0.0, 0.0), places)

    def _lag_judged(self, sums: Sums, known: Known, lag: Scalar, moments: State) -> tuple[Known, Scalar]:
        """What is known of the lag after this sample, and does another one have to be tried?"""
        best, bank = self._fitted(sums, moments)
        gain = m.maximum(at(best.number, [fit.coefficients[0] for fit in bank]), 0.3)
        longer = at(best.number, [fit.coefficients[2] for fit in bank]) / gain
        unsure = m.sqrt(best.excess * at(best.number, [fit.last_variance for fit in bank])) / gain
        due = known.clock >= _TRIED
        other = m.both(due, m.absolute(longer) > m.maximum(_OFF, 2.0 * unsure))
        step = m.where(other, m.clip(longer, -_LONGER, _LONGER), 0.0)
        doubt = m.where(due, m.maximum(_LEFT * m.absolute(step), _CLOSE), known.doubt)
        return known._replace(own=m.where(due, m.clip(lag + step, 0.02, 2.0), known.own), doubt=doubt), other

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        dt, sums, known = self.dt, Sums._make(x[:_SUMS]), Known._make(x[_SUMS:_FILTERS])
        line, operators, moments = (x[a:b] for a, b in self._places)
        given = m.every(*map(m.is_finite, (u.delay, u.lag, u.lag_deviation)))
        heard = m.both(m.is_finite(u.angle), given)
        read = m.every(m.is_finite(u.delta_sw_meas), heard, m.is_finite(u.v), m.is_finite(u.active))
        acts = m.both(heard, u.active > 0.5)
        used = m.every(read, known.since * dt > _SETTLED, acts, u.v >= SLOWEST)
        rows = [(operator, known.rate, known.rate - known.slow) for operator in operators]
        measured = (u.delta_sw_meas, 1.0 / self.noise**2)
        sums, after = self._summed(sums, moments, rows, measured, used)
        # the lag, and whether all that was summed is of another way than the angle goes now
        lag = m.where(given, m.clip(u.lag, 0.0, 2.0), 0.0)
        both = m.where(given, u.delay + lag, known.both)
        doubt = m.where(m.both(given, known.own <= 0.0), u.lag_deviation, known.doubt)
        lag = m.where(known.own > 0.0, known.own, lag)
        known = known._replace(doubt=doubt, clock=known.clock + m.where(used, dt, 0.0))
        known, other = self._lag_judged(sums, known, lag, tuple(after))
        reset = m.either(other, m.both(used, m.absolute(both - known.both) > _RESET_AT))
        lag = m.where(known.own > 0.0, known.own, lag)
        # the next sample's angle, and what the operators make of it
        angle = m.where(m.is_finite(u.angle), u.angle, known.held)
        speed = m.where(m.is_finite(u.v), m.maximum(u.v, SLOWEST), known.speed)
        line, (corner, _, tap) = arrived(line, angle, both - lag, lag, dt, held=True)
        gaps = [i * _STEP for i in range(_CANDIDATES)]
        turns = [corner - m.clip(corner - before, -gap, gap) for before, gap in zip(operators, gaps)]
        ends = [tap - m.clip(tap - turn, -gap, gap) for turn, gap in zip(turns, gaps)]
        rate = (ends[0] - known.tight) / dt
        known = known._replace(
            held=angle,
            since=m.where(acts, m.minimum(known.since + 1.0, 1e6), 0.0),
            missing=m.where(read, 0.0, 1.0),
            speed=speed,
            tight=ends[0],
            rate=rate,
            slow=rate + (known.slow - rate) * m.exp(-dt / m.maximum(lag, 1e-3)),
            both=m.where(reset, both, known.both),
            clock=m.where(reset, 0.0, known.clock),
        )
        summed = [m.where(reset, 0.0, value) for value in (*sums, *after)]
        return (*summed[:_SUMS], *known, *line, *ends, *summed[_SUMS:])

    def output(self, t: Any, x: State, u: Any) -> Any:
        known, (begin, end) = Known._make(x[_SUMS:_FILTERS]), self._places[-1]
        best, bank = self._fitted(Sums._make(x[:_SUMS]), x[begin:end])
        width, aside = best.place * _STEP, PER_LAG * known.doubt
        late = _LATE_LEFT * at(best.number, [fit.coefficients[1] for fit in bank])
        deviation = m.sqrt(best.excess * best.variance * _STEP**2 + _COARSE**2 + aside * aside + late * late)
        reach = NORMAL_95 * deviation
        precise = m.either(reach <= _SHARE * width, width + reach <= _SMALL)
        valid = m.where(m.both(precise, best.explained), 1.0, 0.0)
        return self.Y(width, deviation, valid, known.missing)
