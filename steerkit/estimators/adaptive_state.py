"""A vehicle-state estimator that is told what else is found of its car: ratio, offset, understeer, the gyro's zero."""

from __future__ import annotations

import math
from collections import namedtuple
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from steerkit._support.errors import require, require_within
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, Out, Port, State, entries_of, take_ports
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.vehicle_state import VehicleState


class Told(NamedTuple):
    """What a vehicle-state estimator is told of its car."""

    ratio: Scalar
    """Steering ratio over the data sheet's [1]."""
    understeer: Scalar
    """Understeer gradient [rad s^2/m]."""
    offset: Scalar
    """What is to be added to the measured angle [rad]."""
    rate_zero: Scalar
    """The gyro's zero [rad/s]."""


class _Before(NamedTuple):
    """What was measured of the car's motion a sample before."""

    v: Scalar
    r: Scalar
    psi: Scalar
    age: Scalar
    speed: Scalar
    """The last v that was a number [m/s], which counts for the sample after it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class AdaptiveState(Block):
    """Wraps a `VehicleState` so that its car is the one that it turns out to be; for cars nobody has measured.

    A `SingleTrackFilter` watches the measured wheel and the gyro. With what is told of it, the ratio as a multiple g of
    the data sheet's, the understeer gradient K', the offset and the gyro's zero, `block` is given

        angle = (delta_sw_meas + offset)/g (L + K v^2)/(L + K' v^2),   rate = r_in - rate_zero

    as delta_sw_meas and r_in: the angle at which a car as in the data sheet, L, K, turns as fast as this one. What is
    told starts with the data sheet (g = 1, K' = K, 0, 0) and moves towards an estimate, no faster than so much a
    second, only while that is valid and within its bounds; else it stays. What is left of the zeros `block` finds
    itself. A dead time is not told: the wheel's angle is measured, behind the steering's delay and lag; the age of
    what is measured is said with it.

    Ports and sample time are those of `block`; outputs besides: ratio [1], understeer [rad s^2/m], as told; gyro_zero
    and wheel_offset are what is told with what `block` finds. State: that of `block`, of `steering`, the motion of a
    sample before, what is told. NaN teaches nothing. Raises ValueError for parameters out of range, for a `steering`
    that is made for commands, of another sample time. Source: Astrom, Wittenmark 1995, section 3.1 (certainty
    equivalence); Rajamani 2012, section 3.3 (steady turning).
    """

    block: VehicleState
    """The estimator, made for the car by its data sheet."""
    steering: SingleTrackFilter
    """Finds what is told, from the measured wheel (held=False)."""
    age_deviation: float = 0.01
    """Standard deviation of the time between what is measured of the wheel and of the motion [s]."""
    ratio_least: float = 0.6
    """Smallest ratio that is told, as a multiple of the data sheet's [1]."""
    ratio_most: float = 1.6
    """Largest [1]."""
    understeer_most: float = 0.02
    """Largest understeer gradient that is told, to either side [rad s^2/m]."""
    offset_most: float = radians_of(10.0)
    """Largest offset that is told, to either side [rad]."""
    rate_zero_most: float = radians_of(1.0)
    """Largest zero of the gyro that is told, to either side [rad/s]."""
    ratio_rate: float = 0.1
    """Fastest change of the ratio that is told [1/s]."""
    understeer_rate: float = 5e-4
    """That of the understeer gradient [rad s/m]."""
    offset_rate: float = radians_of(1.0)
    """That of the offset [rad/s]."""
    rate_zero_rate: float = radians_of(0.1)
    """That of the gyro's zero [rad/s^2]."""

    def __post_init__(self) -> None:
        where = "AdaptiveState"
        dts = self.block.dt, self.steering.dt
        require(dts[0] == dts[1], where, f"block.dt = {dts[0]}, steering.dt = {dts[1]} [s], expected the same")
        require(not self.steering.held, where, "steering.held = True, expected False: the wheel's angle is measured")
        for name, unit, low, high in (
            ("age_deviation", "s", 0.0, 1.0),
            ("ratio_least", "1", 0.1, 1.0),
            ("ratio_most", "1", 1.0, 10.0),
            ("understeer_most", "rad s^2/m", 0.0, 0.05),
            ("offset_most", "rad", 0.0, 0.5),
            ("rate_zero_most", "rad/s", 0.0, 0.1),
            ("ratio_rate", "1/s", 0.0, 10.0),
            ("understeer_rate", "rad s/m", 0.0, 1.0),
            ("offset_rate", "rad/s", 0.0, 1.0),
            ("rate_zero_rate", "rad/s^2", 0.0, 1.0),
        ):
            require_within(where, name, getattr(self, name), unit, low, high)
        take_ports(self, self.block)
        more = [Out(unit, direct=()) for unit in ("1", "rad s^2/m")]
        for port, name in zip(more, ("ratio", "understeer")):
            port.__set_name__(type(self), name)
            object.__setattr__(self, name, Port(self, port))
        object.__setattr__(self, "outputs", (*self.outputs, *more))
        object.__setattr__(self, "Y", namedtuple("Y", (*self.Y._fields, "ratio", "understeer")))

    @cached_property
    def _parts(self) -> tuple[int, int]:
        """Where in the state that of `block` ends, and that of `steering`."""
        (_, first), (_, second) = entries_of(self.block), entries_of(self.steering)
        return first, first + second

    def _split(self, x: State) -> tuple[State, State, _Before, Told]:
        first, second = self._parts
        third = second + len(_Before._fields)
        return x[:first], x[first:second], _Before._make(x[second:third]), Told._make(x[third:])

    def init(self, batch: tuple[int, ...] = ()) -> State:
        nan, sheet = math.nan, Told(1.0, self.steering.vehicle.understeer_gradient, 0.0, 0.0)
        more = [m.filled(value, batch) for value in (nan, nan, nan, nan, 0.0, *sheet)]
        return (*self.block.init(batch), *self.steering.init(batch), *more)

    def settle(self, t: float, x: State, u: Any) -> State:
        state, steering, before, told = self._split(x)
        before = before._replace(speed=m.where(m.is_finite(u.v_in), u.v_in, 0.0))
        return (*self.block.settle(t, state, self._seen(u, before, told)), *steering, *before, *told)

    def output(self, t: Any, x: State, u: Any) -> Any:
        state, _, before, told = self._split(x)
        y = self.block.output(t, state, self._seen(u, before, told))
        zeros = dict(gyro_zero=y.gyro_zero + told.rate_zero, wheel_offset=told.ratio * y.wheel_offset + told.offset)
        return self.Y(*y._replace(**zeros), told.ratio, told.understeer)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        state, steering, before, told = self._split(x)
        after = self.block.update(t, state, self._seen(u, before, told), None)
        found = self.steering.output(t, steering, ())
        # the motion of a sample before, with the wheel of this one: then it is late by a sample at least
        late = before.age + self.dt
        watched = self.steering.U(u.delta_sw_meas, before.v, before.r, before.psi, late, 0.0, self.age_deviation, 1.0)
        steering = self.steering.update(t, steering, watched, found)
        speed = m.where(m.is_finite(u.v_in), u.v_in, before.speed)
        before = _Before(u.v_in, u.r_in, u.psi_in, u.motion_age_in, speed)
        told = Told(
            self._moved(told.ratio, found.ratio, found.ratio_valid, self.ratio_rate, self.ratio_least, self.ratio_most),
            self._near(told.understeer, found, "understeer", found.ratio_valid),  # at one speed they are known together
            self._near(told.offset, found, "offset", found.offset_valid),
            self._near(told.rate_zero, found, "rate_zero", found.rate_zero_valid),
        )
        return (*after, *steering, *before, *told)

    def _near(self, before: Scalar, found: Any, name: str, valid: Scalar) -> Scalar:
        """What is told of a number with a largest value to either side, a sample later."""
        most, rate = getattr(self, f"{name}_most"), getattr(self, f"{name}_rate")
        return self._moved(before, getattr(found, name), valid, rate, -most, most)

    def _moved(self, before: Scalar, value: Scalar, valid: Scalar, rate: float, low: float, high: float) -> Scalar:
        step = m.clip(m.clip(value, low, high) - before, -rate * self.dt, rate * self.dt)
        return before + m.where(m.both(valid > 0.5, m.is_finite(value)), step, 0.0)

    def _seen(self, u: Any, before: _Before, told: Told) -> Any:
        """What `block` sees: the wheel of a car as in the data sheet that turns as this one does."""
        car, square = self.steering.vehicle, before.speed * before.speed
        bent = (car.wheelbase + car.understeer_gradient * square) / (car.wheelbase + told.understeer * square)
        wheel = bent * (u.delta_sw_meas + told.offset) / told.ratio
        return u._replace(delta_sw_meas=wheel, r_in=u.r_in - told.rate_zero)
