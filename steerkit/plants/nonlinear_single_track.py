"""The single-track car whose tyres saturate."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from steerkit.diagram import maths as m
from steerkit.diagram.maths import Scalar
from steerkit.plants.single_track import TAU_KINEMATIC, V_KINEMATIC, SingleTrack, SingleTrackState, dynamic_share
from steerkit.vehicles import G

_SIDEWAYS = 0.01  # m/s: least forward speed of a wheel in its own plane; one that slides backwards slides fully


def fiala(slope: Scalar, stiffness: Scalar, grip: Scalar) -> Scalar:
    """Lateral force [N] of an axle at slip angle alpha, slope = tan(alpha) [1]: brush model, parabolic pressure.

    F = grip z (3 - 3 |z| + z^2),  z = sat(stiffness slope/(3 grip)) within +-1,

    which is stiffness*alpha for small angles and +-grip once the tyre slides. stiffness [N/rad] > 0; grip = mu F_z
    [N] > 0. Source: Fiala 1954; Pacejka 2012, section 3.2; Hindiyeh, Gerdes 2014 (there with the other sign).
    """
    z = m.clip(stiffness * slope / (3.0 * grip), -1.0, 1.0)
    return grip * z * (3.0 - 3.0 * m.absolute(z) + z * z)


@dataclass(frozen=True, eq=False, kw_only=True)
class NonlinearSingleTrack(SingleTrack):
    """The single track with Fiala tyres: forces saturate at mu F_z per axle, and the front one turns with the wheel.

    alpha_f = delta - atan2(v_y + l_f r, v_x),  alpha_r = -atan2(v_y - l_r r, v_x),  F = fiala(tan alpha, c, mu F_z),
    m (v_y' + v_x r) = F_f cos(delta) + F_r,  i_z r' = l_f F_f cos(delta) - l_r F_r,
    x' = v_x cos(psi) - v_y sin(psi),  y' = v_x sin(psi) + v_y cos(psi),  psi' = r,
    v = sqrt(v_x^2 + v_y^2),  beta = atan2(v_y, v_x),  a_y = v_y' + v_x r.

    v_cmd is v_x, the speed along the car's axis, as its rear wheels turn. The driver keeps it: the drive force
    that takes is there, and costs the tyres no grip. Axle loads are those at rest. a_y is what an accelerometer at
    the centre of gravity reads, v (r + beta') to first order in beta; at 3 m/s and above |a_y| <= mu g.

    Kinematic rolling (below 3 m/s): v_y = l_r/L tan(delta) v_x, r = tan(delta)/L v_x. Ports, state, valid range,
    errors: see `SingleTrack`; sway = v_y. tan(alpha) is formed without angles, as a wheel's sideways over its forward
    speed. Source: `fiala`; Rajamani 2012, section 2.3.
    """

    @cached_property
    def _constants(self) -> tuple[Scalar, ...]:
        """Geometry, tyres and inertias: l_f, l_r, c_f, c_r, mu F_zf, mu F_zr, 1/m, 1/i_z."""
        p = self.vehicle
        weight = p.mu * p.m * G / p.wheelbase
        return p.l_f, p.l_r, p.c_f, p.c_r, weight * p.l_r, weight * p.l_f, 1.0 / p.m, 1.0 / p.i_z

    def held(self, delta: Scalar, v: Scalar) -> tuple[Scalar, ...]:
        """cos(delta), sin(delta), v_x, at least 1 m/s of it, w, the kinematic rolling, and the constants."""
        p = self.vehicle
        w = dynamic_share(v)
        r = m.tan(delta) / p.wheelbase * v
        rolling = (1.0 - w) / TAU_KINEMATIC
        return (m.cos(delta), m.sin(delta), v, m.maximum(v, V_KINEMATIC), w, rolling, p.l_r * r, r, *self._constants)

    def motion(self, x: Sequence[Scalar], held: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        """(x, y, psi, v_y, r)'."""
        _, _, psi, v_y, r = x
        cos_d, sin_d, v_x, ahead, w, rolling, v_y_k, r_k, l_f, l_r, c_f, c_r, grip_f, grip_r, per_m, per_i = held
        side = v_y + l_f * r
        slope_f = (sin_d * ahead - cos_d * side) / m.maximum(cos_d * ahead + sin_d * side, _SIDEWAYS)
        front = cos_d * fiala(slope_f, c_f, grip_f)
        rear = fiala((l_r * r - v_y) / ahead, c_r, grip_r)
        cos_psi, sin_psi = m.cos(psi), m.sin(psi)
        return (
            v_x * cos_psi - v_y * sin_psi,
            v_x * sin_psi + v_y * cos_psi,
            r,
            w * ((front + rear) * per_m - v_x * r) + rolling * (v_y_k - v_y),
            w * (l_f * front - l_r * rear) * per_i + rolling * (r_k - r),
        )

    def output(self, t: Any, x: SingleTrackState, u: Any) -> Any:
        v_x, v_y = x.v, x.sway
        a_y = self.rhs(x[:5], x.delta_sw / self.vehicle.steer_ratio, v_x)[3] + v_x * x.r
        return self.Y(x.x, x.y, x.psi, m.sqrt(v_x * v_x + v_y * v_y), m.atan2(v_y, v_x), x.r, a_y, x.delta_sw)
