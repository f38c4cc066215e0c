"""Steering by torque: the lateral acceleration follows a command, late, slowly and only so far."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, State
from steerkit.diagram.maths import Scalar
from steerkit.plants.steering_actuator import Steering
from steerkit.vehicles import Vehicle
from steerkit.vehicles.rollout import lag_step

_SLOWEST = 1.0  # m/s: below, the wheel turns as at this speed


@dataclass(frozen=True, eq=False, kw_only=True)
class TorqueSteering(Steering):
    """A car steered through the torque of its lane keeping, as most cars in series are, for the place of the motor.

    Its interface takes no angle, and what it does to the car is best said of the lateral acceleration: that follows
    the command after a dead time, within a slew and a limit. A commanded angle is what a known car turns into it:

    C(v) = (L + K v^2)/v^2,  wanted(t) = tan(delta_sw_cmd(t)/steer_ratio)/C(v),
    a(t + dt) = a(t) + sat((1 - exp(-dt/lag)) (sat(wanted(t - delay)) - a(t))),  sat to +-slew dt and +-a_y_limit,
    target(t) = sat(steer_ratio atan(C(v) gain a(t + dt)) + offset),  sat to +-limit,
    delta_sw(t + dt) = delta_sw(t) + sat(target(t) - delta_sw(t)),  sat to +-rate_limit dt,

    v not below 1 m/s. While neither slew nor limit act, delta_sw(t) is gain delta_sw_cmd(t - delay - dt) + offset, but
    for the change of speed on the way.

    inputs: delta_sw_cmd [rad] and v [m/s], which act from their sample to the next. outputs, of state only: delta_sw
    [rad], the angle at the wheel; rate [rad/s], its mean speed over the last sample. state: delta_sw, rate, a, then the
    delay/dt wanted accelerations on their way, oldest first. NaN in an input gives NaN
    for good.
    source: Rajamani 2012, section 3.3 (steady cornering). Dead time, slew and limit of one car as its simulator,
    learned from drives, has them: 0.35 s, 5 m/s^3, 3 m/s^2; the last two are also the bounds of ISO 11270.
    """

    v = In("m/s", direct=False)

    delay: float = 0.35
    """Dead time [s], a multiple of dt."""
    lag: Scalar = number(0.0, "s", low=0.0, high=10.0)
    """First-order time constant of the acceleration [s]; 0 for none."""
    slew: Scalar = number(5.0, "m/s^3", low=1e-3, high=1e4)
    """Fastest change of the acceleration [m/s^3]."""
    a_y_limit: Scalar = number(3.0, "m/s^2", low=1e-3, high=1e3)
    """Largest |acceleration| [m/s^2], before the gain."""
    steer_ratio: Scalar = number(15.6, "1", low=1.0, high=50.0)
    """Steering-wheel angle over road-wheel angle of the car that commands are meant for [1]."""
    wheelbase: Scalar = number(2.71, "m", low=0.04, high=40.0)
    """L of that car [m]."""
    understeer: Scalar = number(0.0, "rad s^2/m", low=-1e-3, high=1.0)
    """Understeer gradient of that car, K [rad s^2/m]."""

    @classmethod
    def of(cls, vehicle: Vehicle, **settings: Any) -> TorqueSteering:
        """For the geometry, tyres, ratio and stop of the car that the commands are meant for; settings: any fields."""
        known: dict[str, Any] = dict(
            steer_ratio=vehicle.steer_ratio,
            wheelbase=vehicle.wheelbase,
            understeer=vehicle.understeer_gradient,
            limit=vehicle.delta_sw_max,
        )
        return cls(**(known | settings))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),) * (3 + self.waiting)

    def holding(self, delta_sw: Scalar, v: Scalar) -> State:
        """The state of a car that has been turning with this angle [rad] at this speed [m/s] for long."""
        a = m.tan(delta_sw / self.steer_ratio) / self._per_a(v)
        return (delta_sw, 0.0 * delta_sw, a, *(a,) * self.waiting)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0], x[1])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        delta_sw, _, a, *pending = x
        per_a = self._per_a(u.v)
        pending.append(m.tan(m.clip(u.delta_sw_cmd, -self.limit, self.limit) / self.steer_ratio) / per_a)
        wanted = m.clip(pending[0], -self.a_y_limit, self.a_y_limit)
        a = a + lag_step(wanted - a, self._follow, self.slew * self.dt)
        target = self.steer_ratio * m.atan(per_a * self.gain * a) + self.offset
        step = lag_step(m.clip(target, -self.limit, self.limit) - delta_sw, 1.0, self.rate_limit * self.dt)
        return (delta_sw + step, step / self.dt, a, *pending[1:])

    def _per_a(self, v: Scalar) -> Scalar:
        """C(v): tan of the road-wheel angle over the lateral acceleration [s^2/m]."""
        return self.wheelbase / m.maximum(v * m.absolute(v), _SLOWEST**2) + self.understeer
