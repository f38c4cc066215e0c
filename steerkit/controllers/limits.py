"""How far and how fast a controller may turn the wheel, and how steeply it may approach its path."""

from __future__ import annotations

from steerkit.diagram import maths as m
from steerkit.diagram.maths import Scalar
from steerkit.vehicles.rollout import SLOWEST


def approach_angle(e: Scalar, v: Scalar, a_y: Scalar) -> Scalar:
    """Steepest angle [rad] to a path e [m] away from which a curve of a_y [m/s^2] still meets it tangentially.

    sqrt(2 a_y |e|)/v, from e = R (1 - cos(angle)) with R = v^2/a_y and a small angle; 1 cm is added to |e| for the
    derivative at 0 to be finite.
    """
    return m.sqrt(2.0 * a_y * (m.absolute(e) + 0.01)) / m.maximum(v, SLOWEST)


def limited(
    command: Scalar,
    before: Scalar,
    v: Scalar,
    a_y: Scalar,
    *,
    wheelbase: Scalar,
    l_r: Scalar,
    understeer: Scalar,
    steer_ratio: Scalar,
    rate_limit: Scalar,
    limit: Scalar,
    dt: float,
) -> Scalar:
    """`command` [rad at the wheel], given a sample after `before`, within stop, wheel speed and a_y [m/s^2].

    The centre of gravity of a rolling car feels a_y = (v^2 tan(delta) + v l_r delta')/L. So the angle stays within
    atan(L a_y/v^2) + K a_y, the steady curve of a_y (Rajamani 2012, section 3.3; |kappa| <= a_y/v^2 of ISO 11270), and
    a sample takes at most the share 1 - exp(-v dt/l_r) of what is left to L a_y/v^2 + K a_y.
    A NaN command stays NaN; one in `before` limits nothing, so that a broken sample does not break the next.
    """
    v = m.maximum(v, SLOWEST)
    curve, slip = wheelbase * a_y / (v * v), understeer * a_y
    share, room = 1.0 - m.exp(-v * dt / l_r), steer_ratio * (curve + slip)
    up = m.minimum(rate_limit * dt, share * (room - before))
    down = m.minimum(rate_limit * dt, share * (room + before))
    bound = m.minimum(steer_ratio * (m.atan(curve) + slip), limit)
    return m.clip(m.clip(command, before - down, before + up), -bound, bound)
