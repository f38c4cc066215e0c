"""The complete Stanley controller."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from steerkit._support.errors import number
from steerkit.controllers.limits import LimitedLaw, approach_angle, limited, possible
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, Out
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import DT
from steerkit.vehicles import Vehicle

_NO_LIMIT = 1e3
"""m/s^2 or rad/s: more than any car can do."""


class StanleyState(NamedTuple):
    """The road-wheel angle measured one sample before (kept with a k_d_steer only) and the command of then [rad]."""

    delta_before: Any
    command: Any


@dataclass(frozen=True, eq=False, kw_only=True)
class Stanley(LimitedLaw):
    """Stanley's steering law with all its terms: heading, cross-track, yaw damping, steer damping, curve offset.

    delta = -(psi_e - psi_ss) - sat_a(arctan(k*e / (k_soft + v))) - k_d_yaw*(r - r_path)
            + k_d_steer*(delta_meas(i-1) - delta_meas(i)),
    psi_ss = m*v*r_path*l_r / (c_f*L),  r_path = v*kappa/sqrt(1 - (L*kappa)^2),  delta_sw = sat(steer_ratio*delta).

    The signs are ISO 8855 (left positive): the paper's delta, psi and e all have the opposite sign. psi_ss is the
    front slip angle of the steady curve (c_f per axle): with it the law holds e = 0 there at any speed.

    What is not in the paper: the root in r_path, for with the front axle on the path the rear one runs a tighter circle
    (1.03 at 12 m radius, 1.12 at 6 m); and limits, so that the law can catch a car from 3 m and 45 degrees off. sat_a
    keeps the approach angle within approach_limit and within that from which half of the lateral acceleration to spare,
    and half of the slew, still turn the car onto the path (`limits.approach_angle`): with a steeper one, a car whose
    steering is slow swings further each time. sat keeps the wheel, and how fast it turns, within
    max(a_y_max, v*|r_path| + a_y_reserve) (see `limits`), +-limit and rate_limit. `textbook` has none of all this.

    Inputs (all at the **front axle**: a tracker with reference = l_f): e [m], psi_e [rad], kappa [1/m]; v [m/s],
    r [rad/s]; delta_sw_meas [rad], the measured steering wheel. Output: delta_sw [rad].
    State: the road-wheel angle measured one sample before, the command before. A negative v counts as 0, where k_soft
    keeps the law regular. NaN in any input gives NaN out. Raises ValueError for gains out of range.

    Source: Hoffmann, Tomlin, Montemerlo, Thrun, ACC 2007, eq. 9. k_soft = 1 is theirs; the other gains are not
    published: these are for a steering delay up to 0.1 s, those of `delay.delayed_stanley` for delays up to 0.3 s.
    """

    e = In("m")
    psi_e = In("rad")
    kappa = In("1/m")
    v = In("m/s")
    r = In("rad/s")
    delta_sw_meas = In("rad")
    delta_sw = Out("rad")

    k: Scalar = number(2.5, "1/s", low=0.0)
    """Cross-track gain [1/s]."""
    k_soft: Scalar = number(1.0, "m/s", above=0.0)
    """Softening speed [m/s]."""
    k_d_yaw: Scalar = number(0.15, "s", low=0.0)
    """Yaw-rate damping [s]."""
    k_d_steer: Scalar = number(0.3, "1", low=0.0)
    """Steering damping [1]."""
    approach_limit: Scalar = number(radians_of(30.0), "rad", above=0.0)
    """Largest approach angle that the cross-track term may ask for [rad]."""
    share: Scalar = number(1.0, "1", above=0.0, high=1.0)
    """Share of what the law asks for beyond the path's own angle, (L + K v^2) kappa: < 1 where the wheel is slow."""
    v_full: Scalar | None = number(None, "m/s", above=0.0)
    """Speed above which that share falls as 1/v, as the car turns by more the faster it is [m/s]; None: nowhere."""
    mass: Scalar = number(0.0, "kg", low=0.0)
    """Car mass [kg]; 0 leaves out the curve offset psi_ss."""
    c_f: Scalar = number(1.0, "N/rad", above=0.0)
    """Cornering stiffness of the front axle [N/rad]."""
    reference: Scalar = 1.2
    """Where e, psi_e and kappa have to be measured: metres ahead of the centre of gravity (the front axle, l_f)."""

    @classmethod
    def of(cls, vehicle: Vehicle, *, dt: float = DT) -> "Stanley":
        """The controller with geometry, mass, stiffness, ratio and stop of a `Vehicle`."""
        geometry = cls.geometry(vehicle, "Stanley.of")
        return cls(mass=vehicle.m, c_f=vehicle.c_f, dt=dt, **geometry)

    @classmethod
    def textbook(cls, vehicle: Vehicle, *, dt: float = DT) -> "Stanley":
        """The form of most public code: heading and cross-track terms only, hardly any softening, no limits."""
        bare = dict(k=2.5, k_soft=1e-3, k_d_yaw=0.0, k_d_steer=0.0, mass=0.0, approach_limit=m.pi / 2.0)
        return replace(cls.of(vehicle, dt=dt), **bare, a_y_max=_NO_LIMIT, rate_limit=_NO_LIMIT)

    def init(self, batch: tuple[int, ...] = ()) -> StanleyState:
        return StanleyState(m.filled(0.0, batch), m.filled(0.0, batch))

    def settle(self, t: float, x: StanleyState, u: Any) -> StanleyState:
        return StanleyState(u.delta_sw_meas / self.steer_ratio, u.delta_sw_meas + 0.0)

    def output(self, t: Any, x: StanleyState, u: Any) -> Any:
        v = m.maximum(u.v, 0.0)
        bent = self.wheelbase * u.kappa
        r_path = v * u.kappa / m.sqrt(m.maximum(1.0 - bent * bent, 0.1))
        psi_ss = self.mass * v * r_path * (self.l_r / self.wheelbase) / self.c_f
        spare = possible(self, m.maximum(self.a_y_max - v * m.absolute(r_path), self.a_y_reserve))
        slew = None if self.slew is None else 0.5 * self.slew
        steepest = m.minimum(approach_angle(u.e, v, 0.5 * spare, slew), self.approach_limit)
        slower = 1.0 if self.v_full is None else self.v_full / m.maximum(v, self.v_full)
        approach = m.clip(m.atan(self.k * slower * u.e / (self.k_soft + v)), -steepest, steepest)
        damping = self.k_d_yaw * (u.r - r_path) + self.k_d_steer * (u.delta_sw_meas / self.steer_ratio - x.delta_before)
        delta = -(u.psi_e - psi_ss) - approach - damping
        steady = (self.wheelbase + self.understeer * v * v) * u.kappa
        delta = delta - (1.0 - self.share * slower) * (delta - steady)
        return self.Y(limited(self, self.steer_ratio * delta, x.command, v, v * m.absolute(r_path)))

    @property
    def update_reads_inputs(self) -> bool:
        return not (isinstance(self.k_d_steer, float) and self.k_d_steer == 0.0)

    def update(self, t: Any, x: StanleyState, u: Any, y: Any) -> StanleyState:
        before = u.delta_sw_meas / self.steer_ratio if self.update_reads_inputs else x.delta_before
        return StanleyState(before, y.delta_sw)
