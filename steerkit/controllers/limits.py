"""How far and how fast a controller may turn the wheel, and how steeply it may approach its path."""

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import STOP
from steerkit.vehicles import Vehicle, require_vehicle
from steerkit.vehicles.rollout import SLOWEST, slewed


@dataclass(frozen=True, eq=False, kw_only=True)
class LimitedLaw(Block):
    """Abstract base of a law whose command stays within stop, wheel speed and lateral acceleration: see `limited`."""

    a_y_max: Scalar = number(2.9, "m/s^2", above=0.0)
    """Lateral acceleration to stay within, unless the path asks for more [m/s^2]; the tyres' lag adds up to 0.1."""
    a_y_reserve: Scalar = number(1.5, "m/s^2", low=0.0)
    """Lateral acceleration beyond that of the path which corrections may always use [m/s^2]."""
    rate_limit: Scalar = number(radians_of(550.0), "rad/s", above=0.0)
    """Fastest command [rad/s]."""
    slew: Scalar | None = number(None, "m/s^3", above=0.0)
    """Fastest change of the lateral acceleration of a car that is steered by torque [m/s^3]; None: no bound."""
    a_y_limit: Scalar | None = number(None, "m/s^2", above=0.0)
    """Its largest lateral acceleration, which not even a path that asks for more exceeds [m/s^2]; None: no bound."""
    wheelbase: Scalar = number(2.7, "m", above=0.0)
    """L [m]."""
    understeer: Scalar = 0.0
    """Understeer gradient [rad s^2/m]."""
    l_r: Scalar = number(1.35, "m", above=0.0)
    """Centre of gravity to rear axle [m]."""
    steer_ratio: Scalar = number(15.6, "1", above=0.0)
    """Steering-wheel angle over road-wheel angle [1]."""
    limit: Scalar = number(STOP, "rad", above=0.0)
    """Largest |delta_sw| [rad]."""

    @staticmethod
    def geometry(vehicle: Vehicle, where: str) -> dict[str, Any]:
        """The fields that a `Vehicle` knows; raises ValueError, in the name of `where`, for what is none."""
        require_vehicle(vehicle, where)
        return dict(
            wheelbase=vehicle.wheelbase,
            understeer=vehicle.understeer_gradient,
            l_r=vehicle.l_r,
            steer_ratio=vehicle.steer_ratio,
            limit=vehicle.delta_sw_max,
            reference=vehicle.l_f,
        )


def approach_angle(e: Scalar, v: Scalar, a_y: Scalar, slew: Scalar | None = None) -> Scalar:
    """Steepest angle [rad] to a path e [m] away from which a curve of a_y [m/s^2] still meets it tangentially.

        min(sqrt(2 a_y |e|), (slew e^2)^(1/3))/v

    The first from e = R (1 - cos(angle)) with R = v^2/a_y and a small angle. The second of a car whose a_y changes no
    faster than slew [m/s^3]: to take away a speed w across the path it needs 2 sqrt(w/slew), half of it with a_y
    growing, and gets w sqrt(w/slew) nearer; None: no bound. 1 cm is added to |e| for the derivative at 0 to be finite.
    """
    off = m.absolute(e) + 0.01
    across = m.sqrt(2.0 * a_y * off)
    if slew is not None:
        across = m.minimum(across, m.exp(m.log(slew * off * off) / 3.0))
    return across / m.maximum(v, SLOWEST)


def limited(law: Any, command: Scalar, before: Scalar, v: Scalar, needed: Scalar) -> Scalar:
    """`command` [rad at the wheel], given a sample after `before`, within stop, wheel speed and lateral acceleration.

    The centre of gravity of a rolling car feels a_y = (v^2 tan(delta) + v l_r delta')/L. So the angle stays within
    atan(L a_y/v^2) + K a_y, the steady curve of a_y (Rajamani 2012, section 3.3; |kappa| <= a_y/v^2 of ISO 11270), and
    a sample takes at most the share 1 - exp(-v dt/l_r) of what is left to L a_y/v^2 + K a_y, with

        a_y = max(a_y_max, needed + a_y_reserve), at most a_y_limit,   needed [m/s^2]: |a_y| of the path.

    law: a `LimitedLaw`. A NaN command stays NaN; one in `before` limits nothing: a broken sample breaks no other.
    """
    a_y = possible(law, m.maximum(law.a_y_max, needed + law.a_y_reserve))
    step = slewed(law, v) * law.dt
    v = m.maximum(v, SLOWEST)
    curve, slip = law.wheelbase * a_y / (v * v), law.understeer * a_y
    share, room = 1.0 - m.exp(-v * law.dt / law.l_r), law.steer_ratio * (curve + slip)
    up = m.minimum(step, share * (room - before))
    down = m.minimum(step, share * (room + before))
    bound = m.minimum(law.steer_ratio * (m.atan(curve) + slip), law.limit)
    return m.clip(m.clip(command, before - down, before + up), -bound, bound)


def possible(law: Any, a_y: Scalar) -> Scalar:
    """A lateral acceleration within that of a car steered by torque, `law.a_y_limit`, if there is one [m/s^2]."""
    return a_y if law.a_y_limit is None else m.minimum(a_y, law.a_y_limit)
