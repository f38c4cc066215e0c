"""The linear single-track car."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from steerkit.diagram import maths as m
from steerkit.diagram.maths import Scalar
from steerkit.plants.single_track import TAU_KINEMATIC, V_KINEMATIC, SingleTrack, SingleTrackState, dynamic_share

Matrix = tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearSingleTrack(SingleTrack):
    """The linear single track: tyre forces proportional to slip angles, speed v of the centre of gravity given.

    alpha_f = delta - beta - l_f r/v,  alpha_r = -beta + l_r r/v,
    beta' = (c_f alpha_f + c_r alpha_r)/(m v) - r,  r' = (l_f c_f alpha_f - l_r c_r alpha_r)/i_z,
    x' = v cos(psi + beta),  y' = v sin(psi + beta),  psi' = r,  a_y = v (r + beta').

    Kinematic rolling (below 3 m/s): beta_k = atan(l_r/L tan(delta)), r_k = v cos(beta_k) tan(delta)/L.

    Ports, state, valid range, errors: see `SingleTrack`; sway = beta. The tyres never let go: a_y is not limited, so
    the model holds up to about 4 m/s^2. Source: Riekert, Schunck 1940; Rajamani 2012, section 2.3.
    """

    @cached_property
    def _stiffness(self) -> tuple[Scalar, ...]:
        """Sums of the axles over m and i_z: c0/m, c1/m, c1/i_z, c2/i_z, c_f/m, l_f c_f/i_z."""
        p = self.vehicle
        c1 = p.c_r * p.l_r - p.c_f * p.l_f
        c2 = p.c_f * p.l_f**2 + p.c_r * p.l_r**2
        return (p.c_f + p.c_r) / p.m, c1 / p.m, c1 / p.i_z, c2 / p.i_z, p.c_f / p.m, p.l_f * p.c_f / p.i_z

    def matrices(self, v: Scalar) -> tuple[Matrix, tuple[Scalar, Scalar]]:
        """A (rows) and B of (beta, r)' = A (beta, r) + B delta about straight driving at speed v [m/s].

        From 3 m/s on this is the model itself; below, with the kinematic share linearised at delta = 0.
        """
        w, a11, a12, a21, a22, b1, b2 = self._blended(v)
        p = self.vehicle
        rolling = (1.0 - w) / TAU_KINEMATIC
        return ((a11, a12), (a21, a22)), (b1 + rolling * p.l_r / p.wheelbase, b2 + rolling * v / p.wheelbase)

    def _blended(self, v: Scalar) -> tuple[Scalar, ...]:
        """w(v), A with its kinematic share, and the dynamic share of B."""
        c0_m, c1_m, c1_i, c2_i, cf_m, lf_i = self._stiffness
        w = dynamic_share(v)
        w_v = w / m.maximum(v, V_KINEMATIC)
        fade = (w - 1.0) / TAU_KINEMATIC
        a12 = w_v * c1_m / m.maximum(v, V_KINEMATIC) - w
        return w, fade - w_v * c0_m, a12, w * c1_i, fade - w_v * c2_i, w_v * cf_m, w * lf_i

    def held(self, delta: Scalar, v: Scalar) -> tuple[Scalar, ...]:
        """v, A and the constant part of (beta, r)'."""
        w, a11, a12, a21, a22, b1, b2 = self._blended(v)
        p = self.vehicle
        slope = m.tan(delta) / p.wheelbase
        beta = m.atan(p.l_r * slope)
        rolling = (1.0 - w) / TAU_KINEMATIC
        return v, a11, a12, a21, a22, b1 * delta + rolling * beta, b2 * delta + rolling * v * m.cos(beta) * slope

    def motion(self, x: Sequence[Scalar], held: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        """(x, y, psi, beta, r)'."""
        _, _, psi, beta, r = x
        v, a11, a12, a21, a22, f1, f2 = held
        course = psi + beta
        return v * m.cos(course), v * m.sin(course), r, a11 * beta + a12 * r + f1, a21 * beta + a22 * r + f2

    def output(self, t: Any, x: SingleTrackState, u: Any) -> Any:
        beta_dot = self.rhs(x[:5], x.delta_sw / self.vehicle.steer_ratio, x.v)[3]
        return self.Y(x.x, x.y, x.psi, x.v, x.sway, x.r, x.v * (x.r + beta_dot), x.delta_sw)
