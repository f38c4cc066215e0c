"""Where the car is and how it moves, from late and noisy measurements, the wheel's angle and a model of the car."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from steerkit._support.errors import require, require_within, whole_samples
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.estimators.arrivals import ANY_ANGLE, SIZE, Wheel, sorted_in, turned_on
from steerkit.estimators.correction import GYRO, HEADING, NEVER, PSI, SWAY, WHEEL, A, Correction, Memory, R, V, X, Y
from steerkit.estimators.gauss import Row, packed, predict_covariance, unpacked
from steerkit.estimators.motion import Answer, Rhs, answer, course, moved
from steerkit.task import DT

_N = 13
_ENTRIES = _N * (_N + 1) // 2
_UNKNOWN = (10.0, 10.0, 0.5, 0.5, 0.5, 5.0)
"""Standard deviations of x, y, psi, sway, r, v before anything was measured."""
_UNHEARD = 2.0
"""How fast it may turn while its angle is not heard [rad/s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class VehicleState(Block):
    """An extended Kalman filter of pose, sideslip and yaw rate, which predicts to now and says how well it knows them.

    Put it between poor sensors and any controller: noise, latency, gaps and jumps stay here, and sideslip need not be
    measured. The state is x, y, psi, sway, r of `rhs` (a plant's own equations), v and its derivative a, and the errors
    of the sensors, each a Gauss-Markov process with the deviation and time of its data sheet:

    x_in = x + d_x,  y_in = y + d_y,  psi_in = psi + d_psi + heading_bias,  r_in = r + gyro_zero,  v_in = speed,
    (x, y, psi, sway, r)' = rhs((x, y, psi, sway, r), (delta_sw_meas + wheel_offset)/steer_ratio, v),
    d(t + dt) = f d(t) + sqrt(1 - f^2) n,  f = exp(-dt/time).

    v is taken as the mean over the sample before, as pulses of wheels give it. The model's noise: r is off by
    kappa_error v, the sideslip by beta_error, and the wheel by wheel_error times every turn of it.

    *Late measurements.* The filter stands `horizon` + dt behind now. Measurements are put, by their age, into a buffer
    of samples; one comes out of it each time, is moved to the sample's time along the car's course, and filtered. So
    order and lateness up to `horizon` do not matter, a stamp that comes twice is one, and nothing is computed twice,
    as filtering again from each stamp would; what is later still counts as missing. From there the model goes on to
    now under the wheel's angles, which are not late. A measurement newer than the horizon waits for its turn, which
    costs little where errors last for seconds.

    *Jumps.* A measurement further off than `gate` deviations is rejected. If it stays so for `patience`, it is
    believed: motion and sensor are then each as uncertain as the jump is large. *Outages* are ridden out with the
    model and whatever still arrives, under deviations that grow. *Doubt.* If innovations to the side, of the heading or
    of the gyro keep one sign (their mean over `doubt_time` beyond sqrt(doubt_from) deviations of it), the car is not as
    the model says: a ratio, tyres, wind. Noise of wheel and sideslip is then raised by doubt_wheel and doubt_beta,
    squared, times the excess, so that the sensors are trusted more.

    inputs: x_in, y_in [m], psi_in [rad] (any turn) of the centre of gravity, and their age_in [s]; v_in [m/s] and r_in
    [rad/s], and their motion_age_in [s]; NaN where nothing came. delta_sw_meas [rad], now; NaN: as before.
    outputs, at this time: x, y, psi, v, beta, r (NaN before the first position); side_deviation [m] (across the car),
    psi_deviation, beta_deviation [rad], r_deviation [rad/s], standard deviations; outage [1], 1 if no position was used
    for `outage_after`; rejected [1], 1 if a measurement of the last sample was, missing [1], 1 if one of them was not
    there; doubt [1], the excess, 0 if none; gyro_zero [rad/s], heading_bias, wheel_offset [rad] with
    gyro_zero_deviation, heading_bias_deviation, wheel_offset_deviation, and gyro_zero_valid, heading_bias_valid,
    wheel_offset_valid [1]: is the deviation at most half of what it was before anything was measured; nis, nis_count
    [1]: sum and number of the last sample's normalised innovations squared of position, heading and gyro, of mean 1
    each if the deviations are right.
    All but nis follow from the state and the wheel. state: 13 means, 91 covariances (upper triangle), the wheel's last
    angles, the buffer, `Memory`.
    valid: forward driving; a v below 0 counts as 0. At standstill nothing drifts, for rhs then says that nothing turns.
    In a batch parameters may be `(N,)` arrays. errors: ValueError for parameters out of range.
    source: Gelb 1974, ch. 4 and 6; Bar-Shalom, Li, Kirubarajan 2001, sections 5.4 (normalised innovations) and 11.6
    (adaptive noise).
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
    gyro_zero = Out("rad/s", direct=())
    gyro_zero_deviation = Out("rad/s", direct=())
    gyro_zero_valid = Out("1", direct=())
    heading_bias = Out("rad", direct=())
    heading_bias_deviation = Out("rad", direct=())
    heading_bias_valid = Out("1", direct=())
    wheel_offset = Out("rad", direct=())
    wheel_offset_deviation = Out("rad", direct=())
    wheel_offset_valid = Out("1", direct=())
    nis = Out("1", direct=())
    nis_count = Out("1", direct=())

    rhs: Rhs
    """The car's motion: a plant's `rhs`."""
    steer_ratio: Scalar = 15.6
    """Steering-wheel angle over road-wheel angle [1]."""
    horizon: float = 0.1
    """How old a measurement may be to be used [s], a multiple of dt; up to half a sample more counts as this."""
    position_noise: Scalar = 0.0
    """White noise on x and on y: standard deviation [m]. This and the next: the sensors' data sheet."""
    position_drift: Scalar = 0.01
    """Slow error of x and of y: standard deviation [m]."""
    psi_noise: Scalar = 0.0
    """White noise on psi [rad]."""
    psi_drift: Scalar = radians_of(0.1)
    """Slow error of psi [rad]."""
    drift_time: float = 2.0
    """Correlation time of the slow errors [s]."""
    v_noise: Scalar = 0.0
    """White noise on v [m/s]."""
    r_noise: Scalar = radians_of(0.2)
    """White noise on r [rad/s]."""
    heading_drift: Scalar = radians_of(0.05)
    """Very slow error of psi, mounting included [rad]."""
    heading_time: float = 60.0
    """Its correlation time [s]."""
    gyro_drift: Scalar = radians_of(0.05)
    """What may be wrong with the gyro's zero [rad/s]."""
    wheel_drift: Scalar = radians_of(0.3)
    """What may be wrong with the steering wheel's zero [rad]."""
    zero_time: float = 1000.0
    """Correlation time of both zeros [s]."""
    acceleration: Scalar = 1.0
    """Standard deviation of the car's acceleration [m/s^2]."""
    acceleration_time: float = 1.0
    """Its correlation time [s]."""
    kappa_error: Scalar = 2e-4
    """White error of the model's yaw rate over v [1/m]."""
    beta_error: Scalar = radians_of(0.05)
    """White error of the model's sideslip [rad]."""
    wheel_error: Scalar = 0.01
    """Share by which a turn of the wheel may do more or less than the model says [1]."""
    doubt_from: float = 7.0
    """Mean innovation, squared, over its variance, from which on the model is doubted [1]."""
    doubt_time: float = 0.5
    """Over which time that mean is taken [s]."""
    doubt_wheel: Scalar = radians_of(0.6)
    """Doubt's noise of the steering wheel's zero, a sample [rad]."""
    doubt_beta: Scalar = radians_of(0.3)
    """Doubt's noise of the sideslip, a sample [rad]."""
    gate: float = 4.5
    """Deviations by which a measurement may be off to be used [1]."""
    patience: float = 0.5
    """For how long measurements are rejected before they are believed [s]."""
    outage_after: float = 0.3
    """From which time without a position on it is an outage [s]."""
    dt: float = DT

    @classmethod
    def of(cls, car: Any, **numbers: Any) -> VehicleState:
        """The filter for a single-track plant: its `rhs`, and the ratio of its `vehicle`. numbers: other fields."""
        expected = "expected a single-track plant: LinearSingleTrack(vehicle=...), NonlinearSingleTrack(vehicle=...)"
        require(hasattr(car, "rhs"), "VehicleState", f"{type(car).__name__} has no rhs; {expected}")
        return cls(**({"rhs": car.rhs, "steer_ratio": car.vehicle.steer_ratio} | numbers))

    def __post_init__(self) -> None:
        where = "VehicleState"
        require(callable(self.rhs), where, f"rhs = {self.rhs!r}, expected a function, such as a plant's rhs")
        require_within(where, "dt", self.dt, "s", 1e-3, 0.2)
        whole_samples(where, "horizon", self.horizon, self.dt)
        require_within(where, "horizon", self.horizon, "s", 0.0, 1.0)
        require_within(where, "steer_ratio", self.steer_ratio, "1", 1.0, 100.0)
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            if name.endswith("_time") or name in ("gate", "patience", "outage_after", "doubt_from"):
                require_within(where, name, value, "1" if name in ("gate", "doubt_from") else "s", self.dt, 1e5)
            elif name.endswith(("_noise", "_drift", "_error")) or name in ("acceleration", "doubt_wheel", "doubt_beta"):
                require_within(where, name, value, "SI", 0.0, 10.0, "a standard deviation")

    # ---- what follows from the parameters ---------------------------------------------------------------------

    @cached_property
    def _behind(self) -> int:
        """Samples from the filter's time to now."""
        return 1 + whole_samples("VehicleState", "horizon", self.horizon, self.dt)

    @cached_property
    def _wanders(self) -> tuple[tuple[float, Scalar], ...]:
        """f and deviation of a and of the six errors of sensors."""
        slow = (self.drift_time, self.position_drift)
        processes = (
            (self.acceleration_time, self.acceleration),
            slow,
            slow,
            (self.drift_time, self.psi_drift),
            (self.heading_time, self.heading_drift),
            (self.zero_time, self.gyro_drift),
            (self.zero_time, self.wheel_drift),
        )
        return tuple([(math.exp(-self.dt / time), deviation) for time, deviation in processes])

    @cached_property
    def _correction(self) -> Correction:
        return Correction(**{field.name: getattr(self, field.name) for field in fields(Correction)})

    @cached_property
    def _sideways(self) -> bool:
        """Is sway v_y [m/s]? Else it is beta [rad]; asked of rhs."""
        return bool(self.rhs((0.0, 0.0, 0.0, 0.01, 0.0), 0.0, 5.0)[1] < 0.03)

    # ---- the block --------------------------------------------------------------------------------------------

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero, nan = m.filled(0.0, batch), m.filled(math.nan, batch)
        deviations = (*_UNKNOWN, *[deviation for _, deviation in self._wanders])
        p = [[m.filled(d * d, batch), *(zero,) * (_N - 1 - i)] for i, d in enumerate(deviations)]
        memory = (m.filled(NEVER, batch), *(zero,) * (len(Memory._fields) - 1))
        buffer = (nan,) * (SIZE * (self._behind - 1))
        return (*(zero,) * _N, *packed(p), *(zero,) * (self._behind - 1), *buffer, *memory)

    def settle(self, t: float, x: State, u: Any) -> State:
        """The car as first measured, carried back to the filter's time; what was not measured counts as 0."""
        x_in, y_in, psi, age, v, r, wheel = (m.where(m.is_finite(value), value, 0.0) for value in u)
        back = self._behind * self.dt - age
        way, middle = back * m.maximum(v, 0.0), psi - 0.5 * back * r
        start = (x_in - way * m.cos(middle), y_in - way * m.sin(middle), psi - back * r, 0.0 * v, r, v)
        n, ends = _N + _ENTRIES, len(x) - len(Memory._fields)
        unseen = m.where(m.is_finite(u.x_in + u.y_in), 0.0 * v, x[ends])
        held = m.where(m.absolute(u.delta_sw_meas) < ANY_ANGLE, 0.0, 1.0)
        memory = Memory._make(x[ends:])._replace(unseen=unseen, wheel=wheel, held=held)
        wheels = (wheel,) * (self._behind - 1)
        return (*start, *x[len(start) : n], *wheels, *x[n + len(wheels) : ends], *memory)

    def _parts(self, x: State) -> tuple[State, State, State, State, Memory]:
        """Means, covariances, the wheel's angles since the filter's time, the buffer, and the rest of a state."""
        n, ends = _N + _ENTRIES, len(x) - len(Memory._fields)
        buffer = n + self._behind - 1
        return x[:_N], x[_N:n], x[n:buffer], x[buffer:ends], Memory._make(x[ends:])

    def output(self, t: Any, x: State, u: Any) -> Any:
        mean, entries, wheels, _, memory = self._parts(x)
        motion, reach = mean[:V], ()
        v = delta = 0.0
        wheel = Wheel(memory.wheel, memory.wheel, mean[WHEEL], memory.held, memory.held)
        for i, heard in enumerate((*wheels, u.delta_sw_meas), 1):
            v = m.maximum(mean[V] + i * self.dt * mean[A], 0.0)
            wheel = turned_on(wheel.after, wheel.held, wheel.zero, heard)
            delta = (0.5 * (wheel.before + wheel.after) + wheel.zero) / self.steer_ratio
            rate = self.rhs(motion, delta, v)
            reach = reach or answer(self.rhs, motion, delta, v, self.dt).reach
            motion = moved(self.rhs, motion, delta, v, self.dt, rate, reach)
        px, py, psi, sway, r = motion
        speed, beta = course(self.rhs, sway, r, delta, v)
        never = memory.unseen >= NEVER
        shown = [m.where(never, math.nan, value) for value in (px, py, psi, speed, beta, r)]
        p = unpacked(entries, _N)
        c, s, ahead = m.cos(psi), m.sin(psi), self._behind * self.dt * v
        xx, xy, x_psi = p[X][:3]
        yy, y_psi = p[Y][:2]
        turned = 2.0 * ahead * (c * y_psi - s * x_psi) + ahead * ahead * p[PSI][0]
        side = s * s * xx - 2.0 * s * c * xy + c * c * yy + turned
        deviation = [m.sqrt(m.maximum(variance, 0.0)) for variance in (side, *[row[0] for row in p])]
        psi_d, sway_d, r_d = deviation[1 + PSI], deviation[1 + SWAY], deviation[1 + R]
        told: list[Scalar] = []
        for i in (GYRO, HEADING, WHEEL):
            valid = m.where(deviation[1 + i] <= 0.5 * self._wanders[i - A][1], 1.0, 0.0)
            told += [mean[i], deviation[1 + i], valid]
        return self.Y(
            *shown,
            deviation[0],
            psi_d,
            sway_d / m.maximum(mean[V], 1.0) if self._sideways else sway_d,
            r_d,
            m.where(memory.unseen > self.outage_after, 1.0, 0.0),
            memory.rejected,
            memory.missing,
            self._excess(memory),
            *told,
            memory.nis,
            memory.nis_count,
        )

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        mean, entries, wheels, buffer, memory = self._parts(x)
        pose, motion = (u.x_in, u.y_in, u.psi_in), (u.v_in, u.r_in)
        *waiting, due = sorted_in(buffer, pose, u.age_in, motion, u.motion_age_in, self.dt)
        v = m.maximum(mean[V] + self.dt * mean[A], 0.0)
        wheels = (*wheels, u.delta_sw_meas)
        wheel = turned_on(memory.wheel, memory.held, mean[WHEEL], wheels[0])
        delta = (0.5 * (wheel.before + wheel.after) + wheel.zero) / self.steer_ratio
        before = mean[:V]
        linear = answer(self.rhs, before, delta, v, self.dt)
        after = moved(self.rhs, before, delta, v, self.dt, linear.rate, linear.reach)
        rows = self._rows(before, after, linear)
        noise = self._noise(v, linear, wheel, memory)
        kept = [f for f, _ in self._wanders]
        p = predict_covariance(unpacked(entries, _N), rows, kept, noise)
        mean = (
            *after,
            mean[V] + self.dt * mean[A],
            *[f * value for f, value in zip(kept, (*mean[A:WHEEL], wheel.zero))],
        )
        corrected_mean, p, memory = self._correction.measured(self.rhs, mean, p, due, memory, delta)
        whole = m.both(m.absolute(u.delta_sw_meas) < ANY_ANGLE, m.is_finite(due.x + due.y + due.psi + due.v + due.r))
        memory = memory._replace(wheel=wheel.after, held=wheel.held, missing=m.where(whole, 0.0, 1.0))
        return (*corrected_mean, *packed(p), *wheels[1:], *[value for arrived in waiting for value in arrived], *memory)

    # ---- its parts --------------------------------------------------------------------------------------------

    def _rows(self, before: Sequence[Scalar], after: Sequence[Scalar], linear: Answer) -> list[Row]:
        """How x, y, psi, sway, r, v after a sample depend on all before it, sparse."""
        h, half = self.dt, 0.5 * self.dt
        f11, f12, f21, f22 = linear.keeps
        b1, b2 = (turned / self.steer_ratio for turned in linear.turned)
        v_x, v_y, v_sway, v_r = linear.driven
        way_x, way_y = after[X] - before[X], after[Y] - before[Y]
        return [
            {X: 1.0, PSI: -way_y, SWAY: h * linear.aside[0], R: -half * way_y, V: v_x, A: h * v_x},
            {Y: 1.0, PSI: way_x, SWAY: h * linear.aside[1], R: half * way_x, V: v_y, A: h * v_y},
            {PSI: 1.0, SWAY: half * f21, R: half * (1.0 + f22), V: half * v_r, A: half * h * v_r, WHEEL: half * b2},
            {SWAY: f11, R: f12, V: v_sway, A: h * v_sway, WHEEL: b1},
            {SWAY: f21, R: f22, V: v_r, A: h * v_r, WHEEL: b2},
            {V: 1.0, A: h},
        ]

    def _noise(self, v: Scalar, linear: Answer, wheel: Wheel, memory: Memory) -> dict[int, Scalar]:
        """Variance that a sample adds to each number; sway and r forget theirs as fast as they settle."""
        excess, moving = self._excess(memory), m.minimum(v * v, 1.0)
        sideways = v * v if self._sideways else moving
        fresh_sway, fresh_r = (m.maximum(1.0 - keeps * keeps, 0.0) for keeps in (linear.keeps[0], linear.keeps[3]))
        noise = {
            SWAY: sideways * (self.beta_error**2 * fresh_sway + excess * self.doubt_beta**2),
            R: (1.0 + excess) * fresh_r * self.kappa_error**2 * v * v,
        }
        for i, (kept, deviation) in enumerate(self._wanders, A):
            noise[i] = (1.0 - kept * kept) * deviation * deviation
        turned = wheel.after - wheel.before
        unheard = wheel.unsure * (_UNHEARD * self.dt) ** 2
        known = self.wheel_error**2 * turned * turned + excess * moving * self.doubt_wheel**2
        noise[WHEEL] = noise[WHEEL] + known + unheard
        return noise

    def _excess(self, memory: Memory) -> Scalar:
        """By how much innovations keep one sign beyond what chance makes of them [1]."""
        share = self.dt / self.doubt_time
        usual = share / (2.0 - share)
        squares = [mean * mean for mean in (memory.aside, memory.turned, memory.turning)]
        largest = m.maximum(squares[0], m.maximum(squares[1], squares[2]))
        return m.clip(largest / (self.doubt_from * usual) - 1.0, 0.0, 100.0)
