"""Pure pursuit, the well-known baseline."""

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number, require
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.maths import Scalar
from steerkit.paths.path import Path
from steerkit.task import DT
from steerkit.vehicles import Vehicle, require_vehicle


@dataclass(frozen=True, eq=False, kw_only=True)
class PurePursuit(Block):
    """Pure pursuit: the rear axle drives the circle through a point of the path some way ahead.

    goal = c(s + look), look = clip(look_time*v, look_min, look_max),  rear = (x, y) - l_r (cos psi, sin psi),
    alpha = angle to goal from rear - psi,  delta = atan(2 L sin(alpha)/|goal - rear|),  delta_sw = steer_ratio*delta.

    Beyond the end of an open path the goal runs on along its tangent. No term looks at e, at tyre slip or at delay: it
    cuts corners by about look^2 kappa/6, and is here to be compared with.

    Inputs: s [m] along `path` of the rear axle (a tracker with reference = -l_r); x, y [m] of the centre of gravity;
    psi [rad]; v [m/s]. Output: delta_sw [rad], within the car's stop. No state. A negative v counts as 0. NaN in any
    input gives NaN out.

    Source: Coulter 1992; Snider 2009, section 2.1.
    """

    s = In("m")
    x = In("m")
    y = In("m")
    psi = In("rad")
    v = In("m/s")
    delta_sw = Out("rad")

    vehicle: Vehicle
    """The car, for its geometry, ratio and stop."""
    path: Path
    """The path."""
    look_time: Scalar = number(0.5, "s", above=0.0)
    """Distance to the goal over speed [s]."""
    look_min: Scalar = number(2.5, "m", above=0.0)
    """Least distance to the goal [m]."""
    look_max: Scalar = 20.0
    """Largest distance to the goal [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vehicle(self.vehicle, "PurePursuit")
        require(self.look_max >= self.look_min, "PurePursuit", f"look_max = {self.look_max} m, expected >= look_min")

    @classmethod
    def of(cls, vehicle: Vehicle, path: Path, *, delay: float = 0.0, dt: float = DT) -> "PurePursuit":
        """The controller for a car on a path.

        delay [s] of the steering: the only remedy is a goal farther away, at the price of cut corners. look_time grows
        by 2 delay and look_min by 8 m/s * delay: near the least |e| on the 795 m course for each delay, by search.
        """
        require(0.0 <= delay <= 2.0, "PurePursuit", f"delay = {delay} [s], expected 0 to 2")
        return cls(vehicle=vehicle, path=path, look_time=0.5 + 2.0 * delay, look_min=2.5 + 8.0 * delay, dt=dt)

    @property
    def reference(self) -> Scalar:
        """Where s has to be measured: the rear axle, metres ahead of the centre of gravity."""
        return -self.vehicle.l_r

    def output(self, t: Any, x: Any, u: Any) -> Any:
        car = self.vehicle
        look = m.clip(self.look_time * m.maximum(u.v, 0.0), self.look_min, self.look_max)
        wanted = u.s + look
        known = m.is_finite(wanted)
        s = self.path.inside(m.where(known, wanted, 0.0))
        cx, cy, tx, ty, _, _ = self.path.frame(s)
        dx = cx - (u.x - car.l_r * m.cos(u.psi))
        dy = cy - (u.y - car.l_r * m.sin(u.psi))
        over = 0.0 if self.path.closed else wanted - s
        over = over + m.where(
            over > 0.0, m.maximum(-dx * tx - dy * ty, 0.0), 0.0
        )  # s stays at the end, the car goes on
        beyond = m.where(known, over, wanted)
        dx, dy = dx + beyond * tx, dy + beyond * ty
        side = dy * m.cos(u.psi) - dx * m.sin(u.psi)
        delta = m.atan2(2.0 * car.wheelbase * side, m.maximum(dx * dx + dy * dy, 0.01))
        return self.Y(m.clip(car.steer_ratio * delta, -car.delta_sw_max, car.delta_sw_max))
