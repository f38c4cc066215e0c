"""The parameters of a car."""

from __future__ import annotations

import dataclasses

import numpy as np

from steerkit._support.errors import require_within
from steerkit.diagram.maths import Scalar
from steerkit.task import STOP

G = 9.81
"""Gravity [m/s^2], as CommonRoad has it."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A car as a single track: what the plants, the controllers and the model predictions need to know of it.

    Every number may be an `(N,)` array, for a batch of N different cars. L = l_f + l_r; at rest the axles carry
    F_zf = m g l_r/L and F_zr = m g l_f/L; the axle forces are c_f alpha_f and c_r alpha_r at small slip angles, with
    alpha_f = delta - beta - l_f r/v and alpha_r = -beta + l_r r/v. Raises ValueError for a number that no car has.
    """

    name: str
    """Name, for messages and plots."""
    m: Scalar
    """Mass [kg]."""
    i_z: Scalar
    """Yaw inertia [kg m^2]."""
    l_f: Scalar
    """Centre of gravity to front axle [m]."""
    l_r: Scalar
    """Centre of gravity to rear axle [m]."""
    c_f: Scalar
    """Cornering stiffness of the front axle, both wheels [N/rad], > 0."""
    c_r: Scalar
    """Cornering stiffness of the rear axle, both wheels [N/rad], > 0."""
    steer_ratio: Scalar
    """Steering-wheel angle over road-wheel angle [1]."""
    mu: Scalar = 1.0
    """Friction coefficient between tyres and road [1]."""
    delta_sw_max: float = STOP
    """Mechanical stop of the steering wheel, to either side [rad]."""

    def __post_init__(self) -> None:
        where = f"Vehicle '{self.name}'"
        for name, unit, low, high, hint in (
            ("m", "kg", 0.5, 1e5, ""),
            ("l_f", "m", 0.02, 20.0, ""),
            ("l_r", "m", 0.02, 20.0, ""),
            ("steer_ratio", "1", 1.0, 50.0, "a pure number, steering-wheel angle over road-wheel angle, such as 15.6"),
            ("mu", "1", 0.01, 3.0, "dry asphalt is about 1, ice 0.1"),
            ("delta_sw_max", "rad", 0.01, 30.0, "radians: radians_of(520)"),
        ):
            require_within(where, name, getattr(self, name), unit, low, high, hint)
        for name, share in (("c_f", self.l_r), ("c_r", self.l_f)):
            load = self.m * G * share / self.wheelbase
            hint = "2 to 100 times the axle's load; positive, per axle (both wheels), per radian and not per degree"
            require_within(where, name, getattr(self, name), "N/rad", 2.0 * load, 100.0 * load, hint)
        point = self.m * self.l_f * self.l_r
        require_within(where, "i_z", self.i_z, "kg m^2", 0.2 * point, 5.0 * point, "0.2 to 5 times m l_f l_r")

    @property
    def wheelbase(self) -> Scalar:
        """L = l_f + l_r [m]"""
        return self.l_f + self.l_r

    @property
    def tightest(self) -> Scalar:
        """Radius of the centre of gravity with the wheel at its stop, rolling: sqrt((L/tan delta_max)^2 + l_r^2) [m]"""
        return np.hypot(self.wheelbase / np.tan(np.minimum(self.delta_sw_max / self.steer_ratio, 1.5)), self.l_r)

    @property
    def understeer_gradient(self) -> Scalar:
        """K = m (c_r l_r - c_f l_f) / (c_f c_r L) [rad s^2/m]

        Steady driving needs delta = L kappa + K v^2 kappa; then r/delta = v/(L + K v^2). K > 0 understeers.
        Source: Rajamani 2012, section 3.3.
        """
        return self.m * (self.c_r * self.l_r - self.c_f * self.l_f) / (self.c_f * self.c_r * self.wheelbase)


def require_vehicle(vehicle: object, where: str) -> None:
    """Raise ValueError, in the name of `where`, unless this is a `Vehicle`: a name is none yet."""
    if not isinstance(vehicle, Vehicle):
        what = f"vehicle = {vehicle!r:.60}, expected a Vehicle; by name or from a file: vehicle('vw-passat')"
        raise ValueError(f"{where}: {what}")
