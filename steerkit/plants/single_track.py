"""The ports that every car has, and what the single tracks share: start, integration, rolling at walking pace."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from steerkit._support.errors import number, require, require_within
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.maths import Scalar
from steerkit.vehicles import Vehicle, require_vehicle

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
    substeps: int = 1
    """Integration steps a sample."""
    dt: float = number(0.01, "s", above=0.0, high=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        where = type(self).__name__
        require(isinstance(self.substeps, int) and self.substeps >= 1, where, f"substeps = {self.substeps!r}, >= 1")


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
