"""What a production car's port makes of a command, as limits that the gate, controllers and the learner know."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from steerkit.car.production.platforms import Platform
from steerkit.diagram.units import radians_of
from steerkit.task import A_Y_MAX, JERK_MAX
from steerkit.vehicles import Vehicle
from steerkit.vehicles.rollout import GateLimits

CONTROL_HZ = 100.0
"""Frames of a port's counter in a second."""
SPEEDS = (10.0, 31.0)
"""Between which a production car is driven by a lane keeping system [m/s]."""
WITHIN = 0.95
"""The gate stays within this share of a port's limits: the port's own frames, and their rounding, lie between."""
_KEPT = 0.5
"""Of a slow torque controllers count on this share: the rest is what it takes to turn friction round. With all of it
told, LQR and MPC swing by a metre on the slowest (0.6 of the largest torque in a second)."""
_WORST_ROLL = 0.06 * 9.81  # m/s^2: opendbc `safety/lateral.h`, AVERAGE_ROAD_ROLL


@dataclass(frozen=True, kw_only=True)
class PortLimits:
    """The limits of a port and of its safety model on a command, as bounds on the steering wheel of that car.

    By an angle, with the rates that are allowed at some speeds (`safety/lateral.h`, steer_angle_cmd_checks),

        |delta_sw| <= delta_max,  |delta_sw'| <= rates(v),

    or with a model of the car (steer_angle_cmd_checks_vm), kappa = tan(delta_sw/steer_ratio)/(L + K v^2),

        |v^2 kappa| <= a_y_max,  |v^2 kappa'| <= jerk_max;

    by a curvature as by the first, and besides within a_y_max; by a torque u
    (steer_torque_cmd_checks), whose largest change in a frame is up,

        |a_y| <= gain (1 - friction),  |a_y'| <= gain up/frame.

    Source: opendbc 0.3.1, `safety/lateral.h` and `car/MAKER/values.py`.
    """

    delta_max: float = math.inf
    """[rad]"""
    rate_max: float = math.inf
    """[rad/s]"""
    rates: tuple[tuple[float, float], ...] = ()
    """(v [m/s], rate of the steering wheel [rad/s])"""
    a_y_max: float = A_Y_MAX
    """[m/s^2]"""
    jerk_max: float = JERK_MAX
    """[m/s^3]"""
    turning: float = math.inf
    """Fastest change of the lateral acceleration by the table, at the worst of `SPEEDS` [m/s^3]."""
    understeer: float = 0.0
    """What the gate may count on of the car's K [rad s^2/m]: by torque, which cannot do more, and by curvature."""
    slew: float | None = None
    """Of a car steered by torque: fastest change of its lateral acceleration that controllers count on [m/s^3]."""
    torque_limit: float | None = None
    """And the largest [m/s^2]."""
    late: float = 0.0
    """And what turning its friction round takes in the mean [s], for controllers more lag."""

    def within(self, limits: GateLimits) -> GateLimits:
        """A gate's limits, no wider than these."""
        fields = type(limits).__dataclass_fields__
        least = {name: fields[name].metadata["number"][1] for name in ("delta_sw_max", "rate_max", "a_y_max")}
        return replace(
            limits,
            delta_sw_max=max(least["delta_sw_max"], min(limits.delta_sw_max, self.delta_max)),
            rate_max=max(least["rate_max"], min(limits.rate_max, WITHIN * self.rate_max)),
            rates=tuple([(v, WITHIN * rate) for v, rate in self.rates]),
            a_y_max=max(least["a_y_max"], min(limits.a_y_max, WITHIN * self.a_y_max)),
            jerk_max=min(limits.jerk_max, WITHIN * self.jerk_max),
            understeer=self.understeer,
        )


def _turning(rates: tuple[tuple[float, float], ...], car: Vehicle) -> float:
    """rates(v) v^2/(steer_ratio (L + K v^2)) at the worst speed [m/s^3]."""
    v = np.arange(*SPEEDS)
    length = float(car.wheelbase) + float(car.understeer_gradient) * v * v
    rate = np.interp(v, [at for at, _ in rates], [fast for _, fast in rates])
    return float(np.min(rate * v * v / (float(car.steer_ratio) * length)))


def limits_of(platform: Platform, vehicle: Vehicle) -> PortLimits:
    """The limits of a platform's port, for a car of these numbers."""
    controls = platform.controls
    step = float(getattr(controls, "STEER_STEP", 1))
    frame = step / CONTROL_HZ
    if platform.steered_by == "torque":
        share = float(controls.STEER_DELTA_UP) / (1.0 if platform.maker == "honda" else platform.full * frame)
        lateral = platform.lateral
        most = lateral.gain * (1.0 - lateral.friction)
        slew = min(JERK_MAX, share * lateral.gain)
        late = 0.5 * lateral.gain * lateral.friction / slew
        return PortLimits(
            a_y_max=min(A_Y_MAX, most),
            jerk_max=slew,
            understeer=float(vehicle.understeer_gradient),
            slew=_KEPT * slew,
            torque_limit=most,
            late=late,
        )
    angles: Any = controls.ANGLE_LIMITS
    if getattr(angles, "MAX_LATERAL_ACCEL", 0.0):
        return PortLimits(
            delta_max=radians_of(angles.STEER_ANGLE_MAX),
            rate_max=radians_of(angles.MAX_ANGLE_RATE) / frame,
            a_y_max=float(angles.MAX_LATERAL_ACCEL),
            jerk_max=float(angles.MAX_LATERAL_JERK),
        )
    speeds, rates = (np.asarray(column, float) for column in angles.ANGLE_RATE_LIMIT_UP)
    if platform.steered_by == "angle":
        table = tuple(zip(map(float, speeds), map(float, np.radians(rates) / frame)))
        turning = _turning(table, vehicle)
        return PortLimits(
            delta_max=radians_of(angles.STEER_ANGLE_MAX), rate_max=table[0][1], rates=table, turning=turning
        )
    length, ratio = vehicle.wheelbase, vehicle.steer_ratio
    table = tuple(zip(map(float, speeds), [float(ratio * length * rate / frame) for rate in rates]))
    return PortLimits(
        delta_max=float(ratio * math.atan(length * angles.STEER_ANGLE_MAX)),
        rate_max=table[0][1],
        rates=table,
        turning=_turning(table, vehicle),
        a_y_max=A_Y_MAX - _WORST_ROLL,
        understeer=float(vehicle.understeer_gradient),
    )
