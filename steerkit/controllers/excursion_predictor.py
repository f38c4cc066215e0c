"""How far off a car will get before its recovery controller can turn it, behind a gate that makes the wheel slow."""

from dataclasses import dataclass, field
from typing import Any

from steerkit._support.errors import number
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.maths import Scalar
from steerkit.vehicles.rollout import GateModel, beside, yaw_gain

_STEP = 0.05
"""Time between two points of the roll-out [s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ExcursionPredictor(Block):
    """What a `Supervisor` should judge instead of |e| where a gate lets the wheel turn only so fast.

    At 6 m/s a gate of 3 m/s^2 and 5 m/s^3 needs 1.2 s from lock to lock; a recovery controller that takes over at
    |e| = 0.5 m gets 2 m off before the car has turned. So a kinematic car is rolled out (see `beside`), its wheel held
    at the last command for `hold`, then turned against the drift as fast as the gate allows at the least (see
    `GateModel.pushed`), once to the left and once to the right:

        reach = max(e(t) while turning right, -e(t) while turning left),   t up to `horizon`, by midpoints of 0.05 s
        distance = max(|e|, weight * reach)

    A kinematic car behind the gate gets no further than `reach` (within 1 cm, for |psi_e| <= 0.5 rad,
    |kappa| <= 0.05 /m, v <= 9 m/s, |doe| <= 3 rad), and hardly ever 15 % less far.

    Inputs: e [m], psi_e [rad], kappa [1/m] of the path, all at the **front axle** (a tracker with reference = l_f);
    v [m/s] of the rear axle; doe [rad], the angle that was commanded in the end (a DOE's `state`). Outputs:
    distance [m]; reach [m]. No state. Valid for v >= 0, |doe| <= delta_sw_max. NaN in any input gives NaN out, which a
    `Supervisor` answers. Raises ValueError for parameters that are not positive.
    """

    e = In("m")
    psi_e = In("rad")
    kappa = In("1/m")
    v = In("m/s")
    doe = In("rad")
    distance = Out("m")
    reach = Out("m")

    gate: GateModel = field(default_factory=lambda: GateModel(v_doubt=0.0))
    """The gate, and the car's geometry and ratio."""
    hold: float = number(0.15, "s", low=0.0, high=100.0)
    """Time until the wheels turn back: a sample, and the motor's lag [s]."""
    horizon: float = number(2.0, "s", above=0.0)
    """How far to look ahead [s]."""
    weight: float = number(0.4, "1", above=0.0)
    """A trip at |e| = 0.5 m becomes one at a reach of 0.5/weight = 1.25 m too."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        left, right = self._reach(u, 1.0), self._reach(u, -1.0)
        reach = m.maximum(left, right)
        return self.Y(m.maximum(self.weight * reach, m.absolute(u.e)), reach)

    def _reach(self, u: Any, side: float) -> Scalar:
        """The furthest that the car gets to the left (side = 1) or right (-1) while it is steered the other way [m]."""
        limits = self.gate.limits
        ratio, length, gain = limits.steer_ratio, limits.wheelbase, yaw_gain(u.v, limits.wheelbase, limits.understeer)
        e, psi_e, kappa, wheel = side * u.e, side * u.psi_e, side * u.kappa, side * u.doe  # the right is mirrored
        furthest = e
        for n in range(round(self.horizon / _STEP)):
            before = wheel
            if n * _STEP >= self.hold:
                wheel = self.gate.pushed(-limits.delta_sw_max, wheel, u.v, _STEP)
            r = gain * m.tan(0.5 * (before + wheel) / ratio)
            e, psi_e = beside(e, psi_e, _STEP, u.v, r, length, kappa)
            furthest = m.maximum(e, furthest)
        return furthest
