"""The motor at the steering wheel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.errors import require, require_within, whole_samples
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import STOP
from steerkit.vehicles.file import table_of, text_of


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringActuator(Block):
    """A steering-wheel motor with pure delay, stops, first-order lag and rate limit, and a ratio error if wanted.

    target(t) = sat(gain*delta_sw_cmd(t - delay) + offset),  sat to +-limit,
    rate(t + dt) = sat((1 - exp(-dt/lag)) (target(t) - delta_sw(t))/dt),  sat to +-rate_limit,
    delta_sw(t + dt) = delta_sw(t) + dt*rate(t + dt):

    the exact answer of lag*delta_sw' = target - delta_sw to a command held for dt, unless the rate limit acts.

    input: delta_sw_cmd [rad], acts from its sample to the next. outputs, of state only: delta_sw [rad], the angle
    at the wheel; rate [rad/s], its mean speed over the last sample. state: delta_sw, rate, then the delay/dt
    commands on their way, oldest first. It starts straight and at rest.
    A NaN command gives NaN from when it arrives, for good: the wheel's angle is unknown, and whoever commands is
    responsible. An infinite one goes to the stop. Parameters except delay and dt may be `(N,)` arrays in a batch.
    errors: ValueError for parameters out of range, or a delay that is no multiple of dt.
    """

    delta_sw_cmd = In("rad", direct=False)
    delta_sw = Out("rad", direct=())
    rate = Out("rad/s", direct=())

    limit: Scalar = STOP
    """Largest |delta_sw| [rad]."""
    rate_limit: Scalar = radians_of(550.0)
    """Largest |rate| [rad/s]."""
    lag: Scalar = 0.1
    """First-order time constant [s]; 0 for none."""
    delay: float = 0.0
    """Pure delay [s], a multiple of dt."""
    gain: Scalar = 1.0
    """Ratio error [1]: angle reached over angle commanded."""
    offset: Scalar = 0.0
    """Offset [rad] of the angle reached."""
    dt: float = 0.01

    def __post_init__(self) -> None:
        where = "SteeringActuator"
        require_within(where, "dt", self.dt, "s", 1e-6, 1.0)
        require_within(where, "limit", self.limit, "rad", 1e-3, 30.0, "radians: radians_of(520)")
        require_within(where, "rate_limit", self.rate_limit, "rad/s", 1e-3, 200.0, "radians: radians_of(550)")
        require_within(where, "lag", self.lag, "s", 0.0, 10.0)
        require_within(where, "gain", self.gain, "1", 0.1, 10.0, "1 is no error")
        require_within(where, "offset", self.offset, "rad", -3.0, 3.0, "radians: radians_of(5)")
        whole_samples(where, "delay", self.delay, self.dt)

    @cached_property
    def _follow(self) -> Scalar:
        """Share of the way to the target that the lag leaves to one sample: 1 - exp(-dt/lag)."""
        return 1.0 - m.exp(-self.dt / m.maximum(self.lag, 1e-9 * self.dt))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),) * (2 + whole_samples("SteeringActuator", "delay", self.delay, self.dt))

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0], x[1])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        delta_sw, _, *pending = x
        pending.append(u.delta_sw_cmd)
        target = m.clip(self.gain * pending[0] + self.offset, -self.limit, self.limit)
        largest_step = self.rate_limit * self.dt
        step = m.clip(self._follow * (target - delta_sw), -largest_step, largest_step)
        return (delta_sw + step, step / self.dt, *pending[1:])


def steering_of(file: str | FilePath, *, dt: float = 0.01, **others: Any) -> SteeringActuator:
    """The steering of a vehicle file, as an actuator of sample time dt [s]: delay, lag, offset.

    Their sum is kept, less dt: that is what the sampled actuator and car add by holding their inputs. The delay is cut
    down to a multiple of dt, 0 at least, and the rest is the lag's. others: more fields of `SteeringActuator`. Raises
    ValueError for a broken file.
    """
    return steering_in(text_of(file), f"{file}", dt=dt, **others)


def steering_in(text: str, where: str, *, dt: float = 0.01, **others: Any) -> SteeringActuator:
    """The same from the text of a vehicle file; `where` is what errors call it."""
    table = table_of(text, "steering", where)
    numbers = {}
    for key in ("delay", "lag", "offset"):
        require(isinstance(table.get(key), (int, float)), where, f"[steering] {key}, expected a number")
        numbers[key] = float(table[key])
    delay = numbers["delay"] - dt
    samples = max(0, math.floor(delay / dt + 1e-6))
    lag = max(0.0, numbers["lag"] + delay - samples * dt)
    return SteeringActuator(delay=samples * dt, lag=lag, offset=numbers["offset"], dt=dt, **others)
