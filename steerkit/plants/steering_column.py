"""What lies between the motor and the road wheels: friction that holds the column, and free play."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import require_within
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringColumn(Block):
    """A worn steering between motor and road wheels: Coulomb friction behind an elastic shaft, then free play.

    delta_sw_meas(t) = motor(t) - clip(motor(t) - delta_sw_meas(t - dt), -friction, friction),
    delta_sw(t) = delta_sw_meas(t) - clip(delta_sw_meas(t) - delta_sw(t - dt), -play/2, play/2).

    Both are play operators: what is behind stays until what is in front has used up the gap, and then follows at its
    end. Between motor and steering wheel the gap is the twist at which the shaft's torque overcomes the friction,
    T_f/c, to either side; so a full to and fro of the motor leaves a loop of the width 2*friction, and the sensor at
    the steering wheel sees it. Between steering wheel and road wheels it is the free play, half to either side, a loop
    of the width `play`, which no sensor sees. Neither adds a delay. By default both are off.

    input: delta_sw_in [rad], the motor's angle, as one of the steering wheel. outputs, in the same sample: delta_sw
    [rad], the angle that the road wheels have, times the ratio; delta_sw_meas [rad], of the steering wheel, what is
    measured: `zero` more than there is. state: that less `zero`, and delta_sw, one sample before. It starts in the
    middle of its gaps. A NaN stays NaN. Parameters may be `(N,)` arrays in a batch. errors: ValueError for parameters
    out of range.
    source: Nordin, Gutman 2002 (backlash); Visintin 1994, ch. III (play operator; Coulomb friction with a spring is
    its stop); Pfeffer, Harrer, Johnston 2008 (friction and elasticity of steering).
    """

    delta_sw_in = In("rad")
    delta_sw = Out("rad")
    delta_sw_meas = Out("rad")

    friction: Scalar = 0.0
    """Twist of the shaft that the friction holds, to either side [rad]."""
    play: Scalar = 0.0
    """Free play, from end to end [rad]."""
    zero: Scalar = 0.0
    """What the sensor at the steering wheel shows while that is straight [rad]."""
    dt: float = 0.01

    def __post_init__(self) -> None:
        where = "SteeringColumn"
        require_within(where, "dt", self.dt, "s", 1e-6, 1.0)
        require_within(where, "friction", self.friction, "rad", 0.0, 1.0, "radians: radians_of(1)")
        require_within(where, "play", self.play, "rad", 0.0, 1.0, "radians: radians_of(2)")
        require_within(where, "zero", self.zero, "rad", -1.0, 1.0, "radians: radians_of(3)")

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),) * 2

    def settle(self, t: float, x: State, u: Any) -> State:
        return (u.delta_sw_in + 0.0, u.delta_sw_in + 0.0)

    def output(self, t: Any, x: State, u: Any) -> Any:
        wheel = _follows(u.delta_sw_in, x[0], self.friction)
        return self.Y(_follows(wheel, x[1], 0.5 * self.play), wheel + self.zero)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (_follows(u.delta_sw_in, x[0], self.friction), y.delta_sw)


def _follows(front: Scalar, behind: Scalar, gap: Scalar) -> Scalar:
    """The play operator: where what was `behind` is now, with a gap to either side of `front`."""
    return front - m.clip(front - behind, -gap, gap)
