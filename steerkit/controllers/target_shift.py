"""A target path that comes to a car which has lost it, and moves back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.task import TRIP


@dataclass(frozen=True, eq=False, kw_only=True)
class TargetShift(Block):
    """Moves the target path sideways to a car that has lost it, and then slowly back: the learner drives on at once.

        e = e_path - shift,   e_dot = e_dot_path + back/dt,   shift(0) = 0,   back = shift(t), at most +-rate*dt
        shift(t + dt) = sat(e_path(t) + dt*e_dot_path(t)) if |e(t)| > trip, else shift(t) - back;   sat to +-limit

    Between tracker and controllers: they see e and e_dot, so that a `Supervisor` behind it sees one sample beyond its
    trip, the learner's failure, and then e near 0. Beyond limit + trip the target no longer follows, and the recovery
    controller, which sees the path itself, brings the car back. Inputs: e_path [m], e_dot_path [m/s]. Outputs: e [m];
    e_dot [m/s]; shift [m], + = left. A NaN in e_path is a NaN in e; neither is ever in the shift. State: the
    shift. Valid where the ground beside the path can be driven on.
    Raises ValueError unless trip, limit and rate are positive. Source: ours.
    """

    e_path = In("m")
    e_dot_path = In("m/s")
    e = Out("m", direct=(e_path,))
    e_dot = Out("m/s", direct=(e_dot_path,))
    shift = Out("m", direct=())

    trip: float = number(TRIP, "m", above=0.0)
    """|e| above which the target comes to the car [m]."""
    limit: float = number(1.5, "m", above=0.0)
    """Farthest shift [m]."""
    rate: float = number(0.25, "m/s", above=0.0)
    """How fast the target returns to the path [m/s]."""

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(u.e_path - x[0], u.e_dot_path + self._back(x) / self.dt, x[0])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        target, back = u.e_path + self.dt * u.e_dot_path, x[0] - self._back(x)
        lost = m.both(m.absolute(y.e) > self.trip, m.is_finite(target))
        return (m.where(lost, m.clip(target, -self.limit, self.limit), back),)

    def _back(self, x: State) -> Any:
        return m.clip(x[0], -self.rate * self.dt, self.rate * self.dt)
