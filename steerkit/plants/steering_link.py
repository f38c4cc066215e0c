"""What becomes of a steering command on its way to the motor: whole quanta, a delay that varies, a dead band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import require, require_within, whole_samples
from steerkit._support.random import seed_state, uniform
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.task import DT

_STREAM = 12  # of `seed_state`: the link's delays


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringLink(Block):
    """The way of a steering command to the motor, for a loop in which this way is not perfect.

    sent(t) = quantum floor(delta_sw_cmd(t)/quantum + 1/2),
    arrived(t) = sent(t - a(t)),  a(t + dt) = min(a(t) + dt, d),  d new every `every` seconds, uniform in 0 ... jitter,
    delta_sw(t) = arrived(t)  where it is more than dead_band from delta_sw(t - dt), else delta_sw(t - dt):

    the bus carries whole quanta; each command takes a time of its own, and none overtakes another; the motor's
    controller leaves a change that is smaller than its dead band. By default all is off: delta_sw = delta_sw_cmd.

    input: delta_sw_cmd [rad]. output: delta_sw [rad], what the motor is told, in the same sample. state: delta_sw one
    sample before; with jitter also a and d in samples, the samples since d was drawn, the generator's six numbers and
    the jitter/dt commands before this one, oldest first. A NaN arrives as NaN. In a batch, car i draws as a link of
    seed + i does; quantum and dead_band may be `(N,)` arrays. errors: ValueError for parameters out of range, or a
    jitter or an `every` that is no multiple of dt.
    source: Widrow, Kollar 2008 (quantiser); Nilsson 1998, ch. 3 (random delays in control loops, new each sample);
    Miskowicz 2006 (send on delta).
    """

    delta_sw_cmd = In("rad")
    delta_sw = Out("rad")

    quantum: Scalar = 0.0
    """Resolution of a command [rad]; 0: exact."""
    dead_band: Scalar = 0.0
    """Change of a command that the motor's controller leaves [rad]."""
    jitter: float = 0.0
    """Longest time that a command takes beyond the shortest [s], a multiple of dt."""
    every: float = DT
    """Time between two commands, each of which takes a time of its own [s], a multiple of dt."""
    seed: int = 0
    """Seed of the random delays."""
    dt: float = 0.01

    def __post_init__(self) -> None:
        where = "SteeringLink"
        require_within(where, "dt", self.dt, "s", 1e-6, 1.0)
        require_within(where, "quantum", self.quantum, "rad", 0.0, 1.0, "radians: radians_of(0.1)")
        require_within(where, "dead_band", self.dead_band, "rad", 0.0, 1.0, "radians: radians_of(0.5)")
        whole_samples(where, "jitter", self.jitter, self.dt)
        require(
            whole_samples(where, "every", self.every, self.dt) >= 1, where, f"every = {self.every} [s], expected > 0"
        )
        seed_state(self.seed)

    @property
    def _longest(self) -> int:
        return round(self.jitter / self.dt)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero = m.filled(0.0, batch)
        if not self._longest:
            return (zero,)
        drawn, random = self._drawn(seed_state(self.seed, batch, stream=_STREAM))
        return (zero, drawn, drawn, zero, *random, *(zero,) * self._longest)

    def settle(self, t: float, x: State, u: Any) -> State:
        """As if the first command had been given for long."""
        sent = self._sent(u.delta_sw_cmd)
        return (sent, *x[1:10], *(sent,) * self._longest)

    def output(self, t: Any, x: State, u: Any) -> Any:
        arrived = self._sent(u.delta_sw_cmd)
        for samples in range(1, self._longest + 1):
            arrived = m.where(x[1] > samples - 0.5, x[-samples], arrived)
        return self.Y(m.where(m.absolute(arrived - x[0]) <= self.dead_band, x[0], arrived))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        if not self._longest:
            return (y.delta_sw,)
        _, age, drawn, since, *random = x[:10]
        fresh, random = self._drawn(tuple(random))
        due = since + 1.5 > self.every / self.dt
        drawn = m.where(due, fresh, drawn)
        since = m.where(due, 0.0, since + 1.0)
        return (y.delta_sw, m.minimum(age + 1.0, drawn), drawn, since, *random, *x[11:], self._sent(u.delta_sw_cmd))

    def _sent(self, command: Scalar) -> Scalar:
        rounded = self.quantum * m.floor(command / m.maximum(self.quantum, 1e-9) + 0.5)
        return m.where(self.quantum > 0.0, rounded, command)

    def _drawn(self, random: Any) -> tuple[Scalar, Any]:
        """A delay in samples, 0 to the longest, all equally likely."""
        u, random = uniform(random)
        return m.floor(u * (self._longest + 1.0)), random
