"""Open-loop steering: a prescribed wave of the steering wheel, before and after which a controller steers."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from steerkit._support.errors import number, require, require_within
from steerkit.diagram import maths as m
from steerkit.diagram.block import State, Wrapper
from steerkit.diagram.maths import Scalar, Table


@dataclass(frozen=True, eq=False, kw_only=True)
class OpenLoop(Wrapper):
    """Wraps a steering controller and steers a prescribed wave, as the manoeuvres of vehicle testing ask.

        delta_sw = base                                 before `wait` and after the wave's end,
        delta_sw = trim + amplitude w(tau - wait - delay)   between; with `on_top`, base in the place of trim

    base: delta_sw of `block`. trim: what it was at the wave's start, through a first-order low-pass of 0.5 s, so that
    the wave begins from the angle that drives straight on. w: the wave, linear between its samples. tau counts from the
    first sample, and anew from the first one with another `number`: waves are exchanged while the state goes on.

    Ports and sample time are those of `block`, which goes on from its own angle; it needs the output delta_sw. State:
    that of `block`, then tau [s], the number, the trim [rad]. amplitude and delay may be `(N,)` arrays in a batch.
    Source: ISO 15037-1 (general conditions: straight ahead, then the input, with the wheel held).
    """

    changes = ("delta_sw",)

    wave: tuple[float, ...] = (0.0, 0.0)
    """w at 0, spacing, 2 spacing, ... [1]."""
    spacing: float = number(0.01, "s", low=1e-3, high=1.0)
    """Between two samples of the wave [s]."""
    amplitude: Scalar = number(0.0, "rad", low=-30.0, high=30.0)
    """Of the steering wheel, + = left [rad]."""
    wait: float = number(0.0, "s", low=0.0, high=1e4)
    """For so long `block` steers first [s]."""
    delay: Scalar = number(0.0, "s", low=0.0, high=10.0)
    """How much later the wave acts, for a batch of cars with a dead time each [s]."""
    on_top: bool = False
    """Does `block` go on steering under the wave?"""
    number: float = number(0.0, "1", low=0.0, high=1e9)
    """Of this wave, among those of a drive."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.wave) >= 2, "OpenLoop", f"a wave of {len(self.wave)} samples, expected 2 or more")
        require_within("OpenLoop", "wave", np.asarray(self.wave), "1", -10.0, 10.0)

    @cached_property
    def _table(self) -> Table:
        return m.rising(self.wave)

    @property
    def seconds(self) -> float:
        """Length of the wave [s]."""
        return (len(self.wave) - 1) * self.spacing

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*self.block.init(batch), *(m.filled(value, batch) for value in (0.0, self.number, 0.0)))

    def settle(self, t: float, x: State, u: Any) -> State:
        inner = self.block.settle(t, self.inner(x), u)
        base = self.block.output(t, inner, u).delta_sw
        return (*inner, *self.own(x)[:2], base + 0.0)

    def output(self, t: Any, x: State, u: Any) -> Any:
        y = self.inner_output(t, x, u)
        tau, trim = self._since(x) - self.wait, x[-1]
        runs = m.both(tau >= -1e-9, tau < self.seconds + self.delay - 1e-9)
        place = m.clip((tau - self.delay) / self.spacing + 1e-9, 0.0, float(len(self._table)))
        steered = (y.delta_sw if self.on_top else trim) + self.amplitude * m.between(self._table, place)
        return y._replace(delta_sw=m.where(runs, steered, y.delta_sw))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        own = self.inner_output(t, x, u)
        inner = self.block.update(t, self.inner(x), u, own)
        tau, trim = self._since(x), x[-1]
        share = self.dt / (0.5 + self.dt)
        waits = m.either(tau < self.wait - 1e-9, tau >= self.wait + self.seconds + self.delay - 1e-9)
        trim = m.where(waits, trim + share * (own.delta_sw - trim), trim)
        return (*inner, tau + self.dt, 0.0 * x[-2] + self.number, trim)

    def _since(self, x: State) -> Scalar:
        """Time since this wave was taken up [s]."""
        return m.where(m.absolute(x[-2] - self.number) < 0.5, x[-3], 0.0)
