"""Where the car is and how it moves, from late and noisy measurements, the wheel's angle and a model of the car."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple

from steerkit._support.errors import number, require, require_within, whole_samples
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.estimators import kalman
from steerkit.estimators.estimate import estimate_ports
from steerkit.estimators.single_track_filter import SingleTrackFilter

X, Y, PSI, SWAY, R, V, A, D_X, D_Y, D_PSI, HEADING, GYRO, WHEEL = range(13)
"""The estimated numbers, in the order of the state: the motion with the acceleration, then errors of sensors."""
NEVER = 1e9
"""s: `unseen` of a car of which no position has come yet."""
_LEAST = 1e-10
"""Least variance of a measurement, in SI units: 0.01 mm or mm/s, 0.01 mrad or mrad/s."""
_ABSURD = 1e7
"""Metres, radians and the like by which a measurement is no measurement."""
_X_SUM, _Y_SUM = (X, D_X), (Y, D_Y)
"""What a measured position is the sum of."""
_N = 13
_ENTRIES = _N * (_N + 1) // 2
_UNKNOWN = (10.0, 10.0, 0.5, 0.5, 0.5, 5.0)
"""Standard deviations of x, y, psi, sway, r, v before anything was measured."""
_ACCELERATION, _ACCELERATION_TIME = 1.0, 1.0
"""Standard deviation of the car's acceleration [m/s^2], and its correlation time [s]."""
_ZERO_TIME = 1000.0
"""Correlation time of the zeros of gyro and wheel [s]."""
DOUBT_FROM = 7.0
"""Mean innovation, squared, over its variance, from which on the model is doubted [1]."""
_DOUBT_TIME = 0.5
"""Over which time that mean is taken [s]."""
_DOUBT_WHEEL, _DOUBT_BETA = radians_of(0.6), radians_of(0.3)
"""Doubt's noise of the steering wheel's zero and of the sideslip, a sample [rad]."""
_OUTAGE = 0.3
"""From which time without a position on it is an outage [s]."""
_UNHEARD = 2.0
"""How fast it may turn while its angle is not heard [rad/s]."""


class Measured(NamedTuple):
    """What was measured within half a sample of a time, NaN where nothing was."""

    x: Scalar
    y: Scalar
    psi: Scalar
    lead: Scalar
    """How much older than that time the pose is [s], negative where it is newer."""
    v: Scalar
    r: Scalar


ANY_ANGLE = 1e3
"""Larger angles of the steering wheel [rad] are none."""
SIZE = len(Measured._fields)


def sorted_in(buffer: State, pose: State, age: Scalar, motion: State, motion_age: Scalar, dt: float) -> list[Measured]:
    """What was measured now, a sample ago, and so on, with what has come in this sample; the oldest is due.

    buffer: the numbers of all but the newest and the last before this sample. pose: x, y, psi, of this age [s]; motion:
    v, r, of that age. What is older than the buffer, from the future, of no age or NaN is not put in; what comes twice
    for one sample replaces what came first.
    """
    slots = [Measured(*(math.nan,) * SIZE)]
    slots += [Measured._make(buffer[k : k + SIZE]) for k in range(0, len(buffer), SIZE)]
    found = m.is_finite(pose[0] + pose[1])
    pose_slot, motion_slot = m.floor(age / dt + 0.5), m.floor(motion_age / dt + 0.5)
    filled = []
    for k, old in enumerate(slots):
        place, now = m.both(pose_slot == k, found), motion_slot == k
        new_pose = [m.where(place, new, before) for new, before in zip((*pose, age - k * dt), old)]
        new_motion = [m.where(m.both(now, m.is_finite(new)), new, before) for new, before in zip(motion, old[4:])]
        filled.append(Measured(*new_pose, *new_motion))
    return filled


def turned_on(before: Scalar, held: Scalar, zero: Scalar, heard: Scalar) -> tuple[Scalar, ...]:
    """The steering wheel in a sample after which its angle is heard, or NaN: its angle before and after [rad], its zero
    [rad], whether the angle after it was not heard, and whether either was not [1].

    While it is not, its angle is held, and what it turns goes into the zero. Once it is heard again, angle and zero add
    up to what they did, so that the zero is what it was.
    """
    there = m.absolute(heard) < ANY_ANGLE
    after = m.where(there, heard, before)
    back = m.both(there, held > 0.5)
    missing = m.where(there, 0.0, 1.0)
    start, zero = m.where(back, after, before), m.where(back, zero + before - after, zero)
    return start, after, zero, missing, m.where(back, 1.0, missing)


Rhs = Callable[[Sequence[Scalar], Scalar, Scalar], Sequence[Scalar]]
"""(x', y', psi', sway', r') = rhs((x, y, psi, sway, r), delta, v): a plant's own, on floats, batches and symbols."""


def sway_is_speed(rhs: Rhs) -> bool:
    """Is its sway v_y [m/s], and v the speed along the car's axis? Else it is beta [rad]."""
    return bool(rhs((0.0, 0.0, 0.0, 0.01, 0.0), 0.0, 5.0)[1] < 0.03)


_GAMMA = 1.0 - math.sqrt(0.5)
_DOUBLED = 2
"""How often a step of h/4 is doubled."""
_APART = 1e-4
"""By how much a state is moved to see what the rates owe to it [m/s, rad, rad/s]."""


def reach_of(rhs: Rhs, x: Sequence[Scalar], delta: Scalar, v: Scalar, h: float) -> tuple[Scalar, ...]:
    """h phi(h J), rows of (sway, r): how far (sway', r') carry the car about x = (x, y, psi, sway, r) in h [s].

    delta: road-wheel angle [rad]; v: speed [m/s]. J = d(sway', r')/d(sway, r) is of differences of `rhs`. With
    g = 1 - sqrt(1/2) and M = (I - g k J)^-1,

        reach(k) = k M^2 (I - g^2 k J) ~ k phi(k J),  keeps(k) = I + reach(k) J ~ exp(k J),
        reach(2 k) = (I + keeps(k)) reach(k),  keeps(2 k) = keeps(k)^2,

    from k = h/4, rational and L-stable, for at walking pace sway and r settle within a fraction of a sample, where
    explicit steps blow up. source: Hairer, Wanner 1996, section IV.7 (Rosenbrock methods); Hochbruck, Ostermann 2010
    (phi); Moler, Van Loan 2003 (doubling).
    """
    *pose, sway, r = x
    rate, by_sway, by_r = (rhs((*pose, *at), delta, v) for at in ((sway, r), (sway + _APART, r), (sway, r + _APART)))
    j11, j12, j21, j22 = jacobian = [(by[i] - rate[i]) / _APART for i in (3, 4) for by in (by_sway, by_r)]
    k = h / 2**_DOUBLED
    m11, m12, m21, m22 = 1.0 - _GAMMA * k * j11, -_GAMMA * k * j12, -_GAMMA * k * j21, 1.0 - _GAMMA * k * j22
    det = m11 * m22 - m12 * m21
    inverse = (m22 / det, -m12 / det, -m21 / det, m11 / det)
    q = _GAMMA * _GAMMA * k
    reach = _product(_product(inverse, inverse), (k * (1.0 - q * j11), -k * q * j12, -k * q * j21, k * (1.0 - q * j22)))
    keeps = _with_one(_product(reach, jacobian))
    for _ in range(_DOUBLED):
        reach, keeps = _product(_with_one(keeps), reach), _product(keeps, keeps)
    return reach


def _product(one: Sequence[Scalar], other: Sequence[Scalar]) -> tuple[Scalar, ...]:
    """That of two (2, 2) matrices, each by its rows."""
    a, b, c, d = one
    e, f, g, h = other
    return a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


def _with_one(matrix: Sequence[Scalar]) -> tuple[Scalar, ...]:
    """I + a (2, 2) matrix."""
    a, b, c, d = matrix
    return 1.0 + a, b, c, 1.0 + d


def moved(
    rhs: Rhs, x: Sequence[Scalar], delta: Scalar, v: Scalar, h: float, reach: Sequence[Scalar]
) -> tuple[Scalar, ...]:
    """x = (x, y, psi, sway, r) h [s] later: (sway, r) by their rate and reach, the pose by the midpoint between.

    reach: `reach_of` there, or at a state a few samples before.
    """
    px, py, psi, sway, r = x
    *_, sway_dot, r_dot = rhs(x, delta, v)
    sway_after = sway + reach[0] * sway_dot + reach[1] * r_dot
    r_after = r + reach[2] * sway_dot + reach[3] * r_dot
    turn = 0.5 * h * (r + r_after)
    middle = rhs((px, py, psi + 0.5 * turn, 0.5 * (sway + sway_after), 0.5 * (r + r_after)), delta, v)
    return px + h * middle[0], py + h * middle[1], psi + turn, sway_after, r_after


def motion_rows(
    rhs: Rhs, x: Sequence[Scalar], delta: Scalar, v: Scalar, h: float, steer_ratio: Scalar
) -> tuple[tuple[Scalar, ...], list[kalman.Row]]:
    """x after h [s], and how x, y, psi, sway, r, v then depend on all before, sparse: by differences of `moved`.

    But what sway does to x and y is that of `rhs` for all of h: a slide that the model does not know lasts, where that
    of the model dies out within the sample. With less, a gyro that lies leads the position twice as far astray.
    """
    reach = reach_of(rhs, x, delta, v, h)
    after = moved(rhs, x, delta, v, h, reach)
    *pose, sway, r = x
    others = {
        SWAY: ((*pose, sway + _APART, r), delta, v),
        R: ((*pose, sway, r + _APART), delta, v),
        V: (x, delta, v + _APART),
        WHEEL: (x, delta + _APART / steer_ratio, v),
    }
    by = {j: [(b - a) / _APART for a, b in zip(after, moved(rhs, *at, h, reach))] for j, at in others.items()}
    rate, swayed = (rhs(at, delta, v) for at in (x, others[SWAY][0]))
    by[SWAY][:2] = [h * (b - a) / _APART for a, b in zip(rate[:2], swayed)]
    by[A] = [h * slope for slope in by[V]]
    rows = [{j: slopes[i] for j, slopes in by.items()} for i in range(5)]
    rows[X] |= {X: 1.0, PSI: x[Y] - after[Y]}
    rows[Y] |= {Y: 1.0, PSI: after[X] - x[X]}
    rows[PSI] |= {PSI: 1.0}
    return after, [*rows, {V: 1.0, A: h}]


def course(rhs: Rhs, sway: Scalar, r: Scalar, delta: Scalar, v: Scalar) -> tuple[Scalar, Scalar]:
    """Speed of the centre of gravity [m/s] and sideslip [rad] of a car with this sway, whatever `rhs` calls sway."""
    ahead, aside, *_ = rhs((0.0 * v, 0.0 * v, 0.0 * v, sway, r), delta, v)
    return m.sqrt(ahead * ahead + aside * aside), m.atan2(aside, ahead)


class Memory(NamedTuple):
    """What the filter has to know of earlier measurements.

    unseen: time since the last position that was used [s]. position, speed, gyro, heading: for how long these have been
    rejected [s]. turning, turned, aside: innovations of gyro, heading and to the side over their deviation, averaged
    over 0.5 s [1]. wheel: the steering wheel's angle at the filter's time [rad]; held: is it, as none was heard?
    rejected, missing: was a measurement of the last sample rejected, or not there? nis, nis_count: sum of its squared
    normalised innovations, and how many there were [1].
    """

    unseen: Scalar
    position: Scalar
    speed: Scalar
    gyro: Scalar
    heading: Scalar
    turning: Scalar
    turned: Scalar
    aside: Scalar
    wheel: Scalar
    held: Scalar
    rejected: Scalar
    missing: Scalar
    nis: Scalar
    nis_count: Scalar


class Followed(NamedTuple):
    """With `steering`: the motion that was measured a sample before, the last v that was a number (speed [m/s]), which
    counts for the sample after it, and the car's numbers in use."""

    v: Scalar
    r: Scalar
    psi: Scalar
    age: Scalar
    speed: Scalar
    ratio: Scalar
    understeer: Scalar
    offset: Scalar
    rate_zero: Scalar


_FOLLOWED = len(Followed._fields)
FOLLOWED = {
    "ratio": (0.6, 1.6, 0.1),
    "understeer": (-0.02, 0.02, 5e-4),
    "offset": (-radians_of(10.0), radians_of(10.0), radians_of(1.0)),
    "rate_zero": (-radians_of(1.0), radians_of(1.0), radians_of(0.1)),
}
"""Least and most of what is used of a car's numbers, and how fast they change [a second]: ratio over the data sheet's
[1], understeer gradient [rad s^2/m], offset [rad], the gyro's zero [rad/s]."""
_AGE_UNKNOWN = 0.01
"""Standard deviation of the time between what is measured of the wheel and of the motion [s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class VehicleState(Block):
    """An extended Kalman filter of pose, sideslip and yaw rate, predicted to now, with their deviations.

    Use it between poor sensors and any controller: it takes noise, latency, gaps and jumps, and needs no measured
    sideslip. The state is x, y, psi, sway, r of `rhs` (a plant's own equations), v and its derivative a, and the errors
    of the sensors, each a Gauss-Markov process with the deviation and time of its data sheet:

    x_in = x + d_x,  y_in = y + d_y,  psi_in = psi + d_psi + heading_bias,  r_in = r + gyro_zero,  v_in = speed,
    (x, y, psi, sway, r)' = rhs((x, y, psi, sway, r), (delta_sw_meas + wheel_offset)/steer_ratio, v),
    d(t + dt) = f d(t) + sqrt(1 - f^2) n,  f = exp(-dt/time).

    v is taken as the mean over the sample before, as pulses of wheels give it. The model's noise: r is off by
    kappa_error v, the sideslip by beta_error, and the wheel by wheel_error times every turn of it.

    *Late measurements.* The filter's time is `horizon` + dt before now. Measurements are put, by their age, into a
    buffer of samples; one comes out of it each time, is moved to the sample's time along the car's course, and
    filtered. So order and lateness up to `horizon` do not matter, a stamp that comes twice counts once; what is later
    counts as missing. From there the model predicts to now under the wheel's angles, which are not late.

    *Jumps.* A measurement further off than `gate` deviations is rejected. If it stays so for `patience`, it is
    accepted: motion and sensor are then each as uncertain as the jump is large. *Outages* are bridged by the model and
    whatever still arrives, under deviations that grow. *Doubt.* If innovations to the side, of the heading or of the
    gyro keep one sign (their mean over 0.5 s beyond sqrt(7) deviations of it), the car is not as modelled: a ratio,
    tyres, wind. Noise of wheel and sideslip is then raised by the excess times 0.6 and 0.3 degrees a sample, squared.

    *A car that is not as on its data sheet.* With `steering`, a filter of the measured wheel and the gyro, the ratio
    (as a multiple g of the data sheet's), the understeer gradient K', the offset and the gyro's zero are used as they
    are found:

        angle = (delta_sw_meas + offset)/g (L + K v^2)/(L + K' v^2),   rate = r_in - rate_zero

    take the place of delta_sw_meas and r_in: the angle at which the car of the data sheet, L, K, turns as fast. What is
    used starts with the data sheet and follows an estimate while that is valid, no faster and no further than
    `FOLLOWED` says. Remaining zeros are in gyro_zero and wheel_offset.

    inputs: x_in, y_in [m], psi_in [rad] (any turn) of the centre of gravity, and their age_in [s]; v_in [m/s] and r_in
    [rad/s], and their motion_age_in [s]; NaN where nothing came. delta_sw_meas [rad], now; NaN: as before.
    outputs, at this time: x, y, psi, v, beta, r (NaN before the first position); standard deviations: side_deviation
    [m] (across the car), psi_deviation, beta_deviation [rad], r_deviation [rad/s]; outage [1]: was no position used for
    0.3 s? rejected, missing [1]: was a measurement of the last sample rejected, or not there? doubt [1], the excess;
    gyro_zero [rad/s], heading_bias, wheel_offset [rad] with gyro_zero_deviation, heading_bias_deviation,
    wheel_offset_deviation, and gyro_zero_valid, heading_bias_valid, wheel_offset_valid [1]: is the deviation at most
    half of that at first? nis, nis_count [1]: sum and number of the last sample's normalised innovations squared of
    position, heading and gyro, of mean 1 each if the deviations are right; ratio [1] in use over the data sheet's.
    All but nis follow from the state and the wheel. state: 13 means, 91 covariances (upper triangle), the wheel's last
    angles, the buffer, `Memory`; with `steering` its state and `Followed`.
    valid: forward driving; a v below 0 counts as 0. In a batch parameters may be `(N,)` arrays. errors: ValueError for
    a `steering` that is made for commands or has another sample time. source: Gelb 1974, ch. 4 and 6; Bar-Shalom, Li,
    Kirubarajan 2001, sections 5.4 (normalised innovations) and 11.6 (adaptive noise); Astrom, Wittenmark 1995, section
    3.1 (certainty equivalence); Rajamani 2012, section 3.3.
    """

    x_in = In("m")
    y_in = In("m")
    psi_in = In("rad")
    age_in = In("s")
    v_in = In("m/s")
    r_in = In("rad/s")
    motion_age_in = In("s", direct=False)
    delta_sw_meas = In("rad")

    x = Out("m", direct=(delta_sw_meas,))
    y = Out("m", direct=(delta_sw_meas,))
    psi = Out("rad", direct=(delta_sw_meas,))
    v = Out("m/s", direct=(delta_sw_meas,))
    beta = Out("rad", direct=(delta_sw_meas,))
    r = Out("rad/s", direct=(delta_sw_meas,))
    side_deviation = Out("m", direct=(delta_sw_meas,))
    psi_deviation = Out("rad", direct=())
    beta_deviation = Out("rad", direct=())
    r_deviation = Out("rad/s", direct=())
    outage = Out("1", direct=())
    rejected = Out("1", direct=())
    missing = Out("1", direct=())
    doubt = Out("1", direct=())
    gyro_zero, gyro_zero_deviation, gyro_zero_valid = estimate_ports("rad/s")
    heading_bias, heading_bias_deviation, heading_bias_valid = estimate_ports("rad")
    wheel_offset, wheel_offset_deviation, wheel_offset_valid = estimate_ports("rad")
    nis = Out("1", direct=())
    nis_count = Out("1", direct=())
    ratio = Out("1", direct=())

    rhs: Rhs
    """The car's motion: a plant's `rhs`."""
    steer_ratio: Scalar = number(15.6, "1", low=1.0, high=100.0)
    """Steering-wheel angle over road-wheel angle [1]."""
    horizon: float = 0.1
    """How old a measurement may be to be used [s], a multiple of dt; up to half a sample more counts as this."""
    position_noise: Scalar = number(0.0, "m", low=0.0, high=10.0)
    """White noise on x and on y: standard deviation [m]. This and the next: the sensors' data sheet."""
    position_drift: Scalar = number(0.01, "m", low=0.0, high=10.0)
    """Slow error of x and of y: standard deviation [m]."""
    psi_noise: Scalar = number(0.0, "rad", low=0.0, high=10.0)
    """White noise on psi [rad]."""
    psi_drift: Scalar = number(radians_of(0.1), "rad", low=0.0, high=10.0)
    """Slow error of psi [rad]."""
    drift_time: float = number(2.0, "s", above=0.0, high=1e5)
    """Correlation time of the slow errors [s]."""
    v_noise: Scalar = number(0.0, "m/s", low=0.0, high=10.0)
    """White noise on v [m/s]."""
    r_noise: Scalar = number(radians_of(0.2), "rad/s", low=0.0, high=10.0)
    """White noise on r [rad/s]."""
    heading_drift: Scalar = number(radians_of(0.05), "rad", low=0.0, high=10.0)
    """Very slow error of psi, mounting included [rad]."""
    heading_time: float = number(60.0, "s", above=0.0, high=1e5)
    """Its correlation time [s]."""
    gyro_drift: Scalar = number(radians_of(0.05), "rad/s", low=0.0, high=10.0)
    """What may be wrong with the gyro's zero [rad/s]."""
    wheel_drift: Scalar = number(radians_of(0.3), "rad", low=0.0, high=10.0)
    """What may be wrong with the steering wheel's zero [rad]."""
    kappa_error: Scalar = number(2e-4, "1/m", low=0.0, high=10.0)
    """White error of the model's yaw rate over v [1/m]."""
    beta_error: Scalar = number(radians_of(0.05), "rad", low=0.0, high=10.0)
    """White error of the model's sideslip [rad]."""
    wheel_error: Scalar = number(0.01, "1", low=0.0, high=10.0)
    """Share by which a turn of the wheel may do more or less than the model says [1]."""
    gate: float = number(4.5, "1", above=0.0, high=1e5)
    """Deviations by which a measurement may be off to be used [1]."""
    patience: float = number(0.5, "s", above=0.0, high=1e5)
    """For how long measurements are rejected before they are believed [s]."""
    steering: SingleTrackFilter | None = None
    """Finds ratio, understeer gradient and zeros from the measured wheel (held=False); None: the car is as modelled."""

    @classmethod
    def of(cls, car: Any, **numbers: Any) -> "VehicleState":
        """The filter for a single-track plant: its `rhs`, and the ratio of its `vehicle`. numbers: other fields."""
        expected = "expected a single-track plant: LinearSingleTrack(vehicle=...), NonlinearSingleTrack(vehicle=...)"
        require(hasattr(car, "rhs"), "VehicleState", f"{type(car).__name__} has no rhs; {expected}")
        return cls(**({"rhs": car.rhs, "steer_ratio": car.vehicle.steer_ratio} | numbers))

    def __post_init__(self) -> None:
        super().__post_init__()
        where = "VehicleState"
        require(callable(self.rhs), where, f"rhs = {self.rhs!r}, expected a function, such as a plant's rhs")
        require_within(where, "dt", self.dt, "s", 1e-3, 0.2)
        whole_samples(where, "horizon", self.horizon, self.dt)
        require_within(where, "horizon", self.horizon, "s", 0.0, 1.0)
        if self.steering is not None:
            same = f"dt = {self.dt}, steering.dt = {self.steering.dt} [s], expected the same"
            require(self.dt == self.steering.dt, where, same)
            require(not self.steering.held, where, "steering.held = True, expected False: the wheel is measured")

    @cached_property
    def _behind(self) -> int:
        """Samples from the filter's time to now."""
        return 1 + round(self.horizon / self.dt)

    @cached_property
    def _ends(self) -> tuple[int, ...]:
        """Where in the state the means end, the covariances, the wheel's angles, the buffer, and the memory."""
        last = self._behind - 1
        return tuple(accumulate((_N, _ENTRIES, last, SIZE * last, len(Memory._fields))))

    @cached_property
    def _processes(self) -> tuple[tuple[float, Scalar], ...]:
        """f and deviation of a and of the six errors of sensors."""
        processes = (
            (_ACCELERATION_TIME, _ACCELERATION),
            *[(self.drift_time, self.position_drift)] * 2,
            (self.drift_time, self.psi_drift),
            (self.heading_time, self.heading_drift),
            (_ZERO_TIME, self.gyro_drift),
            (_ZERO_TIME, self.wheel_drift),
        )
        return tuple([(math.exp(-self.dt / time), deviation) for time, deviation in processes])

    @cached_property
    def _sideways(self) -> bool:
        return sway_is_speed(self.rhs)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero, nan = m.filled(0.0, batch), m.filled(math.nan, batch)
        deviations = (*_UNKNOWN, *[deviation for _, deviation in self._processes])
        p = [[m.filled(d * d, batch), *(zero,) * (_N - 1 - i)] for i, d in enumerate(deviations)]
        memory = (m.filled(NEVER, batch), *(zero,) * (len(Memory._fields) - 1))
        last = self._behind - 1
        own = (*(zero,) * _N, *kalman.packed(p), *(zero,) * last, *(nan,) * (SIZE * last), *memory)
        if self.steering is None:
            return own
        sheet = (zero, 1.0 + zero, self.steering.vehicle.understeer_gradient + zero, zero, zero)
        return (*own, *self.steering.init(batch), *(nan,) * 4, *sheet)

    def _parts(self, x: State) -> tuple[State, State, State, State, Memory]:
        """Means, covariances, the wheel's angles since the filter's time, the buffer, and the memory of a state."""
        a, b, c, d, e = self._ends
        return x[:a], x[a:b], x[b:c], x[c:d], Memory._make(x[d:e])

    def settle(self, t: float, x: State, u: Any) -> State:
        """The car as first measured, moved back to the filter's time; what was not measured counts as 0."""
        given, u = u, self._as_modelled(x, u)
        x_in, y_in, psi, age, v, r, wheel = (m.where(m.is_finite(value), value, 0.0) for value in u)
        back = self._behind * self.dt - age
        way, middle = back * m.maximum(v, 0.0), psi - 0.5 * back * r
        start = (x_in - way * m.cos(middle), y_in - way * m.sin(middle), psi - back * r, 0.0 * v, r, v)
        mean, entries, wheels, buffer, memory = self._parts(x)
        memory = memory._replace(
            unseen=m.where(m.is_finite(u.x_in + u.y_in), 0.0 * v, memory.unseen),
            wheel=wheel,
            held=m.where(m.absolute(u.delta_sw_meas) < ANY_ANGLE, 0.0, 1.0),
        )
        own = (*start, *mean[len(start) :], *entries, *(wheel,) * len(wheels), *buffer, *memory)
        if self.steering is None:
            return own
        speed = m.where(m.is_finite(given.v_in), given.v_in, 0.0)
        return (*own, *x[len(own) : -_FOLLOWED], *self._followed(x)._replace(speed=speed))

    def output(self, t: Any, x: State, u: Any) -> Any:
        u = self._as_modelled(x, u)
        mean, entries, wheels, _, memory = self._parts(x)
        motion, reach = mean[:V], ()
        v = delta = 0.0
        wheel, zero, held = memory.wheel, mean[WHEEL], memory.held
        for i, heard in enumerate((*wheels, u.delta_sw_meas), 1):
            v = m.maximum(mean[V] + i * self.dt * mean[A], 0.0)
            before, wheel, zero, held, _ = turned_on(wheel, held, zero, heard)
            delta = (0.5 * (before + wheel) + zero) / self.steer_ratio
            reach = reach or reach_of(self.rhs, motion, delta, v, self.dt)
            motion = moved(self.rhs, motion, delta, v, self.dt, reach)
        px, py, psi, sway, r = motion
        speed, beta = course(self.rhs, sway, r, delta, v)
        never = memory.unseen >= NEVER
        shown = [m.where(never, math.nan, value) for value in (px, py, psi, speed, beta, r)]
        p = kalman.unpacked(entries, _N)
        c, s, ahead = m.cos(psi), m.sin(psi), self._behind * self.dt * v
        xx, xy, x_psi = p[X][:3]
        yy, y_psi = p[Y][:2]
        turned = 2.0 * ahead * (c * y_psi - s * x_psi) + ahead * ahead * p[PSI][0]
        side = s * s * xx - 2.0 * s * c * xy + c * c * yy + turned
        deviation = [m.sqrt(m.maximum(variance, 0.0)) for variance in (side, *[row[0] for row in p])]
        psi_d, sway_d, r_d = deviation[1 + PSI], deviation[1 + SWAY], deviation[1 + R]
        gyro, heading, offset, ratio = mean[GYRO], mean[HEADING], mean[WHEEL], 1.0
        if self.steering is not None:
            used = self._followed(x)
            gyro, offset, ratio = gyro + used.rate_zero, used.ratio * offset + used.offset, used.ratio
        zeros: list[Scalar] = []
        for i, value in ((GYRO, gyro), (HEADING, heading), (WHEEL, offset)):
            valid = m.where(deviation[1 + i] <= 0.5 * self._processes[i - A][1], 1.0, 0.0)
            zeros += [value, deviation[1 + i], valid]
        return self.Y(
            *shown,
            deviation[0],
            psi_d,
            sway_d / m.maximum(mean[V], 1.0) if self._sideways else sway_d,
            r_d,
            m.where(memory.unseen > _OUTAGE, 1.0, 0.0),
            memory.rejected,
            memory.missing,
            self._excess(memory),
            *zeros,
            memory.nis,
            memory.nis_count,
            ratio,
        )

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        given, u = u, self._as_modelled(x, u)
        mean, entries, wheels, buffer, memory = self._parts(x)
        pose, motion = (u.x_in, u.y_in, u.psi_in), (u.v_in, u.r_in)
        *waiting, due = sorted_in(buffer, pose, u.age_in, motion, u.motion_age_in, self.dt)
        v = m.maximum(mean[V] + self.dt * mean[A], 0.0)
        wheels = (*wheels, u.delta_sw_meas)
        start, wheel, zero, held, unsure = turned_on(memory.wheel, memory.held, mean[WHEEL], wheels[0])
        delta = (0.5 * (start + wheel) + zero) / self.steer_ratio
        after, rows = motion_rows(self.rhs, mean[:V], delta, v, self.dt, self.steer_ratio)
        noise = self._noise(v, rows, wheel - start, unsure, memory)
        kept = [f for f, _ in self._processes]
        p = kalman.predict_covariance(kalman.unpacked(entries, _N), rows, kept, noise)
        drifted = [f * value for f, value in zip(kept, (*mean[A:WHEEL], zero))]
        mean = (*after, mean[V] + self.dt * mean[A], *drifted)
        corrected_mean, p, memory = self._corrected(mean, p, due, memory, delta)
        whole = m.both(m.absolute(u.delta_sw_meas) < ANY_ANGLE, m.is_finite(due.x + due.y + due.psi + due.v + due.r))
        memory = memory._replace(wheel=wheel, held=held, missing=m.where(whole, 0.0, 1.0))
        slots = [value for one in waiting for value in one]
        own = (*corrected_mean, *kalman.packed(p), *wheels[1:], *slots, *memory)
        return own if self.steering is None else (*own, *self._follow(self.steering, t, x, given))

    def _followed(self, x: State) -> Followed:
        return Followed._make(x[-_FOLLOWED:])

    def _as_modelled(self, x: State, u: Any) -> Any:
        """The inputs with the wheel of the data sheet's car that turns as this one does, and the gyro without zero."""
        if self.steering is None:
            return u
        used, car = self._followed(x), self.steering.vehicle
        square = used.speed * used.speed
        bent = (car.wheelbase + car.understeer_gradient * square) / (car.wheelbase + used.understeer * square)
        wheel = bent * (u.delta_sw_meas + used.offset) / used.ratio
        return u._replace(delta_sw_meas=wheel, r_in=u.r_in - used.rate_zero)

    def _follow(self, steering: SingleTrackFilter, t: Any, x: State, u: Any) -> State:
        """The state of `steering` and what is used of it, a sample later."""
        state, before = x[self._ends[-1] : -_FOLLOWED], self._followed(x)
        found = steering.output(t, state, ())
        # the motion of a sample before, with the wheel of this one: then it is late by a sample at least
        late = before.age + self.dt
        watched = steering.U(u.delta_sw_meas, before.v, before.r, before.psi, late, 0.0, _AGE_UNKNOWN, 1.0)
        valid = {name: getattr(found, f"{name}_valid") for name in FOLLOWED}
        valid["understeer"] = found.ratio_valid  # at one speed they are known together
        used = {}
        for name, (low, high, rate) in FOLLOWED.items():
            value, now, most = getattr(found, name), getattr(before, name), rate * self.dt
            step = m.clip(m.clip(value, low, high) - now, -most, most)
            used[name] = now + m.where(m.both(valid[name] > 0.5, m.is_finite(value)), step, 0.0)
        speed = m.where(m.is_finite(u.v_in), u.v_in, before.speed)
        followed = Followed(u.v_in, u.r_in, u.psi_in, u.motion_age_in, speed, **used)
        return (*steering.update(t, state, watched, found), *followed)

    def _noise(
        self, v: Scalar, rows: Sequence[kalman.Row], turned: Scalar, unsure: Scalar, memory: Memory
    ) -> dict[int, Scalar]:
        """Variance that a sample adds to each number; sway and r forget theirs as fast as they settle.

        turned: by how much the wheel did [rad]; unsure: was its angle not heard?
        """
        excess, moving = self._excess(memory), m.minimum(v * v, 1.0)
        sideways = v * v if self._sideways else moving
        fresh_sway, fresh_r = (m.maximum(1.0 - rows[i][i] * rows[i][i], 0.0) for i in (SWAY, R))
        noise = {
            SWAY: sideways * (self.beta_error**2 * fresh_sway + excess * _DOUBT_BETA**2),
            R: (1.0 + excess) * fresh_r * self.kappa_error**2 * v * v,
        }
        for i, (kept, deviation) in enumerate(self._processes, A):
            noise[i] = (1.0 - kept * kept) * deviation * deviation
        unheard = unsure * (_UNHEARD * self.dt) ** 2
        known = self.wheel_error**2 * turned * turned + excess * moving * _DOUBT_WHEEL**2
        noise[WHEEL] = noise[WHEEL] + known + unheard
        return noise

    def _excess(self, memory: Memory) -> Scalar:
        """By how much innovations keep one sign beyond what chance makes of them [1]."""
        share = self.dt / _DOUBT_TIME
        usual = share / (2.0 - share)
        squares = [mean * mean for mean in (memory.aside, memory.turned, memory.turning)]
        largest = m.maximum(squares[0], m.maximum(squares[1], squares[2]))
        return m.clip(largest / (DOUBT_FROM * usual) - 1.0, 0.0, 100.0)

    def _corrected(
        self, mean: Sequence[Scalar], p: kalman.Covariance, due: Measured, memory: Memory, delta: Scalar
    ) -> tuple[Sequence[Scalar], kalman.Covariance, Memory]:
        """Means and covariances after what was measured at their time, and what is to be remembered of it."""
        speed, _ = course(self.rhs, mean[SWAY], mean[R], delta, mean[V])
        speed = m.where(mean[V] < 0.0, mean[V], speed)  # a hard stop overshoots, and has no other way back
        nis = count = rejected = 0.0
        waits, means = [], []
        # speed, yaw rate and heading, one by one, each against what is known after those before it
        for k, (states, doubted, deviation) in enumerate(
            (
                ((V,), (V,), self.v_noise),
                ((R, GYRO), (R, GYRO), self.r_noise),
                ((PSI, D_PSI, HEADING), (PSI, HEADING), self.psi_noise),
            )
        ):
            known = sum([mean[i] for i in states])
            missed = (due.v - speed, due.r - known, m.wrap(due.psi + due.lead * mean[R] - known))[k]
            noise = deviation**2 + _LEAST
            square = missed * missed / (kalman.covariance(p, states, states) + noise)
            here = m.absolute(missed) < _ABSURD
            used, lasted, wait = self._judged(square, here, memory[2 + k])
            p = kalman.widened(p, {i: m.where(lasted, missed * missed, 0.0) for i in doubted})
            mean, p = kalman.corrected(mean, p, states, missed, noise, used)
            rejected = m.where(m.both(here, wait > 0.0), 1.0, rejected)
            waits.append(wait)
            if k > 0:
                means.append(self._mean_of(memory[4 + k], m.sign(missed) * m.sqrt(square), here))
                nis, count = nis + m.where(here, square, 0.0), count + m.where(here, 1.0, 0.0)
        # the position, as a whole
        way_x, way_y, *_ = self.rhs((*mean[:PSI], mean[PSI] - 0.5 * due.lead * mean[R], *mean[SWAY:V]), delta, mean[V])
        x, y = due.x + due.lead * way_x, due.y + due.lead * way_y
        noise, never = self.position_noise**2 + _LEAST, memory.unseen >= NEVER
        missed_x, missed_y = x - mean[X] - mean[D_X], y - mean[Y] - mean[D_Y]
        xx, yy = kalman.covariance(p, _X_SUM, _X_SUM) + noise, kalman.covariance(p, _Y_SUM, _Y_SUM) + noise
        xy = kalman.covariance(p, _X_SUM, _Y_SUM)
        distance = yy * missed_x * missed_x - 2.0 * xy * missed_x * missed_y + xx * missed_y * missed_y
        distance = distance / (xx * yy - xy * xy)
        here = m.both(m.absolute(missed_x) < _ABSURD, m.absolute(missed_y) < _ABSURD)
        used, lasted, wait = self._judged(0.5 * distance, here, m.where(never, 2.0 * self.patience, memory.position))
        more_x, more_y = (m.where(lasted, missed * missed, 0.0) for missed in (missed_x, missed_y))
        moved_on = m.where(never, 0.0, 1.0)
        p = kalman.widened(p, {X: more_x, Y: more_y, D_X: moved_on * more_x, D_Y: moved_on * more_y})
        c, s = m.cos(mean[PSI]), m.sin(mean[PSI])
        across = m.sqrt(m.maximum(c * c * yy - 2.0 * s * c * xy + s * s * xx, _LEAST))
        means.append(self._mean_of(memory.aside, (c * missed_y - s * missed_x) / across, here))
        nis, count = nis + m.where(here, distance, 0.0), count + m.where(here, 2.0, 0.0)
        rejected = m.where(m.both(here, wait > 0.0), 1.0, rejected)
        mean, p = kalman.corrected(mean, p, _X_SUM, missed_x, noise, used)
        mean, p = kalman.corrected(mean, p, _Y_SUM, y - mean[Y] - mean[D_Y], noise, used)
        unseen = m.where(used, 0.0, memory.unseen + self.dt)
        return (
            mean,
            p,
            Memory._make((unseen, wait, *waits, *means, memory.wheel, memory.held, rejected, 0.0, nis, count)),
        )

    def _judged(self, square: Scalar, here: Scalar, wait: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Is a measurement used; is it, as it has been off for long; and for how long it is now."""
        near = square <= self.gate * self.gate
        wait = m.where(here, m.where(near, 0.0, wait + self.dt), wait)
        lasted = m.both(here, wait > self.patience)
        return m.both(here, m.either(near, lasted)), lasted, m.where(lasted, 0.0, wait)

    def _mean_of(self, slow: Scalar, missed: Scalar, here: Scalar) -> Scalar:
        """The running mean of innovations over their deviation, each within the gate."""
        step = self.dt / _DOUBT_TIME * (m.clip(missed, -self.gate, self.gate) - slow)
        return m.where(here, slow + step, slow)
