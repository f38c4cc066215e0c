"""The steering between controller and road wheels: the way of a command, the motor or a torque, a worn column."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.errors import number, require, whole_samples
from steerkit._support.files import read_text
from steerkit._support.random import seed_state, uniform
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import DT, STOP
from steerkit.vehicles import Vehicle, table_of
from steerkit.vehicles.rollout import lag_share, lag_step

_SLOWEST = 1.0  # m/s: below, a wheel steered by torque turns as at this speed


@dataclass(frozen=True, eq=False, kw_only=True)
class DelayedSteering(Block):
    """What turns the steering wheel on a command, late and within bounds; abstract. It starts straight and at rest.

    Parameters except delay and dt may be `(N,)` arrays in a batch. errors: ValueError for a delay not a multiple of dt.
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
class SteeringActuator(DelayedSteering):
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


@dataclass(frozen=True, eq=False, kw_only=True)
class TorqueSteering(DelayedSteering):
    """A car steered through the torque of its lane keeping, as most cars in series are, for the place of the motor.

    Its interface takes no angle, and what it does to the car is best said of the lateral acceleration: that follows
    the command after a dead time, within a slew and a limit. A commanded angle is what a known car turns into it:

    C(v) = (L + K v^2)/v^2,  wanted(t) = tan(delta_sw_cmd(t)/steer_ratio)/C(v),
    a(t + dt) = a(t) + sat((1 - exp(-dt/lag)) (sat(wanted(t - delay)) - a(t))),  sat to +-slew dt and +-a_y_limit,
    target(t) = sat(steer_ratio atan(C(v) gain a(t + dt)) + offset),  sat to +-limit,
    delta_sw(t + dt) = delta_sw(t) + sat(target(t) - delta_sw(t)),  sat to +-rate_limit dt,

    v not below 1 m/s. While neither slew nor limit act, delta_sw(t) is gain delta_sw_cmd(t - delay - dt) + offset, but
    for the change of speed on the way.

    inputs: delta_sw_cmd [rad] and v [m/s], which act from their sample to the next. outputs, of state only: delta_sw
    [rad], the angle at the wheel; rate [rad/s], its mean speed over the last sample. state: delta_sw, rate, a, then the
    delay/dt wanted accelerations on their way, oldest first. NaN in an input gives NaN for good.
    source: Rajamani 2012, section 3.3 (steady cornering). Dead time, slew and limit of one car as its simulator,
    learned from drives, has them: 0.35 s, 5 m/s^3, 3 m/s^2; the last two are also the bounds of ISO 11270.
    """

    v = In("m/s", direct=False)

    delay: float = 0.35
    """Dead time [s], a multiple of dt."""
    lag: Scalar = number(0.0, "s", low=0.0, high=10.0)
    """First-order time constant of the acceleration [s]; 0 for none."""
    slew: Scalar = number(5.0, "m/s^3", low=1e-3, high=1e4)
    """Fastest change of the acceleration [m/s^3]."""
    a_y_limit: Scalar = number(3.0, "m/s^2", low=1e-3, high=1e3)
    """Largest |acceleration| [m/s^2], before the gain."""
    steer_ratio: Scalar = number(15.6, "1", low=1.0, high=50.0)
    """Steering-wheel angle over road-wheel angle of the car that commands are meant for [1]."""
    wheelbase: Scalar = number(2.71, "m", low=0.04, high=40.0)
    """L of that car [m]."""
    understeer: Scalar = number(0.0, "rad s^2/m", low=-1e-3, high=1.0)
    """Understeer gradient of that car, K [rad s^2/m]."""

    @classmethod
    def of(cls, vehicle: Vehicle, **settings: Any) -> "TorqueSteering":
        """For the geometry, tyres, ratio and stop of the car that the commands are meant for; settings: any fields."""
        known: dict[str, Any] = dict(
            steer_ratio=vehicle.steer_ratio,
            wheelbase=vehicle.wheelbase,
            understeer=vehicle.understeer_gradient,
            limit=vehicle.delta_sw_max,
        )
        return cls(**(known | settings))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),) * (3 + self.waiting)

    def holding(self, delta_sw: Scalar, v: Scalar) -> State:
        """The state of a car that has been turning with this angle [rad] at this speed [m/s] for long."""
        a = m.tan(delta_sw / self.steer_ratio) / self._per_a(v)
        return (delta_sw, 0.0 * delta_sw, a, *(a,) * self.waiting)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0], x[1])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        delta_sw, _, a, *pending = x
        per_a = self._per_a(u.v)
        pending.append(m.tan(m.clip(u.delta_sw_cmd, -self.limit, self.limit) / self.steer_ratio) / per_a)
        wanted = m.clip(pending[0], -self.a_y_limit, self.a_y_limit)
        a = a + lag_step(wanted - a, self._follow, self.slew * self.dt)
        target = self.steer_ratio * m.atan(per_a * self.gain * a) + self.offset
        step = lag_step(m.clip(target, -self.limit, self.limit) - delta_sw, 1.0, self.rate_limit * self.dt)
        return (delta_sw + step, step / self.dt, a, *pending[1:])

    def _per_a(self, v: Scalar) -> Scalar:
        """C(v): tan of the road-wheel angle over the lateral acceleration [s^2/m]."""
        fast = m.maximum(v, _SLOWEST)
        return self.wheelbase / (fast * fast) + self.understeer


def steering_of(file: str | FilePath, *, text: str | None = None, dt: float = 0.01, **others: Any) -> SteeringActuator:
    """The steering of a vehicle file, as an actuator of sample time dt [s]: delay, lag, offset.

    Their sum is kept, less dt: that is what the sampled actuator and car add by holding their inputs. The delay is cut
    down to a multiple of dt, 0 at least, and the rest is the lag's. text: what stands in the file, if it is known.
    others: more fields of `SteeringActuator`. Raises ValueError for a broken file.
    """
    where = f"{file}"
    table = table_of(read_text(file, "vehicle") if text is None else text, "steering", where)
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
    seed + i does; quantum and dead_band may be `(N,)` arrays. errors: ValueError for a jitter that is no multiple of
    dt. source: Widrow, Kollar 2008 (quantiser); Nilsson 1998, ch. 3 (random delays in control loops, new each sample);
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
    middle of its gaps. A NaN stays NaN. Parameters may be `(N,)` arrays in a batch. source: Nordin, Gutman 2002
    (backlash); Visintin 1994, ch. III (play operator; Coulomb friction with a spring is its stop); Pfeffer, Harrer,
    Johnston 2008 (friction and elasticity of steering).
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
