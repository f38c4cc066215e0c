"""Steering ratio, understeer gradient, offset, gyro zero and what pushes the car aside, found while driving."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number, require, require_within, whole_samples
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.estimators import kalman
from steerkit.estimators.estimate import estimate_ports
from steerkit.estimators.steering_response import SLOWEST, arrived, steady_gain, yaw_step
from steerkit.vehicles import G, Vehicle, require_vehicle

_STANDS, _STANDING = 0.1, 1.0
"""A car stands below this speed [m/s], after that long [s]."""
_TOGETHER = 1.0
"""For how long errors of the angle hang together [s]."""
_OUTLIER = 3.0
"""Standard deviations beyond which a sample counts for less."""
_GAP = radians_of(1.0)
"""Half of the free play whose loop is a number of the filter [rad]."""
_SOFT, _SATURATES = 2e-4, 7.5e-4
"""Deviations of the understeer gradient for tyres that give way in tight bends, and much sooner [rad s^2/m]."""
_CORRELATED = 0.15
"""For how long the errors of r hang together [s]."""
_ANGLE_ERROR = radians_of(0.3)
"""Standard deviation of what free play and friction make of the angle beyond the loop of the filter's own [rad]."""
_WINDOW = 40.0
"""Longest time over which headings are compared [s]."""
_N = 6
_OFFSET, _DISTURBANCE = 2, 4
_WINDOWS, _FILTERS = 13, 16
_BOUNDS = ((0.4, 2.5), (-0.02, 0.05), (-0.5, 0.5), (-0.1, 0.1), (-0.2, 0.2), (-1.0, 4.0))
"""Of gain, understeer gradient [rad s^2/m], offset [rad], gyro zero [rad/s], disturbance [rad], play [1]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SingleTrackFilter(Block):
    """An extended Kalman filter of ratio, understeer, offset, gyro zero and disturbance, for cars nobody has measured.

    The car by its data sheet turns the angle delta_sw, behind `lag` and `delay`, into w: the angle that its yaw rate
    has got to (linear single track). What the gyro should then say, and what its numbers do in driving of dt, is

        r = g v (w - play h + offset + disturbance)/(n (L + K v^2)) + rate_zero + noise,  g = 1/ratio,
        disturbance' = f disturbance + noise,  P' = F P F + (1 - F^2) P_0,  F = diag(exp(-dt/time), ..., f),

    n, L of the data sheet; h = w - w behind a free play of 2 degrees, for what friction and play keep from the road
    wheels looks like another ratio, and within a bend like an offset. The variance of r's error is that of its noise,
    of the angle's other errors and of a delay that is not known yet, each as often as it is new:

        noise^2 (0.15 s)/dt + (g v/(n (L + K v^2)))^2 ((0.3 deg)^2 + (w' delay_deviation)^2) (1 s)/dt.

    Forgetting widens P towards the prior's P_0 and moves no value, so nothing drifts. While the car stands, r is
    rate_zero itself. Over windows of 5, 10, 20 and then 40 s the heading gives it, too: the integral of r less the
    change of psi. A sample further than 3 deviations off counts for less, as if its noise were that large; one
    further than 6 is not integrated either.

    Observable are: the ratio in bends; the offset wherever the car drives, but apart from rate_zero only with a
    heading, a stop or changes of speed; K in bends at different speeds from about 15 m/s, below it is the prior's. A
    bank or a wind is separated from the offset by its time alone (`disturbance_time`), and a bank that never ends is
    one. total_offset = offset + disturbance is what a controller has to steer against.

    Inputs: delta_sw [rad], the command, or the measured wheel, whose offset is then found; v [m/s]; r [rad/s]; psi
    [rad], NaN where there is none; delay, lag [s] from that angle to the measured r, without the car's own, and
    delay_deviation [s] of their sum; active [1]: does the angle steer?
    Outputs, of state only: ratio, ratio_deviation [1], understeer, understeer_deviation [rad s^2/m], offset,
    offset_deviation, disturbance, disturbance_deviation, total_offset, total_offset_deviation [rad], rate_zero,
    rate_zero_deviation [rad/s]; ratio_valid, understeer_valid, offset_valid, disturbance_valid, total_offset_valid,
    rate_zero_valid [1]: the deviation is at most 3 %, a quarter of the prior's, 0.25 degrees, half of its own, 0.35
    degrees, 0.001 rad/s, before it is widened by what driving cannot show (`gyro_scale`, `bank`, tyres that saturate);
    missing [1], 1 if a number of the last sample but psi was.
    A sample is used where these are finite, v is 3 m/s or more, and the angle has steered for delay + 4 lag + 0.3 s.
    State: filters, a delay line, the six numbers, P's upper triangle.

    Source: Gelb 1974, section 6.1 (extended Kalman filter); Rajamani 2012, section 3.3; Kulhavy, Zarrop 1993
    (forgetting towards a prior). openpilot's paramsd (comma.ai) and Autoware's steering offset estimator do this too.
    """

    delta_sw = In("rad", direct=False)
    v = In("m/s", direct=False)
    r = In("rad/s", direct=False)
    psi = In("rad", direct=False)
    delay = In("s", direct=False)
    lag = In("s", direct=False)
    delay_deviation = In("s", direct=False)
    active = In("1", direct=False)
    ratio, ratio_deviation, ratio_valid = estimate_ports("1")
    understeer, understeer_deviation, understeer_valid = estimate_ports("rad s^2/m")
    offset, offset_deviation, offset_valid = estimate_ports("rad")
    rate_zero, rate_zero_deviation, rate_zero_valid = estimate_ports("rad/s")
    disturbance, disturbance_deviation, disturbance_valid = estimate_ports("rad")
    total_offset, total_offset_deviation, total_offset_valid = estimate_ports("rad")
    missing = Out("1", direct=())

    vehicle: Vehicle
    """The car by its data sheet."""
    ratio_prior: float = number(0.25, "1", low=1e-4, high=0.5)
    """Standard deviation of the ratio, as a share of the data sheet's, to begin with [1]."""
    understeer_prior: float = number(0.001, "rad s^2/m", low=1e-7, high=0.02)
    """That of the understeer gradient [rad s^2/m]."""
    offset_prior: float = number(radians_of(3.0), "rad", low=1e-5, high=0.3)
    """That of the offset [rad]."""
    rate_zero_prior: float = number(0.005, "rad/s", low=1e-7, high=0.1)
    """That of the gyro's zero [rad/s]."""
    disturbance_prior: float = number(radians_of(0.2), "rad", low=1e-7, high=0.3)
    """That of the disturbance, at all times [rad]."""
    disturbance_time: float = number(2.0, "s", above=0.0, high=1e4)
    """For how long a disturbance lasts [s]."""
    play: float = number(0.5, "1", low=0.0, high=2.0)
    """Share of a free play of 2 degrees that is expected between angle and road wheels, with friction's loop [1]."""
    play_prior: float = number(0.5, "1", low=1e-4, high=2.0)
    """Its standard deviation [1]."""
    gyro_scale: float = number(0.05, "1", low=0.0, high=0.5)
    """Standard deviation of the gyro's scale, which looks like another ratio [1]."""
    bank: float = number(0.045, "rad", low=0.0, high=0.5)
    """That of a bank that lasts, which looks like another offset [rad]."""
    memory: float = number(50_000.0, "s", low=1.0, high=1e6)
    """Time of driving after which what was learned of ratio, understeer and play counts for 1/e [s]."""
    zero_memory: float = number(500_000.0, "s", low=1.0, high=1e6)
    """The same of the offset and the gyro's zero [s]: in an hour they may move by an eighth of their priors, 0.36
    degrees and 0.034 deg/s."""
    noise: float = number(radians_of(0.2), "rad/s", low=1e-6, high=1.0)
    """Standard deviation of the white noise on r [rad/s]."""
    psi_noise: float = number(radians_of(0.1), "rad", low=1e-6, high=1.0)
    """Standard deviation of what is wrong with psi [rad], at both ends of a window."""
    longest: float = 1.0
    """Longest delay [s], a multiple of dt; a longer one is taken for this."""
    held: bool = True
    """Is the angle a command, held for dt? Else it is measured, and at least dt late."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where = "SingleTrackFilter"
        require_vehicle(self.vehicle, where)
        require_within(where, "dt", self.dt, "s", 1e-3, _CORRELATED)
        longest = whole_samples(where, "longest", self.longest, self.dt)
        require(1 <= longest <= 100, where, f"longest = {self.longest} [s], expected 1 to 100 samples of {self.dt:g} s")

    @property
    def _first(self) -> int:
        """Where the six numbers begin in the state."""
        return _FILTERS + round(self.longest / self.dt) + 1

    @property
    def _variances(self) -> tuple[float, ...]:
        deviations = (self.ratio_prior, self.understeer_prior, self.offset_prior, self.rate_zero_prior)
        return tuple(deviation**2 for deviation in (*deviations, self.disturbance_prior, self.play_prior))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero, variances = m.filled(0.0, batch), self._variances
        numbers = (1.0, self.vehicle.understeer_gradient, 0.0, 0.0, 0.0, self.play)
        covariance = [[m.filled(variance, batch), *(zero,) * (_N - 1 - i)] for i, variance in enumerate(variances)]
        start = [zero] * self._first
        start[1], start[_WINDOWS] = m.filled(SLOWEST, batch), m.filled(_WINDOW / 8.0, batch)
        return (*start, *[m.filled(value, batch) for value in numbers], *kalman.packed(covariance))

    def output(self, t: Any, x: State, u: Any) -> Any:
        numbers, p = x[self._first : self._first + _N], kalman.unpacked(x[self._first + _N :], _N)
        g, understeer, offset, zero, disturbance, _ = numbers
        variances = self._variances
        total = (_OFFSET, _DISTURBANCE)
        deviations = [m.sqrt(row[0]) for row in p]
        bends = m.sqrt(understeer * understeer + p[1][0] + _SATURATES**2)
        found = (
            (1.0 / g, deviations[0] / (g * g), 0.03, self.gyro_scale / g),
            (understeer, m.sqrt(p[1][0] + _SOFT**2), 0.25 * math.sqrt(variances[1]), _SATURATES),
            (offset, deviations[2], radians_of(0.25), self.bank * G * self.vehicle.steer_ratio * bends),
            (zero, deviations[3], 0.001, 0.0),
            (disturbance, deviations[4], 0.5 * math.sqrt(variances[4]), 0.0),
            (offset + disturbance, m.sqrt(m.maximum(kalman.covariance(p, total, total), 0.0)), radians_of(0.35), 0.0),
        )
        flat: list[Scalar] = []
        for value, deviation, most, untold in found:
            flat += [value, m.sqrt(deviation * deviation + untold * untold), m.where(deviation <= most, 1.0, 0.0)]
        return self.Y(*flat, x[2])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        p, dt = self.vehicle, self.dt
        angle, v_before, _, since, w, beta, rate, stands, turned, clock, start, going, came = x[:13]
        window, turning, behind = x[13:_FILTERS]
        line, numbers = x[_FILTERS : self._first], x[self._first : self._first + _N]
        covariance = kalman.unpacked(x[self._first + _N :], _N)
        known, moves, turns, sure, steers = map(m.is_finite, (u.delta_sw, u.v, u.r, u.delay_deviation, u.active))
        given = m.both(m.is_finite(u.delay), m.is_finite(u.lag))
        read = m.every(known, moves, turns, given, sure, steers)
        v = m.where(moves, m.maximum(u.v, SLOWEST), v_before)
        drives = m.both(moves, u.v >= SLOWEST)
        acts = m.every(known, drives, given, u.active > 0.5)
        delay = m.where(given, m.clip(u.delay, 0.0, self.longest), 0.0)
        lag = m.where(given, m.clip(u.lag, 0.0, 2.0), 0.0)
        used = m.every(read, acts, since * dt > delay + 4.0 * lag + 0.3)
        r = m.where(turns, u.r, 0.0)
        # the six numbers
        times = (self.memory, self.memory, self.zero_memory, self.zero_memory, self.disturbance_time, self.memory)
        keeps = [m.where(drives, math.exp(-dt / time), 1.0) for time in times]
        numbers = (*numbers[:4], keeps[4] * numbers[4], numbers[5])
        fresh = {i: (1.0 - keep * keep) * variance for i, (keep, variance) in enumerate(zip(keeps, self._variances))}
        covariance = kalman.predict_covariance(covariance, (), keeps, fresh)
        expected, slopes = self._expected(numbers, w, behind, v)
        variance = self.noise**2 * _CORRELATED / dt
        late = turning * m.where(sure, u.delay_deviation, 0.0)
        uneven = slopes[2] * slopes[2] * (_ANGLE_ERROR**2 + late * late) * (_TOGETHER / dt)
        error = m.where(used, r - expected, 0.0)
        numbers, covariance, off = _corrected(numbers, covariance, slopes, error, variance + uneven, used)
        r = m.where(off > 4.0, expected, r)
        stands = m.where(m.both(moves, u.v < _STANDS), stands + dt, 0.0)
        stopped = m.both(turns, stands > _STANDING)
        only_zero: Sequence[Scalar] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
        numbers, covariance, _ = _corrected(numbers, covariance, only_zero, r - numbers[3], variance, stopped)
        # the heading against the gyro
        whole = m.both(turns, m.is_finite(u.psi))
        psi = m.where(m.is_finite(u.psi), u.psi, 0.0)
        ends = m.every(whole, going > 0.5, clock + 0.5 * dt >= window)
        half = 0.5 * dt * r  # the integral of r is that of lines between samples
        measured = m.wrap(turned + half - psi + start) / window
        variance = 2.0 * self.psi_noise**2 / (window * window) + self.noise**2 * dt / window
        numbers, covariance, _ = _corrected(numbers, covariance, only_zero, measured - numbers[3], variance, ends)
        begins = m.either(ends, m.both(whole, going < 0.5))
        start = m.where(begins, psi - half, start)
        window = m.where(ends, m.minimum(2.0 * window, _WINDOW), window)
        turned = m.where(begins, 0.0, turned) + r * dt
        clock = m.where(begins, 0.0, clock) + dt
        going = m.where(whole, 1.0, 0.0)
        # the angle on its way
        command = m.where(known, u.delta_sw, angle)
        delay = delay - (0.0 if self.held else dt)
        line, (corner, part, arrives) = arrived(line, command, delay, lag, dt, held=self.held)
        mean = 0.5 * (corner + part * came + (1.0 - part) * arrives)
        beta, rate = yaw_step(p, beta, rate, mean / p.steer_ratio, v, dt)
        turning = (rate / steady_gain(p, v) - w) / dt
        w = rate / steady_gain(p, v)
        since = m.where(acts, m.minimum(since + 1.0, 1e6), 0.0)
        missing, behind = m.where(read, 0.0, 1.0), w - m.clip(w - behind, -_GAP, _GAP)
        filters = (command, v, missing, since, w, beta, rate, stands, turned, clock, start, going, arrives)
        return (*filters, window, turning, behind, *line, *numbers, *kalman.packed(covariance))

    def _expected(self, numbers: State, w: Scalar, behind: Scalar, v: Scalar) -> tuple[Scalar, tuple[Scalar, ...]]:
        """What the gyro should say [rad/s], and its derivatives with respect to the six numbers.

        behind: w behind the free play.
        """
        p = self.vehicle
        g, understeer, offset, zero, disturbance, play = numbers
        length = p.wheelbase + understeer * v * v
        per_angle = v / (p.steer_ratio * length)
        angle = w - play * (w - behind) + offset + disturbance
        turn = per_angle * angle
        slope = g * per_angle
        slopes = (turn, -g * turn * v * v / length, slope, 1.0 + 0.0 * slope, slope, slope * (behind - w))
        return g * turn + zero, slopes


def _corrected(
    numbers: State, p: kalman.Covariance, slopes: Sequence[Scalar], error: Scalar, variance: Scalar, applies: Scalar
) -> tuple[State, kalman.Covariance, Scalar]:
    """Numbers and covariance after one measurement, where it `applies`; Huber's weight for one that is far off.

    And its squared error over that of 3 deviations.
    """
    if applies is False:  # one car: nothing is computed that changes nothing
        return numbers, p, 0.0
    share = [sum([entry * slope for entry, slope in zip(kalman.line(p, i), slopes)]) for i in range(_N)]
    of_model = sum([slope * value for slope, value in zip(slopes, share)])
    off = error * error / (_OUTLIER * _OUTLIER * (of_model + variance))
    weight = m.where(applies, 1.0 / (of_model + variance * m.maximum(off, 1.0)), 0.0)
    moved, p = kalman.drawn(numbers, p, share, weight, error)
    return tuple([m.clip(number, low, high) for number, (low, high) in zip(moved, _BOUNDS)]), p, off
