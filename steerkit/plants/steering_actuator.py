"""The steering between controller and road wheels: the way of a command, the motor, a worn column."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.errors import number, require, whole_samples
from steerkit._support.random import seed_state, uniform
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import DT, STOP
from steerkit.vehicles.file import table_of, text_of
from steerkit.vehicles.rollout import lag_share, lag_step


@dataclass(frozen=True, eq=False, kw_only=True)
class Steering(Block):
    """What turns the steering wheel on a command, late and within bounds; abstract. It starts straight and at rest.

    Parameters except delay and dt may be `(N,)` arrays in a batch. errors: ValueError for parameters out of range, or a
    delay that is no multiple of dt.
    """

    delta_sw_cmd = In("rad", direct=False)
    delta_sw = Out("rad", direct=())
    rate = Out("rad/s", direct=())

    limit: Scalar = number(STOP, "rad", low=1e-3, high=30.0)
    """Largest |delta_sw| [rad]."""
    rate_limit: Scalar = number(radians_of(550.0), "rad/s", low=1e-3, high=200.0)
    """Largest |rate| [rad/s]."""
    lag: Scalar = number(0.1, "s", low=0.0, high=10.0)
    """First-order time constant of what the command sets [s]; 0 for none."""
    delay: float = 0.0
    """Pure delay [s], a multiple of dt."""
    gain: Scalar = number(1.0, "1", low=0.1, high=10.0)
    """What is reached over what was commanded [1]."""
    offset: Scalar = number(0.0, "rad", low=-3.0, high=3.0)
    """Offset [rad] of the angle reached."""
    dt: float = number(0.01, "s", above=0.0, high=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.waiting

    @cached_property
    def waiting(self) -> int:
        """Commands on their way."""
        return whole_samples(type(self).__name__, "delay", self.delay, self.dt)

    @cached_property
    def _follow(self) -> Scalar:
        return lag_share(self.dt, self.lag)


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringActuator(Steering):
    """A steering-wheel motor with pure delay, stops, first-order lag and rate limit, and a ratio error if wanted.

    target(t) = sat(gain*delta_sw_cmd(t - delay) + offset),  sat to +-limit,
    rate(t + dt) = sat((1 - exp(-dt/lag)) (target(t) - delta_sw(t))/dt),  sat to +-rate_limit,
    delta_sw(t + dt) = delta_sw(t) + dt*rate(t + dt):

    the exact answer of lag*delta_sw' = target - delta_sw to a command held for dt, unless the rate limit acts.

    input: delta_sw_cmd [rad], acts from its sample to the next. outputs, of state only: delta_sw [rad], the angle
    at the wheel; rate [rad/s], its mean speed over the last sample. state: delta_sw, rate, then the delay/dt
    commands on their way, oldest first. A NaN command gives NaN from when it arrives, for good: the wheel's angle is
    unknown. An infinite one goes to the stop.
    """

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),) * (2 + self.waiting)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0], x[1])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        delta_sw, _, *pending = x
        pending.append(u.delta_sw_cmd)
        target = m.clip(self.gain * pending[0] + self.offset, -self.limit, self.limit)
        step = lag_step(target - delta_sw, self._follow, self.rate_limit * self.dt)
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
    for key in ("delay", "lag", "offset"):
        require(isinstance(table.get(key), (int, float)), where, f"[steering] {key}, expected a number")
    rest = table["delay"] - dt
    whole = round(max(0, math.floor(rest / dt + 1e-6)) * dt, 6)
    lag = max(0.0, table["lag"] + rest - whole)
    return SteeringActuator(delay=whole, lag=lag, offset=table["offset"], dt=dt, **others)


_STREAM = 12  # of `seed_state`: the link's delays


@dataclass(frozen=True, eq=False, kw_only=True)
class SteeringLink(Block):
    """The way of a steering command to the motor, for a loop in which this way is not perfect.

    sent(t) = quantum floor(delta_sw_cmd(t)/quantum + 1/2),
    arrived(t) = sent(t - a(t)),  a(t + dt) = min(a(t) + dt, d),  d new every 50 ms, uniform in 0 ... jitter,
    delta_sw(t) = arrived(t)  where it is more than dead_band from delta_sw(t - dt), else delta_sw(t - dt):

    the bus carries whole quanta; each command takes a time of its own, and none overtakes another; the motor's
    controller leaves a change that is smaller than its dead band. By default all is off: delta_sw = delta_sw_cmd.

    input: delta_sw_cmd [rad]. output: delta_sw [rad], the motor's command, in the same sample. state: delta_sw one
    sample before; with jitter also a and d in samples, the samples since d was drawn, the generator's six numbers and
    the jitter/dt commands before this one, oldest first. A NaN arrives as NaN. In a batch, car i draws as a link of
    seed + i does; quantum and dead_band may be `(N,)` arrays. errors: ValueError for parameters out of range, or a
    jitter that is no multiple of dt.
    source: Widrow, Kollar 2008 (quantiser); Nilsson 1998, ch. 3 (random delays in control loops, new each sample);
    Miskowicz 2006 (send on delta).
    """

    delta_sw_cmd = In("rad")
    delta_sw = Out("rad")

    quantum: Scalar = number(0.0, "rad", low=0.0, high=1.0)
    """Resolution of a command [rad]; 0: exact."""
    dead_band: Scalar = number(0.0, "rad", low=0.0, high=1.0)
    """Change of a command that the motor's controller leaves [rad]."""
    jitter: float = 0.0
    """Longest time that a command takes beyond the shortest [s], a multiple of dt."""
    seed: int = 0
    """Seed of the random delays."""
    dt: float = number(0.01, "s", above=0.0, high=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        whole_samples("SteeringLink", "jitter", self.jitter, self.dt)
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
        due = since + 1.5 > DT / self.dt
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

    friction: Scalar = number(0.0, "rad", low=0.0, high=1.0)
    """Twist of the shaft that the friction holds, to either side [rad]."""
    play: Scalar = number(0.0, "rad", low=0.0, high=1.0)
    """Free play, from end to end [rad]."""
    zero: Scalar = number(0.0, "rad", low=-1.0, high=1.0)
    """What the sensor at the steering wheel shows while that is straight [rad]."""
    dt: float = number(0.01, "s", above=0.0, high=1.0)

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
