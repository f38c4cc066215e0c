"""Blocks that hold everything equations may hold, for the compiler."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from steerkit._support.random import normals, seed_state
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Table


@dataclass(frozen=True, eq=False, kw_only=True)
class Decay(Block):
    """x(k+1) = a x(k) + b u."""

    u = In("1", direct=False)
    x = Out("1", direct=())

    a: Any = 0.9
    b: float = 0.0
    x0: Any = 1.0

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(self.x0, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (self.a * x[0] + self.b * u.u,)


@dataclass(frozen=True, eq=False, kw_only=True)
class Held(Block):
    """A value that stays what it was at the start."""

    v = Out("1", direct=())
    value: Any = 0.5

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(self.value, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0])


@dataclass(frozen=True, eq=False, kw_only=True)
class Oscillator(Block):
    """x'' = -v x: at a held v its step is a matrix."""

    v = In("1", direct=False)
    x = Out("1", direct=())

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(1.0, batch), m.filled(0.0, batch))

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        for _ in range(20):
            x = m.rk4(lambda z: (z[1], -u.v * z[0]), x, self.dt / 20)
        return tuple(x)


def oscillating_loop() -> Loop:
    """An oscillator of two radians a second."""
    held, oscillator = Held(value=4.0), Oscillator()
    return Loop(blocks={"held": held, "oscillator": oscillator}, wires=[(held.v, oscillator.v)])


@dataclass(frozen=True, eq=False, kw_only=True)
class Mixed(Block):
    """Everything that equations may hold: time, tables, choices, functions, a vector port, random numbers."""

    u = In("1")
    y = Out("1")
    row = Out("1", size="n")
    noise = Out("1")
    n: int = 2
    seed: int = 1
    table: Table = field(default_factory=lambda: Table([[0.0, 1.0], [2.0, -1.0], [0.5, 0.25]]))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return seed_state(self.seed, batch)

    def output(self, t: Any, x: State, u: Any) -> Any:
        z = m.wrap(7.0 * t + u.u)
        i = m.clip(m.floor(1.0 + z), 0.0, 2.0)
        a, b = self.table(i)
        c, _ = self.table(m.floor(m.clip(a, 0.0, 2.0)))
        bent = m.where(m.both(z > 0.0, m.either(a < 1.0, b <= 0.5)), m.atan2(a, 1.0 + z * z), m.tanh(z) - m.absolute(b))
        n1, n2, _ = normals(x)
        return self.Y(bent + m.sign(z) * m.exp(-z * z) + m.sqrt(0.1 + m.absolute(c)) * m.tan(0.1 * z), (a, c), n1 + n2)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return normals(x)[2]


@dataclass(frozen=True, eq=False, kw_only=True)
class Hardware(Block):
    """Not pure."""

    u = In("1")
    y = Out("1")

    pure = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Derived(Decay):
    """Works a parameter into another number when it is built, and checks it."""

    def __post_init__(self) -> None:
        if not 0.0 < self.a < 1.0:
            raise ValueError("a")
        object.__setattr__(self, "twice", 2.0 * self.a)


def decay_loop(**kwargs: Any) -> Loop:
    held, decay = Held(), Decay(**kwargs)
    return Loop(blocks={"held": held, "decay": decay}, wires=[(held.v, decay.u)])


def mixed_loop(dt: float = 0.05) -> Loop:
    held, decay, mixed = Held(dt=dt), Decay(b=0.3, dt=dt), Mixed(dt=0.05)
    return Loop(blocks={"held": held, "decay": decay, "mixed": mixed}, wires=[(mixed.y, decay.u), (decay.x, mixed.u)])


def worst(a: Any, b: Any) -> float:
    assert list(a) == list(b)
    assert np.array_equal(a.t, b.t)
    return max(float(np.max(np.abs(a[n] - b[n]), initial=0.0)) for n in a)
