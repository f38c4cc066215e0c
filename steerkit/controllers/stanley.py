"""The complete Stanley controller."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from steerkit import maths as m
from steerkit.block import Block, In, Out, require
from steerkit.units import radians_of


class StanleyState(NamedTuple):
    """The road-wheel angle measured one sample before [rad]."""

    delta_before: Any


@dataclass(frozen=True, eq=False, kw_only=True)
class Stanley(Block):
    """Stanley's steering law with all its terms: heading, cross-track, yaw damping, steer damping, curve offset.

    delta = -(psi_e - psi_ss) - sat_a(arctan(k*e / (k_soft + v))) - k_d_yaw*(r - v*kappa)
            + k_d_steer*(delta_meas(i-1) - delta_meas(i)),
    psi_ss = m*v*r_path*l_r / (c_f*L),  r_path = v*kappa,  delta_sw = sat(steer_ratio*delta).

    The signs are ISO 8855 (left positive): the paper's delta, psi and e all have the opposite sign. psi_ss is the
    front slip angle of the steady curve (c_f per axle): with it the law holds e = 0 there at any speed.
    sat_a limits the approach angle, so that the path is not crossed fast after a large excursion.

    Inputs (all at the **front axle**: a tracker with reference = l_f): e [m], psi_e [rad], kappa [1/m]; v [m/s],
    r [rad/s]; delta_sw_meas [rad], the measured steering wheel. Output: delta_sw [rad], within +-limit.
    State: the measured road-wheel angle one sample before. Valid for v >= 0 (k_soft > 0 keeps standstill regular).
    NaN in any input gives NaN out. Raises ValueError for gains out of range.

    Source: Hoffmann, Tomlin, Montemerlo, Thrun, ACC 2007, eq. 9. k_soft = 1 is theirs; the other gains are not
    published: these are the design's, checked on the recorded lap.
    """

    e = In("m")
    psi_e = In("rad")
    kappa = In("1/m")
    v = In("m/s")
    r = In("rad/s")
    delta_sw_meas = In("rad")
    delta_sw = Out("rad")

    k: float = 2.5
    """Cross-track gain [1/s]."""
    k_soft: float = 1.0
    """Softening speed [m/s]."""
    k_d_yaw: float = 0.15
    """Yaw-rate damping [s]."""
    k_d_steer: float = 0.3
    """Steering damping [1]."""
    approach_limit: float = radians_of(30.0)
    """Largest approach angle that the cross-track term may ask for [rad]."""
    mass: float = 0.0
    """Car mass [kg]; 0 leaves out the curve offset psi_ss."""
    c_f: float = 1.0
    """Cornering stiffness of the front axle [N/rad]."""
    l_r_share: float = 0.5
    """l_r / L: share of the mass on the front axle [1]."""
    steer_ratio: float = 15.6
    """Steering-wheel angle over road-wheel angle [1]."""
    limit: float = radians_of(520.0)
    """Largest |delta_sw| [rad]."""
    reference: float = 1.2
    """Where e, psi_e and kappa have to be measured: metres ahead of the centre of gravity (the front axle, l_f)."""

    def __post_init__(self) -> None:
        for name in ("k", "k_d_yaw", "k_d_steer", "mass"):
            require(getattr(self, name) >= 0.0, "Stanley", f"{name} = {getattr(self, name)}, expected >= 0")
        for name in ("k_soft", "c_f", "steer_ratio", "limit", "approach_limit"):
            require(getattr(self, name) > 0.0, "Stanley", f"{name} = {getattr(self, name)}, expected > 0")

    @classmethod
    def of(cls, vehicle: Any, *, dt: float = 0.05) -> Stanley:
        """The controller with geometry, mass, stiffness and ratio of a `Vehicle`."""
        return cls(
            mass=vehicle.m,
            c_f=vehicle.c_f,
            l_r_share=vehicle.l_r / (vehicle.l_f + vehicle.l_r),
            steer_ratio=vehicle.steer_ratio,
            reference=vehicle.l_f,
            dt=dt,
        )

    @classmethod
    def textbook(cls, vehicle: Any, *, dt: float = 0.05) -> Stanley:
        """The form of most public code: heading and cross-track terms only, hardly any softening."""
        bare = dict(k_soft=1e-3, k_d_yaw=0.0, k_d_steer=0.0, mass=0.0, approach_limit=m.pi / 2.0)
        return replace(cls.of(vehicle, dt=dt), **bare)

    def init(self, batch: tuple[int, ...] = ()) -> StanleyState:
        return StanleyState(m.filled(0.0, batch))

    def settle(self, t: float, x: StanleyState, u: Any) -> StanleyState:
        return StanleyState(u.delta_sw_meas / self.steer_ratio)

    def output(self, t: Any, x: StanleyState, u: Any) -> Any:
        r_path = u.v * u.kappa
        psi_ss = self.mass * u.v * r_path * self.l_r_share / self.c_f
        approach = m.clip(m.atan(self.k * u.e / (self.k_soft + u.v)), -self.approach_limit, self.approach_limit)
        damping = self.k_d_yaw * (u.r - r_path) + self.k_d_steer * (u.delta_sw_meas / self.steer_ratio - x.delta_before)
        delta = -(u.psi_e - psi_ss) - approach - damping
        return self.Y(m.clip(self.steer_ratio * delta, -self.limit, self.limit))

    def update(self, t: Any, x: StanleyState, u: Any, y: Any) -> StanleyState:
        return StanleyState(u.delta_sw_meas / self.steer_ratio)
