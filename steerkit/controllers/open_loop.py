"""A wave of the steering wheel, instead of a controller or on top of it: manoeuvres, and what estimators need."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import pi
from types import MappingProxyType
from typing import Any

import numpy as np

from steerkit._support.errors import known, number, require, require_within
from steerkit.controllers.adaptive import Adaptive
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, State, Wrapper
from steerkit.diagram.maths import Scalar, Table
from steerkit.vehicles import Vehicle, require_vehicle


@dataclass(frozen=True, eq=False, kw_only=True)
class OpenLoop(Wrapper):
    """Wraps a steering controller and steers a prescribed wave, as the manoeuvres of vehicle testing ask.

        delta_sw = base                                 before `wait` and after the wave's end,
        delta_sw = trim + amplitude w(tau - wait)   between; with `on_top`, base in the place of trim

    base: delta_sw of `block`. trim: what it was at the wave's start, through a first-order low-pass of 0.5 s, so that
    the wave begins from the angle that drives straight on. w: the wave, linear between its samples. tau counts from the
    first sample, and anew from the first one with another `number`: waves are exchanged while the state goes on.

    Ports and sample time are those of `block`, which goes on from its own angle; it needs the output delta_sw. State:
    that of `block`, then tau [s], the number, the trim [rad]. amplitude may be an `(N,)` array in a batch.
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
        runs = m.both(tau >= -1e-9, tau < self.seconds - 1e-9)
        place = m.clip(tau / self.spacing + 1e-9, 0.0, float(len(self._table)))
        steered = (y.delta_sw if self.on_top else trim) + self.amplitude * m.between(self._table, place)
        return y._replace(delta_sw=m.where(runs, steered, y.delta_sw))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        own = self.inner_output(t, x, u)
        inner = self.block.update(t, self.inner(x), u, own)
        tau, trim = self._since(x), x[-1]
        share = self.dt / (0.5 + self.dt)
        waits = m.either(tau < self.wait - 1e-9, tau >= self.wait + self.seconds - 1e-9)
        trim = m.where(waits, trim + share * (own.delta_sw - trim), trim)
        return (*inner, tau + self.dt, 0.0 * x[-2] + self.number, trim)

    def _since(self, x: State) -> Scalar:
        """Time since this wave was taken up [s]."""
        return m.where(m.absolute(x[-2] - self.number) < 0.5, x[-3], 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class WithExcitation(Wrapper):
    """Wraps a steering controller and adds a wave to its command, which excites what estimators have to identify.

        delta_sw = delta_sw of `block` + w,   w = n (L + K v^2)/v^2 a,   sat to -+most,
        a = amplitude sat(steepness sin(2 pi frequency tau)),   sat to -+1,   |v r + a| <= a_y_most

    a is the lateral acceleration of a car without lag: so the lateral displacement is the same at any speed,
    amplitude/(2 pi frequency)^2 for a sine. steepness 1 is a sine, 4 and more are steps. In bends a is cut, and never
    adds to what is beyond a_y_most already. Below v_least, or where v or r is not finite, w = 0. tau counts from the
    first sample, and anew from the first one with another `number`: waves are exchanged while the state goes on.

    The controller rejects w as any disturbance, and goes on from its own angle. One that watches its own commands
    (`Adaptive`) has to be put around this block, not inside. Ports and sample time are those of `block`; it needs the
    inputs v and r and the output delta_sw. State: that of `block`, then tau [s] and the number. Source: Ljung 1999,
    section 13.3 (inputs for identification: sums of sines, and steps; within the limits of the system).
    """

    needs = ("v", "r")
    changes = ("delta_sw",)

    vehicle: Vehicle
    """The car by its data sheet, for g(v)."""
    amplitude: Scalar = number(0.5, "m/s^2", low=0.0, high=3.0)
    """Of the lateral acceleration [m/s^2]; 0: `block` alone."""
    frequency: Scalar = number(0.3, "Hz", low=0.01, high=2.0)
    """[Hz]"""
    steepness: Scalar = number(1.0, "1", low=1.0, high=1e3)
    """1: a sine; the more, the more like steps [1]."""
    most: Scalar = number(1.0, "rad", low=0.0, high=3.0)
    """Largest |w| [rad]."""
    a_y_most: Scalar = number(2.0, "m/s^2", low=0.1, high=3.0)
    """Lateral acceleration that w does not lead beyond [m/s^2]."""
    v_least: Scalar = number(2.0, "m/s", low=0.5, high=20.0)
    """Slowest speed with a wave [m/s]."""
    number: float = number(0.0, "1", low=0.0, high=1e6)
    """Of this wave, among those of a drive."""

    def __post_init__(self) -> None:
        require_vehicle(self.vehicle, "WithExcitation")
        super().__post_init__()

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*self.block.init(batch), m.filled(0.0, batch), m.filled(self.number, batch))

    def output(self, t: Any, x: State, u: Any) -> Any:
        y = self.inner_output(t, x, u)
        return y._replace(delta_sw=y.delta_sw + self._wave(x, u))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        own = y._replace(delta_sw=y.delta_sw - self._wave(x, u))
        inner = self.block.update(t, self.inner(x), u, own)
        return (*inner, self._since(x) + self.dt, 0.0 * x[-1] + self.number)

    def _wave(self, x: State, u: Any) -> Scalar:
        """w of this sample [rad]."""
        drives = m.every(m.is_finite(u.v), m.is_finite(u.r), u.v >= self.v_least)
        v = m.where(drives, u.v, self.v_least)
        swing = m.clip(self.steepness * m.sin(2.0 * pi * self.frequency * self._since(x)), -1.0, 1.0)
        a_y = m.where(drives, v * u.r, 0.0)
        low, high = m.minimum(-self.a_y_most - a_y, 0.0), m.maximum(self.a_y_most - a_y, 0.0)
        wave = m.clip(self.vehicle.wheel_per_a_y(v) * m.clip(self.amplitude * swing, low, high), -self.most, self.most)
        return m.where(drives, wave, 0.0)

    def _since(self, x: State) -> Scalar:
        """Time since this wave began [s]."""
        return m.where(m.absolute(x[-1] - self.number) < 0.5, x[-2], 0.0)


WAVES: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "sine": {"amplitude": 0.6, "frequency": 0.3},
        "steps": {"amplitude": 0.5, "frequency": 0.2, "steepness": 6.0},
        "bends": {"amplitude": 0.0},
    }
)
"""The waves of a calibration by name; in `bends` the course alone moves the wheel."""


def with_excitation(controller: Block, wave: str, vehicle: Vehicle) -> Block:
    """`controller` with one of `WAVES` on top; one that adapts gets it inside. Raises ValueError for another name."""
    known(wave, WAVES, "wave")
    if isinstance(controller, Adaptive):
        return replace(controller, blocks=tuple(with_excitation(block, wave, vehicle) for block in controller.blocks))
    return WithExcitation(block=controller, vehicle=vehicle, number=float([*WAVES].index(wave)), **WAVES[wave])
