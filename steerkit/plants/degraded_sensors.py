"""What goes wrong between sensors and controllers: late and lost samples, jumps, a heading that drifts, no sideslip."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

from steerkit._support.errors import require, require_within, whole_samples
from steerkit._support.random import normals, seed_state, uniform
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.plants.sensors import Sensors
from steerkit.task import DT
from steerkit.vehicles import Vehicle

_STREAM = 13  # of `seed_state`: what goes wrong
_SLOWEST = 1.0  # m/s, for the estimate of sideslip


@dataclass(frozen=True, eq=False, kw_only=True)
class DegradedSensors(Block):
    """Sensors as a car in series has them, for judging controllers by what they will really see.

    With g' standard normal, new each sample, and measured(t) what the wrapped sensors make of the truth a dt ago,

    older(t) = truth(t) + a (truth(t - dt) - truth(t)),  a dt uniform in 0 ... age_jitter, new each sample:
    x, y += o(t),  o(t + dt) = jump g' with probability dt/jump_time, else o(t),
    psi += b(t),  b(t + dt) = f b(t) + heading_drift sqrt(1 - f^2) g',  f = exp(-dt/heading_time),
    beta = rear r/max(v, 1 m/s)  where `rear` is given,
    seen(t) = seen(t - dt)  with the probability `lost`, else all of this.

    The older truth is interpolated between samples; a position jumps when satellites are lost and found; the heading of
    an inertial unit wanders over minutes; and no car in series measures sideslip, so it is taken to be that of a rear
    axle that does not slide. By default all is off, and beta is what the sensors say.

    inputs: x_in, y_in [m], psi_in [rad], v_in [m/s], beta_in [rad], r_in [rad/s], the truth. outputs: x, y, psi, v,
    beta, r, seen; age [s] of these, as a receiver stamps it: the latency, a dt and, held, dt after dt more. state: the
    seven seen and the six true ones, the share a, whether this sample is lost, o (two), b, the generator's six numbers,
    the shares of the samples on their way, oldest first, then the wrapped sensors'. In a batch, car i draws as sensors
    of seed + i.
    errors: ValueError for parameters out of range.
    source: Nilsson 1998 (jitter); Misra, Enge 2011, ch. 5 and 7 (jumps of a position); Titterton, Weston 2004, ch. 12
    (drift of a heading); Rajamani 2012, eq. 2.12 (sideslip of a rolling car).
    """

    x_in = In("m")
    y_in = In("m")
    psi_in = In("rad")
    v_in = In("m/s")
    beta_in = In("rad")
    r_in = In("rad/s")
    x = Out("m")
    y = Out("m")
    psi = Out("rad")
    v = Out("m/s")
    beta = Out("rad")
    r = Out("rad/s")
    age = Out("s", direct=())

    block: Sensors
    """The sensors; their seed is this block's."""
    age_jitter: float = 0.0
    """Longest age beyond the sensors' latency [s], at most dt."""
    lost: float = 0.0
    """Share of samples that do not arrive [1]: the one before is held."""
    jump: Scalar = 0.0
    """Standard deviation of the offset that x and y have from jump to jump [m]."""
    jump_time: float = 20.0
    """Mean time between jumps [s]."""
    heading_drift: Scalar = 0.0
    """Standard deviation of the slow error of psi [rad]."""
    heading_time: float = 60.0
    """Its correlation time [s]."""
    rear: Scalar | None = None
    """Centre of gravity to rear axle [m], for the estimate of beta; None: beta is measured."""
    dt: float = DT

    def __post_init__(self) -> None:
        where = "DegradedSensors"
        require(self.dt == self.block.dt, where, f"dt = {self.dt} s, but its sensors have {self.block.dt} s")
        for name, unit, low, high, hint in (
            ("age_jitter", "s", 0.0, self.dt, "at most dt"),
            ("lost", "1", 0.0, 0.9, "a share"),
            ("jump", "m", 0.0, 10.0, ""),
            ("jump_time", "s", self.dt, 1e5, "at least dt"),
            ("heading_drift", "rad", 0.0, 1.0, "radians: radians_of(0.2)"),
            ("heading_time", "s", self.dt, 1e5, "at least dt"),
        ):
            require_within(where, name, getattr(self, name), unit, low, high, hint)
        if self.rear is not None:
            require_within(where, "rear", self.rear, "m", 0.02, 20.0)

    @classmethod
    def real(cls, vehicle: Vehicle, seed: int = 0, *, dt: float = DT) -> Self:
        """A production car with a good satellite receiver: `Sensors.real`, up to 20 ms of jitter, one sample in a
        hundred lost, jumps of 2 cm every 20 s, a heading that wanders by 0.2 degrees
        within minutes, sideslip unknown."""
        return cls(
            block=Sensors.real(seed, dt=dt),
            age_jitter=0.02,
            lost=0.01,
            jump=0.02,
            heading_drift=radians_of(0.2),
            rear=vehicle.l_r,
            dt=dt,
        )

    def scaled(self, size: float) -> Self:
        """The same with all errors but the age `size` times as large; `lost` too, up to a half."""
        inner = self.block
        names = ("position_noise", "position_drift", "psi_noise", "psi_drift", "v_noise", "beta_noise", "r_noise")
        return replace(
            self,
            block=replace(inner, **{name: size * getattr(inner, name) for name in names}),
            lost=min(0.5, size * self.lost),
            jump=size * self.jump,
            heading_drift=size * self.heading_drift,
        )

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero = m.filled(0.0, batch)
        g1, g2, random = normals(seed_state(self.block.seed, batch, stream=_STREAM))
        g3, _, random = normals(random)
        start = (self.jump * g1, self.jump * g2, self.heading_drift * g3)
        return (*(zero,) * 15, *start, *random, *(zero,) * self._waiting, *self.block.init(batch))

    def settle(self, t: float, x: State, u: Any) -> State:
        n = 24 + self._waiting
        inner = self.block.settle(t, tuple(x[n:]), self.block.D(*u))
        measured = self.block.output(t, inner, self.block.D(*u))
        return (*self._faulty(measured, x), *[truth + 0.0 for truth in u], *x[13:n], *inner)

    def output(self, t: Any, x: State, u: Any) -> Any:
        seen = self._faulty(self.block.output(t, tuple(x[24 + self._waiting :]), self.block.D(*_older(x, u))), x)
        held = (*x[:6], x[6] + self.dt)
        return self.Y(*[m.where(x[14] > 0.5, before, now) for now, before in zip(seen, held)])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        shares, inner = x[24 : 24 + self._waiting], tuple(x[24 + self._waiting :])
        older = _older(x, u)
        measured = self.block.output(t, inner, self.block.D(*older))
        inner = self.block.update(t, inner, self.block.U(*older), measured)
        o_x, o_y, b, *state = x[15:24]
        w_age, random = uniform(tuple(state))
        w_lost, random = uniform(random)
        w_jump, random = uniform(random)
        g1, g2, random = normals(random)
        g3, _, random = normals(random)
        jumps = w_jump < self.dt / self.jump_time
        o_x, o_y = (m.where(jumps, self.jump * g, before) for g, before in ((g1, o_x), (g2, o_y)))
        keep = math.exp(-self.dt / self.heading_time)
        b = keep * b + (1.0 - keep * keep) ** 0.5 * self.heading_drift * g3
        share, gone = w_age * (self.age_jitter / self.dt), m.where(w_lost < self.lost, 1.0, 0.0)
        older_shares = (*shares, x[13])[1:] if shares else ()
        return (*y, *[truth + 0.0 for truth in u], share, gone, o_x, o_y, b, *random, *older_shares, *inner)

    @cached_property
    def _waiting(self) -> int:
        """Samples on their way, whose shares have to be remembered for their stamps."""
        return whole_samples("DegradedSensors", "latency", self.block.latency, self.dt)

    def _faulty(self, measured: State, x: State) -> State:
        """What is seen of a sample that arrives, and its age, in this state."""
        px, py, psi, v, beta, r, age = measured
        if self.rear is not None:
            beta = self.rear * r / m.maximum(v, _SLOWEST)
        share = x[24] if self._waiting else x[13]
        return (px + x[15], py + x[16], psi + x[17], v, beta, r, age + share * self.dt)


def _older(x: State, u: Any) -> State:
    """The truth of a share of a sample ago."""
    return tuple([now + x[13] * (before - now) for now, before in zip(u, x[7:13])])
