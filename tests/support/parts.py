"""Small blocks to wire up in tests."""

from dataclasses import dataclass
from typing import Any

from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop


@dataclass(frozen=True, eq=False, kw_only=True)
class Count(Block):
    """n = 0, step, 2 step, ..."""

    n = Out("m", direct=())
    step: Any = 1.0

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (m.filled(0.0, batch),)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0])

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return (x[0] + self.step,)


@dataclass(frozen=True, eq=False, kw_only=True)
class Gain(Block):
    """y = k u, at once."""

    u = In("m")
    y = Out("m")
    k: Any = 1.0

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(self.k * u.u)


@dataclass(frozen=True, eq=False, kw_only=True)
class Delay(Block):
    """y = u one sample before; `first` at the start."""

    u = In("m", direct=False)
    y = Out("m", direct=())
    first: float = 0.0

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (m.filled(self.first, batch),)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0])

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return (u.u,)


@dataclass(frozen=True, eq=False, kw_only=True)
class Sum(Block):
    """total = sum of all u before."""

    u = In("m", direct=False)
    total = Out("m", direct=())

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (m.filled(0.0, batch),)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0])

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return (x[0] + u.u,)


@dataclass(frozen=True, eq=False, kw_only=True)
class Pair(Block):
    """A vector: (u, 2 u)."""

    u = In("m")
    both = Out("m", size="entries")
    entries: int = 2

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y((u.u, 2.0 * u.u))


@dataclass(frozen=True, eq=False, kw_only=True)
class Angle(Block):
    """An angle from a length: nothing but other units."""

    u = In("m")
    angle = Out("rad")

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(0.1 * u.u)


@dataclass(frozen=True, eq=False, kw_only=True)
class Wave(Block):
    """v = sin(rate t), with a state that is never a round number."""

    v = Out("m", direct=())
    rate: Any = 0.7

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (m.filled(1.0, batch), m.filled(0.0, batch))

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[1])

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        c, s = m.cos(self.rate * self.dt), m.sin(self.rate * self.dt)
        return (c * x[0] - s * x[1], s * x[0] + c * x[1])


@dataclass(frozen=True, eq=False, kw_only=True)
class Script(Block):
    """A signal written down beforehand, sample by sample; the last one stays. Ports by unit."""

    length = Out("m")
    angle = Out("rad")
    flag = Out("1")
    speed = Out("m/s")
    values: tuple[float, ...]

    def output(self, t: Any, x: Any, u: Any) -> Any:
        value = self.values[min(round(t / self.dt), len(self.values) - 1)]
        return self.Y(value, value, value, value)


def chain(**rates: float) -> Loop:
    """count -> gain -> total, and count -> late."""
    count, gain, total, late = Count(), Gain(), Sum(), Delay(first=-1.0)
    wires = [(count.n, gain.u), (gain.y, total.u), (count.n, late.u)]
    return Loop(blocks={"count": count, "gain": gain, "total": total, "late": late}, wires=wires, **rates)
