"""The single tracks, linear and not: the ports that every car has; start, integration, rolling at walking pace."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from steerkit._support.errors import number, require_within
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.maths import Scalar
from steerkit.vehicles import G, Vehicle, require_vehicle

V_KINEMATIC = 1.0
"""Up to this speed [m/s] a car rolls kinematically."""
V_DYNAMIC = 3.0
"""From this speed [m/s] on, its model is exactly the dynamic one."""
TAU_KINEMATIC = 0.05
"""Time constant [s] with which a slow car takes on kinematic rolling."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Car(Block):
    """A car, driven by steering-wheel angle and speed; abstract.

    inputs: delta_sw_cmd [rad], the angle at the steering wheel; v_cmd [m/s], the speed that the driver keeps. Both act
    from their sample to the next. outputs, of state only: x, y [m] of the centre of gravity; psi [rad], any turn;
    v [m/s], its speed; beta [rad]; r [rad/s]; a_y [m/s^2]; delta_sw [rad].
    """

    own_steering: ClassVar[bool] = False
    """Does it take the command itself, late and within its own bounds? A scenario's actuator is then left out, and what
    the scenario says of it is only what controllers are told."""

    delta_sw_cmd = In("rad", direct=False)
    v_cmd = In("m/s", direct=False)
    x = Out("m", direct=())
    y = Out("m", direct=())
    psi = Out("rad", direct=())
    v = Out("m/s", direct=())
    beta = Out("rad", direct=())
    r = Out("rad/s", direct=())
    a_y = Out("m/s^2", direct=())
    delta_sw = Out("rad", direct=())


@dataclass(frozen=True, eq=False, kw_only=True)
class IntegratedCar(Car):
    """A car by its equations of motion: where it starts and how they are integrated; abstract."""

    x0: Scalar = number(0.0, "m", low=-1e7, high=1e7)
    """Start position [m]."""
    y0: Scalar = number(0.0, "m", low=-1e7, high=1e7)
    """Start position [m]."""
    psi0: Scalar = number(0.0, "rad", low=-1e4, high=1e4)
    """Start heading [rad]."""
    v0: Scalar = number(0.0, "m/s", low=0.0, high=100.0)
    """Speed before the first sample [m/s]."""
    substeps: int = number(1, low=1)
    """Integration steps a sample."""
    dt: float = number(0.01, "s", above=0.0, high=1.0)


class SingleTrackState(NamedTuple):
    """Pose and motion of the car, then the inputs last applied."""

    x: Scalar
    y: Scalar
    psi: Scalar
    sway: Scalar
    """The sideways motion: beta [rad] in the linear, v_y [m/s] in the nonlinear model."""
    r: Scalar
    v: Scalar
    delta_sw: Scalar


@dataclass(frozen=True, eq=False, kw_only=True)
class SingleTrack(IntegratedCar):
    """A car as a single track, driven by steering-wheel angle and speed; abstract.

    The model's five equations x' = rhs(x, delta, v) are integrated by `substeps` Runge-Kutta steps (order 4) a
    sample, with inputs held and delta = delta_sw/steer_ratio. Slip angles divide by v; so that the car can stand
    still, sideways motion and yaw rate are blended into kinematic rolling:

        (sway, r)' = w (sway, r)'_dynamic + (1 - w) ((sway, r)_kinematic - (sway, r))/0.05 s
        w = smoothstep((v - 1)/(3 - 1)),   0 below 1 m/s, and 1, the model exactly, from 3 m/s on

    delta_sw_cmd stops at the vehicle's delta_sw_max. v, a_y and delta_sw belong to the inputs last applied: where these
    jump, they are limits from the left.
    state: x, y, psi, sway (beta or v_y), r and the last inputs. Parameters and start may be `(N,)` arrays in a batch.
    valid: v in [0, 40] m/s. The fastest rate, near 2.7 m/s, times dt/substeps is 0.8 to 1.25 for the named cars; 2.78
    is the limit of stability, and a dt that comes near it is refused. A NaN input gives a NaN state.
    """

    vehicle: Vehicle
    """The car's parameters."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where = type(self).__name__
        require_vehicle(self.vehicle, where)
        p = self.vehicle
        # the lateral dynamics' larger diagonal entry where w/v is largest; 2 of 2.78 leaves room for the coupling
        fastest = 2.0 + 0.35 * m.maximum((p.c_f + p.c_r) / p.m, (p.c_f * p.l_f**2 + p.c_r * p.l_r**2) / p.i_z)
        high = 2.0 * self.substeps / float(np.asarray(fastest, dtype=float).max())
        require_within(where, "dt", self.dt, "s", 1e-6, high, "a longer one is unstable at 3 m/s; raise substeps")

    def init(self, batch: tuple[int, ...] = ()) -> SingleTrackState:
        start = (self.x0, self.y0, self.psi0, 0.0, 0.0, self.v0, 0.0)
        return SingleTrackState(*[m.filled(value, batch) for value in start])

    def update(self, t: Any, x: SingleTrackState, u: Any, y: Any) -> SingleTrackState:
        stop = self.vehicle.delta_sw_max
        delta_sw, v = m.clip(u.delta_sw_cmd, -stop, stop), u.v_cmd
        held = self.held(delta_sw / self.vehicle.steer_ratio, v)
        motion: tuple[Scalar, ...] = x[:5]
        for _ in range(self.substeps):
            motion = self._stepped(motion, held)
        return SingleTrackState._make((*motion, v, delta_sw))

    def _stepped(self, x: Sequence[Scalar], held: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        """`maths.rk4` written out for five states, none of whose rates sees x, y: half the time of a car's sample."""
        h = self.dt / self.substeps
        half, sixth = 0.5 * h, h / 6.0
        x1, x2, x3, x4, x5 = x
        f = self.motion
        a1, a2, a3, a4, a5 = f(x, held)
        b1, b2, b3, b4, b5 = f((x1, x2, x3 + half * a3, x4 + half * a4, x5 + half * a5), held)
        c1, c2, c3, c4, c5 = f((x1, x2, x3 + half * b3, x4 + half * b4, x5 + half * b5), held)
        d1, d2, d3, d4, d5 = f((x1, x2, x3 + h * c3, x4 + h * c4, x5 + h * c5), held)
        return (
            x1 + sixth * (a1 + 2.0 * (b1 + c1) + d1),
            x2 + sixth * (a2 + 2.0 * (b2 + c2) + d2),
            x3 + sixth * (a3 + 2.0 * (b3 + c3) + d3),
            x4 + sixth * (a4 + 2.0 * (b4 + c4) + d4),
            x5 + sixth * (a5 + 2.0 * (b5 + c5) + d5),
        )

    def rhs(self, x: Sequence[Scalar], delta: Scalar, v: Scalar) -> tuple[Scalar, ...]:
        """x' of the five motion states x = (x, y, psi, sway, r) for road-wheel angle delta [rad] and speed v [m/s]."""
        return self.motion(x, self.held(delta, v))

    def held(self, delta: Scalar, v: Scalar) -> tuple[Scalar, ...]:
        """All that stays the same while the inputs do; what `motion` needs of them."""
        raise NotImplementedError

    def motion(self, x: Sequence[Scalar], held: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        """The right-hand side, given what is held; the same wherever on the map the car is."""
        raise NotImplementedError


def dynamic_share(v: Scalar) -> Scalar:
    """w(v), the share of the dynamic model: smoothstep from 1 to 3 m/s, 3 z^2 - 2 z^3."""
    z = m.clip((v - V_KINEMATIC) / (V_DYNAMIC - V_KINEMATIC), 0.0, 1.0)
    return z * z * (3.0 - 2.0 * z)


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
