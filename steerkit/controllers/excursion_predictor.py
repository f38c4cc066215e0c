"""How far off a car will get before its recovery controller can turn it, behind a gate that makes the wheel slow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import require
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.units import radians_of
from steerkit.task import A_Y_MAX, JERK_MAX, STOP
from steerkit.vehicles import Vehicle


@dataclass(frozen=True, eq=False, kw_only=True)
class ExcursionPredictor(Block):
    """What a `Supervisor` should judge instead of |e| where a gate lets the wheel turn only so fast.

    At 6 m/s a gate of 3 m/s^2 and 5 m/s^3 needs 1.2 s from lock to lock; who waits for |e| = 0.5 m is 2 m off before
    the car has turned. So a kinematic car is rolled forward, its wheel held where it was commanded last for `hold`,
    then turned against the drift as fast as the gate allows, once to the left and once to the right:

        kappa_s(t) = kappa_s(0) while t < hold,   then kappa_s(t) = kappa_s(t - h) -+ h turn
        not beyond -+most,   nor, while it grows, beyond v^2 kappa_s + v arm kappa_s' = -+a_y_max
        and where it is beyond most, the car having been slower, back by h fast
        delta = atan(L kappa_s)
        e' = v sin(psi_e + delta),   psi_e' = v (sin(delta)/L - kappa cos(psi_e + delta)),   all at the front axle
        most = min(a_y_max/v^2, tan(delta_sw_max/steer_ratio)/L)
        fast = min(jerk_max/v^2, rate_max/(steer_ratio L))
        turn = fast - quantum (1 + (L kappa_s)^2)/(frame_dt steer_ratio L),   at least 0
        reach = max(e(t) while turning right, -e(t) while turning left),   t up to `horizon`, by midpoints of h = 0.05 s
        distance = max(|e|, weight * reach)

    The last term of turn is what the gate's rounding of every frame to whole quanta may cost; it costs half of that on
    average. So a kinematic car behind the gate gets no further than `reach`: within 1 cm, which the steps of h are good
    for at |psi_e| <= 0.5 rad, |kappa| <= 0.05 /m, v <= 9 m/s, |doe| <= 3 rad; and hardly ever 15 % less far.

    Inputs: e [m], psi_e [rad], kappa [1/m] of the path, all at the **front axle** (a tracker with reference = l_f);
    v [m/s]; doe [rad], the angle that was commanded in the end (a DOE's `state`). Outputs: distance [m]; reach [m].
    No state. Valid for v >= 0, |doe| <= delta_sw_max. NaN in any input gives NaN out, which a `Supervisor` answers.
    Raises ValueError for limits that are not positive. Source: kinematic bicycle in path coordinates (Rajamani 2012,
    eq. 2.5 and 2.41); the bounds are the gate's.
    """

    e = In("m")
    psi_e = In("rad")
    kappa = In("1/m")
    v = In("m/s")
    doe = In("rad")
    distance = Out("m")
    reach = Out("m")

    a_y_max: float = A_Y_MAX
    """Largest lateral acceleration that the gate allows [m/s^2]."""
    jerk_max: float = JERK_MAX
    """Its fastest change [m/s^3]."""
    rate_max: float = radians_of(550.0)
    """Fastest steering wheel [rad/s]."""
    delta_sw_max: float = STOP
    """Largest |delta_sw| [rad]."""
    v_floor: float = 1.0
    """Slowest speed that the bounds reckon with [m/s]."""
    steer_ratio: float = 15.6
    """Steering-wheel angle over road-wheel angle [1]."""
    wheelbase: float = 2.71
    """L [m]."""
    arm: float = 1.49
    """Centre of gravity to rear axle [m]: the gate keeps the centre's lateral acceleration while the wheel turns."""
    quantum: float = radians_of(0.1)
    """Resolution of the angle on the bus [rad]; the gate rounds every frame towards the one before."""
    frame_dt: float = 0.02
    """Time between two frames [s]."""
    hold: float = 0.15
    """Time until the wheels turn back: a sample, and the motor's lag [s]."""
    horizon: float = 2.0
    """How far to look ahead [s]."""
    weight: float = 0.4
    """A trip at |e| = 0.5 m becomes one at a reach of 0.5/weight = 1.25 m too."""

    def __post_init__(self) -> None:
        for name in (
            "a_y_max",
            "jerk_max",
            "rate_max",
            "delta_sw_max",
            "v_floor",
            "steer_ratio",
            "wheelbase",
            "arm",
            "frame_dt",
            "horizon",
            "weight",
        ):
            require(getattr(self, name) > 0.0, "ExcursionPredictor", f"{name} = {getattr(self, name)}, expected > 0")
        require(self.hold >= 0.0, "ExcursionPredictor", f"hold = {self.hold} s, expected >= 0")
        require(self.quantum >= 0.0, "ExcursionPredictor", f"quantum = {self.quantum} rad, expected >= 0")

    @classmethod
    def of(cls, vehicle: Vehicle, **settings: float) -> ExcursionPredictor:
        """For the geometry, ratio and stop of a `Vehicle`; settings: any fields, such as the gate's limits."""
        known: dict[str, Any] = dict(
            steer_ratio=vehicle.steer_ratio,
            wheelbase=vehicle.wheelbase,
            arm=vehicle.l_r,
            delta_sw_max=vehicle.delta_sw_max,
        )
        return cls(**(known | settings))

    def output(self, t: Any, x: Any, u: Any) -> Any:
        left, right = self._reach(u, 1.0), self._reach(u, -1.0)
        reach = m.maximum(left, right)
        return self.Y(m.maximum(self.weight * reach, m.absolute(u.e)), reach)

    def _reach(self, u: Any, side: float) -> Any:
        """The furthest that the car gets to the left (side = 1) or right (-1) while it is steered the other way [m]."""
        h, length = 0.05, self.wheelbase
        v = m.maximum(u.v, self.v_floor)
        v_squared = v**2
        fastest = m.minimum(self.jerk_max / v_squared, self.rate_max / (self.steer_ratio * length))
        rounding = self.quantum / (self.frame_dt * self.steer_ratio * length)
        curvature = m.minimum(self.a_y_max / v_squared, m.tan(self.delta_sw_max / self.steer_ratio) / length)
        sway = self.arm / (v * h)
        # seen in the mirror, the right is the left
        e, psi_e, kappa = side * u.e, side * u.psi_e, side * u.kappa
        steered = m.tan(side * u.doe / self.steer_ratio) / length
        furthest = e
        for n in range(round(self.horizon / h)):
            before = steered
            if n * h >= self.hold:
                bent = length * steered
                lost = rounding * (1.0 + bent * bent)
                swung = (steered + self.a_y_max / v_squared) / (h * (1.0 + sway))  # what a_y leaves to turn by
                turn = m.minimum(m.maximum(fastest - lost, 0.0), m.maximum(swung - lost, lost))
                steered = m.clip(-curvature, steered - h * turn, steered + h * fastest)
            delta = m.atan(length * 0.5 * (before + steered))  # halfway through the step
            half = 0.5 * h * u.v * (m.sin(delta) / length - kappa * m.cos(psi_e + delta))
            e = e + h * u.v * m.sin(psi_e + half + delta)
            psi_e = psi_e + 2.0 * half
            furthest = m.maximum(e, furthest)
        return furthest
