"""A controller that is told what the steering makes of its commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import require
from steerkit.diagram.block import Block, State, take_ports


@dataclass(frozen=True, eq=False, kw_only=True)
class CommandCompensation(Block):
    """Wraps a controller so that it need not know of an offset or a gain of the steering, for comparing what is told.

        delta_sw = (delta_sw of `block` - offset)/gain

    is what a steering that turns the wheel to gain*command + offset has to be told. Ports, units, state and sample time
    are those of `block`, which goes on from its own angle. A measured angle is that of the wheel, offset and gain
    included, and reaches it as it is.

    Raises ValueError for a gain that is not positive and for a block without an output delta_sw.
    """

    block: Block
    """The controller."""
    offset: float = 0.0
    """Offset of the angle reached [rad]."""
    gain: float = 1.0
    """Angle reached over angle commanded [1]."""

    def __post_init__(self) -> None:
        require(self.gain > 0.0, "CommandCompensation", f"gain = {self.gain} [1], expected > 0")
        gives = [port.name for port in self.block.outputs]
        require("delta_sw" in gives, "CommandCompensation", f"block with outputs {gives}, expected delta_sw among them")
        take_ports(self, self.block)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return self.block.init(batch)

    def settle(self, t: float, x: State, u: Any) -> State:
        return self.block.settle(t, x, u)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        y = self.block.output(t, x, u)
        return y._replace(delta_sw=(y.delta_sw - self.offset) / self.gain)

    def update(self, t: Any, x: Any, u: Any, y: Any) -> State:
        return self.block.update(t, x, u, y._replace(delta_sw=self.gain * y.delta_sw + self.offset))
