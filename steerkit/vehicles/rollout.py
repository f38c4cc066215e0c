"""The roll-out of a car beside its path, under the commands on their way to its wheel: one for all that look ahead."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

from steerkit._support.errors import Checked, number, require
from steerkit.diagram import maths as m
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import A_Y_MAX, DT, JERK_MAX, STOP
from steerkit.vehicles import Vehicle, require_vehicle

SLOWEST = 0.5
"""Speed [m/s] below which bounds and poles that grow as the car slows down stay as they are."""


class Motion(NamedTuple):
    """Where a car is beside its path, and how it turns: e [m], psi_e [rad], r [rad/s], steering wheel [rad]."""

    e: Scalar
    psi_e: Scalar
    r: Scalar
    wheel: Scalar


@dataclass(frozen=True, kw_only=True)
class Rollout(Checked):
    """A car and its steering as they are believed, rolled forward beside a path; for predictors and safety filters.

        delta_sw' = (command(t - delay) - delta_sw)/lag  within +-fastest,  delta = delta_sw/steer_ratio,
        r' = (v tan(delta)/(L + K v^2) + wrong - r)/(yaw_time v),
        side = r (reference + l_r - rear_slip v^2),
        e' = v sin(psi_e) + side cos(psi_e),
        psi_e' = r - kappa (v cos(psi_e) - side sin(psi_e))/(1 - kappa e),  kappa from the preview:

    a rear axle that slides steadily, and a yaw rate that lags as that of the linear single track. `wrong` [rad/s] is by
    how much the car turns faster than this model. A piece of the way is one midpoint step, exact in lag and yaw.

    e, psi_e and preview [1/m] (kappa every preview_dt of driving) are those at `reference`; v >= 0 [m/s] stays as it
    is. For floats, batches and symbols. Raises ValueError for parameters out of range.
    Source: Rajamani 2012, sections 2.3 and 3.3.
    """

    delay: float = number(0.0, "s", low=0.0, high=2.0)
    """Pure delay from command to wheel [s]."""
    lag: float = number(0.0, "s", low=0.0, high=2.0)
    """First-order time constant of the wheel [s]."""
    rate_limit: Scalar = number(radians_of(550.0), "rad/s", above=0.0)
    """Fastest steering wheel [rad/s]."""
    slew: float | None = number(None, "m/s^3", above=0.0)
    """Fastest change of the lateral acceleration of a car that is steered by torque [m/s^3]; None: no bound."""
    a_y_limit: float = number(3.0, "m/s^2", above=0.0)
    """Its largest lateral acceleration [m/s^2]; not used without a slew."""
    wheelbase: Scalar = number(2.7, "m", above=0.0)
    """L [m]."""
    understeer: Scalar = 0.0
    """K, understeer gradient [rad s^2/m]."""
    l_r: Scalar = 1.5
    """Centre of gravity to rear axle [m]."""
    rear_slip: Scalar = 0.0
    """m l_f/(c_r L): rear slip angle over v r [rad s^2/m]."""
    yaw_time: Scalar = number(0.0033, "s^2/m", above=0.0)
    """i_z/(c_f l_f^2 + c_r l_r^2): lag of the yaw rate over v [s^2/m]."""
    steer_ratio: Scalar = number(15.6, "1", above=0.0)
    """Steering-wheel angle over road-wheel angle [1]."""
    reference: Scalar = 1.2
    """Where e, psi_e and the preview are measured: metres ahead of the centre of gravity."""
    dt: float = number(DT, "s", above=0.0)
    """Time between two commands [s]."""
    preview_dt: float = number(DT, "s", above=0.0)
    """Time between two entries of the preview [s]."""

    @classmethod
    def of(cls, vehicle: Vehicle, **settings: float | None) -> "Rollout":
        """With geometry, tyres and ratio of a `Vehicle`; settings: any other fields."""
        require_vehicle(vehicle, "Rollout.of")
        L = vehicle.wheelbase
        return cls(
            wheelbase=L,
            understeer=vehicle.understeer_gradient,
            l_r=vehicle.l_r,
            rear_slip=vehicle.m * vehicle.l_f / (vehicle.c_r * L),
            yaw_time=vehicle.i_z / (vehicle.c_f * vehicle.l_f**2 + vehicle.c_r * vehicle.l_r**2),
            steer_ratio=vehicle.steer_ratio,
            **settings,  # type: ignore[arg-type]
        )

    @property
    def lookahead(self) -> float:
        """How far ahead `arrived` looks at the most [s]: delay, lag and the time in which a slow wheel turns back."""
        return self.delay + self.lag + (0.0 if self.slew is None else 2.0 * self.a_y_limit / self.slew)

    @cached_property
    def waiting(self) -> int:
        """Commands on their way, of which the last is held: one at least."""
        return max(1, len(on_their_way(self.delay, self.dt)))

    @cached_property
    def pieces(self) -> tuple[tuple[float, int, float, float], ...]:
        """From now to delay + lag: one for each command on its way, then at most dt long ones under the last.

        Of each its length [s], which of the commands acts in it, when its middle is [s], and the share of the way to
        that command which the wheel's lag lets it go [1].
        """
        tail = math.ceil(self.lag / self.dt - 1e-9)
        spans = [*enumerate(on_their_way(self.delay, self.dt)), *[(self.waiting - 1, self.lag / max(tail, 1))] * tail]
        ends = [sum(h for _, h in spans[: i + 1]) for i in range(len(spans))]
        share = [lag_share(h, self.lag) for _, h in spans]
        return tuple([(h, i, end - 0.5 * h, part) for (i, h), end, part in zip(spans, ends, share)])

    def steady_wheel(self, kappa: Scalar, v: Scalar) -> Scalar:
        """The wheel [rad] with which the car goes round a bend of kappa [1/m]."""
        return self.steer_ratio * m.atan((self.wheelbase + self.understeer * v * v) * kappa)

    def wheel_after(self, wheel: Scalar, commands: Sequence[Scalar], v: Scalar) -> Scalar:
        """The wheel [rad] dt later, of which the oldest command acts at first and the one after it then."""
        first = self.pieces[0][0] if self.delay > 0.0 else 0.0
        for h, command in zip((first, self.dt - first), commands):
            wheel = wheel + lag_step(command - wheel, lag_share(h, self.lag), slewed(self, v) * h)
        return wheel

    def yaw_rate_after(self, r: Scalar, wheel: Scalar, v: Scalar, h: Scalar, wrong: Scalar = 0.0) -> Scalar:
        """The yaw rate [rad/s] h [s] after it was r, with this wheel [rad]."""
        steady = yaw_gain(v, self.wheelbase, self.understeer) * m.tan(wheel / self.steer_ratio) + wrong
        return steady + (r - steady) * m.exp(-1.0 / (self.yaw_time * m.maximum(v, SLOWEST)) * h)

    def moved(self, now: Motion, h: Scalar, turned: Scalar, kappa: Scalar, v: Scalar, wrong: Scalar) -> Motion:
        """The motion h [s] later, in which the wheel turns so far [rad], on a path of kappa [1/m]."""
        r = self.yaw_rate_after(now.r, now.wheel + 0.5 * turned, v, h, wrong)
        lever = self.reference + self.l_r - self.rear_slip * v * v
        return Motion(*beside(now.e, now.psi_e, h, v, 0.5 * (now.r + r), lever, kappa), r, now.wheel + turned)

    def kappa(self, preview: Sequence[Scalar], time: float) -> Scalar:
        """The path's curvature [1/m] where the car is in that time [s]; beyond the preview, its last."""
        place = time / self.preview_dt
        entry = int(place + 1e-9)
        if entry >= len(preview) - 1:
            return preview[-1]
        share, here = place - entry, preview[entry]
        return here + share * (preview[entry + 1] - here) if share > 0.0 else here

    def arrived(
        self, now: Motion, commands: Sequence[Scalar], preview: Sequence[Scalar], v: Scalar, wrong: Scalar
    ) -> tuple[Motion, Scalar]:
        """The motion when the next command has arrived and the lag has passed, and kappa [1/m] there.

        commands: `waiting` of them, oldest first. A car steered by torque turns its wheel slowly, so that more time
        passes until what was begun can be ended: with a `slew` it is rolled on until the wheel is back at the path's
        own angle, turned there as fast as the slew allows, for 2 a_y_limit/slew at most.
        """
        fastest = slewed(self, v)
        for h, command, middle, share in self.pieces:
            turned = lag_step(commands[command] - now.wheel, share, fastest * h)
            now = self.moved(now, h, turned, self.kappa(preview, middle), v, wrong)
        kappa = preview[min(round((self.delay + self.lag) / self.preview_dt), len(preview) - 1)]
        if self.slew is None:
            return now, kappa
        step, going = fastest * self.dt, 1.0
        for piece in range(math.ceil(2.0 * self.a_y_limit / self.slew / self.dt)):
            ahead = self.kappa(preview, self.delay + self.lag + (piece + 0.5) * self.dt)
            gap = self.steady_wheel(ahead, v) - now.wheel
            turned = going * m.clip(gap, -step, step)
            now = self.moved(now, m.absolute(turned) / fastest, turned, ahead, v, wrong)
            kappa = m.where(going > 0.5, ahead, kappa)
            going = m.where(m.absolute(gap) > step, going, 0.0)
        return now, kappa


def beside(
    e: Scalar, psi_e: Scalar, h: Scalar, v: Scalar, r: Scalar, lever: Scalar, kappa: Scalar
) -> tuple[Scalar, Scalar]:
    """e [m] and psi_e [rad] h [s] later, by the midpoint, of a car that rolls at v [m/s] and turns at r [rad/s].

    They are those of a point `lever` [m] ahead of the one that rolls without sliding, on a path of kappa [1/m].
    """
    side = r * lever
    e_dot, psi_dot = _rates(e, psi_e, v, r, side, kappa)
    e_dot, psi_dot = _rates(e + 0.5 * h * e_dot, psi_e + 0.5 * h * psi_dot, v, r, side, kappa)
    return e + h * e_dot, psi_e + h * psi_dot


def _rates(e: Scalar, psi_e: Scalar, v: Scalar, r: Scalar, side: Scalar, kappa: Scalar) -> tuple[Scalar, Scalar]:
    """e' [m/s] and psi_e' [rad/s] of a point that moves at v ahead and `side` to the left [m/s]."""
    c, s = m.cos(psi_e), m.sin(psi_e)
    return v * s + side * c, r - kappa * (v * c - side * s) / m.maximum(1.0 - kappa * e, 0.2)


def yaw_gain(v: Scalar, wheelbase: Scalar, understeer: Scalar) -> Scalar:
    """Steady yaw rate over tan(delta): v/(L + K v^2) [1/s]."""
    return v / turning_length(v, wheelbase, understeer)


def turning_length(v: Scalar, wheelbase: Scalar, understeer: Scalar) -> Scalar:
    """tan(delta) over curvature in steady cornering: L + K v^2 [m]."""
    return wheelbase + understeer * v * v


def lag_share(h: Scalar, lag: Scalar) -> Scalar:
    """Share of the way to its target that a first-order lag [s] goes in h [s]: 1 - exp(-h/lag), 1 without a lag."""
    return 1.0 - m.exp(-h / m.maximum(lag, 1e-12))


def lag_step(gap: Scalar, share: Scalar, most: Scalar) -> Scalar:
    """How far what lags behind gets: its share of the gap, at most so far to either side."""
    return m.clip(share * gap, -most, most)


def on_their_way(delay: float, dt: float) -> tuple[float, ...]:
    """For how long each command of a steering with this delay still acts before the next one arrives [s], oldest first.

    One is given every dt [s]; without a delay none is on its way.
    """
    n = math.ceil(delay / dt - 1e-9)
    return tuple([delay - (n - 1) * dt if i == 0 else dt for i in range(n)])


def slewed(car: Any, v: Scalar) -> Scalar:
    """Fastest wheel [rad/s] within rate_limit that a car steered by torque follows; slew None: it is steered by angle.

    Steady cornering needs delta = (L/v^2 + K) a_y, so a_y that changes by slew [m/s^3] turns the wheel by
    steer_ratio (L/v^2 + K) slew. car: anything with rate_limit, slew, wheelbase, understeer and steer_ratio.
    """
    if car.slew is None:
        return car.rate_limit
    v = m.maximum(v, SLOWEST)
    return m.minimum(car.rate_limit, car.slew * car.steer_ratio * (car.wheelbase / (v * v) + car.understeer))


@dataclass(frozen=True, kw_only=True)
class GateLimits:
    """What the gate before the bus lets through to the steering wheel; each limit is a bound that no request moves."""

    delta_sw_max: float = number(STOP, "rad", low=radians_of(5.0), high=STOP)
    """Largest |delta_sw| [rad]."""
    rate_max: float = number(radians_of(550.0), "rad/s", low=radians_of(10.0), high=radians_of(1000.0))
    """Fastest change of delta_sw [rad/s]."""
    rates: tuple[tuple[float, float], ...] = ()
    """Its fastest change by speed, of an interface that has such a table: (v [m/s], rate [rad/s]), a rate that falls
    ever more slowly as v grows; straight lines between, the ends' beyond."""
    a_y_max: float = number(A_Y_MAX, "m/s^2", low=0.2, high=5.0)
    """|kappa| <= a_y_max/v^2 [m/s^2]."""
    jerk_max: float = number(JERK_MAX, "m/s^3", low=0.2, high=10.0)
    """|dkappa/dt| <= jerk_max/v^2 [m/s^2 per s]."""
    v_floor: float = number(1.0, "m/s", low=0.5, high=5.0)
    """Slowest speed that the two bounds are computed for [m/s]."""
    v_max: float = number(12.0, "m/s", low=0.5, high=40.0)
    """Speed assumed when one of the sources is no number [m/s]."""
    steer_ratio: float = 15.6
    """Steering-wheel angle over road-wheel angle [1]."""
    wheelbase: float = 2.71
    """L [m]; kappa = tan(delta_sw/steer_ratio)/(L + K v^2)."""
    understeer: float = 0.0
    """K [rad s^2/m]; with 0 an understeering car does not reach kappa: pessimistic."""
    arm: float = 1.49
    """Centre of gravity to rear axle [m]: while kappa grows the centre is swung aside, which adds to a_y."""
    quantum: float = radians_of(0.1)
    """Resolution of the angle on the bus [rad]."""
    dt_min: float = number(0.01, "s", low=0.004, high=0.02)
    """Shortest time between two frames [s]: the cap on the message rate."""
    dt_max: float = number(0.06, "s", low=0.02, high=0.1)
    """Longest time that a change may be spread over [s]: a pause earns no jump."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__.keys() - {"rates", "understeer"}:
            value = getattr(self, name)
            require(0.0 < value < math.inf, "GateLimits", f"{name} = {value}, expected a finite number > 0")
        turns = math.isfinite(self.understeer) and self.length(self.v_max) > 0.1 * self.wheelbase
        require(turns, "GateLimits", f"understeer = {self.understeer}, expected L + K v_max^2 of a tenth of L or more")
        ok = self.delta_sw_max / self.steer_ratio < 1.4 and self.dt_min <= self.dt_max and self.v_floor <= self.v_max
        require(ok, "GateLimits", "expected delta_sw_max/steer_ratio < 1.4 rad, dt_min <= dt_max, v_floor <= v_max")
        slopes = [(b[1] - a[1]) / (b[0] - a[0]) if b[0] > a[0] else math.inf for a, b in pairwise(self.rates)]
        falling = sorted(slopes) == slopes and all(slope <= 0.0 for slope in slopes)
        positive = all(0.0 < rate < math.inf for _, rate in self.rates)
        require(
            falling and positive,
            "GateLimits",
            f"rates = {self.rates}, expected speeds that grow and rates > 0 that fall ever more slowly",
        )

    def length(self, v: Scalar) -> Scalar:
        """See `turning_length` [m]."""
        return turning_length(v, self.wheelbase, self.understeer)

    def rate(self, v: Scalar) -> Scalar:
        """The fastest change of delta_sw at this speed [rad/s]: the largest of the table's lines, within its ends."""
        if not self.rates:
            return self.rate_max
        (slowest, most), (fastest, least) = self.rates[0], self.rates[-1]
        v, allowed = m.clip(v, slowest, fastest), least
        for (v_0, rate_0), (v_1, rate_1) in pairwise(self.rates):
            allowed = m.maximum(allowed, rate_0 + (rate_1 - rate_0) / (v_1 - v_0) * (v - v_0))
        return m.minimum(m.minimum(allowed, most), self.rate_max)


@dataclass(frozen=True, kw_only=True)
class GateModel(Checked):
    """How far a gate before the bus lets the wheel turn in a sample, at the most and at the least; for roll-outs.

    A gate bounds the angle, its rate, and what the car would feel: kappa = tan(delta_sw/steer_ratio)/(L + K v^2) within
    a_y_max/v^2, |dkappa/dt| <= jerk_max/v^2, and while |kappa| grows |v^2 kappa + v arm dkappa/dt| <= a_y_max. It works
    frame by frame and rounds each frame, at a speed that it knows a little differently. `pushed` is the command that it
    lets through within a sample, as far to the left as it may be; the mirror image of it as far to the right.

        to the left    turn = jerk_max/v^2,   share = 1 - exp(-v h/arm),   h = dt (and a frame, for the first sample)
        to the right   turn = jerk_max/w^2 - lost,   share = 1/(1 + arm/(w dt)),   w = v + v_doubt
        lost           quantum/(frame_dt steer_ratio L), what rounding may cost, with 1 + (L kappa)^2
        kappa          within -turn dt and turn h of where it was, and by `share` of what is left to +-a_y_max/v^2

    The shares are those of frames that are infinitely short, and as long as a sample: those of the gate lie between. A
    last frame that is not due yet is left to a doubt of the delay. NaN in any input gives NaN.
    Raises ValueError for values out of range. Source: the bounds are those of the gate.
    """

    limits: GateLimits = field(default_factory=GateLimits)
    """Those of the gate, and the car's geometry and ratio."""
    v_doubt: float = number(0.2, "m/s", low=0.0, high=10.0)
    """By how much faster than believed the gate may take the car to be [m/s]: the faster of two sources counts."""
    frame_dt: float = number(0.02, "s", low=1e-3, high=1.0)
    """Time between two frames [s]."""

    @property
    def turning(self) -> float:
        """Time from the bound on a_y on one side to that on the other [s]."""
        return 2.0 * self.limits.a_y_max / self.limits.jerk_max

    def pushed(self, command: Scalar, before: Scalar, v: Scalar, dt: float, early: float = 0.0) -> Scalar:
        """The command [rad] that is sent in the end a sample after `before`, as far to the left as that may be.

        v [m/s]; early [s]: by how much sooner than the sample before the first frame may have been due.
        """
        gate, ratio, length = self.limits, self.limits.steer_ratio, self.limits.length(v)
        fast, slow = m.maximum(v, gate.v_floor), m.maximum(v + self.v_doubt, gate.v_floor)
        bent = m.tan(before / ratio)
        kappa, most, least = bent / length, gate.a_y_max / (fast * fast), gate.a_y_max / (slow * slow)
        rounding = gate.quantum * (1.0 + bent * bent) / (ratio * length)
        h, frames = dt + early, dt / self.frame_dt
        growth = (1.0 - m.exp(-fast * h / gate.arm)) * (most - kappa)
        left = kappa + m.minimum(gate.jerk_max / (fast * fast) * h, m.maximum(growth, (frames + 1.0) * rounding))
        back = m.maximum(gate.jerk_max / (slow * slow) * dt - frames * rounding, 0.0)
        swing = (kappa + least) / (1.0 + gate.arm / (slow * dt)) - frames * rounding
        right = kappa - m.minimum(back, m.maximum(swing, 0.0))
        low = m.maximum(before - gate.rate(slow) * dt, ratio * m.atan(length * right))
        high = m.minimum(before + gate.rate(fast) * h, ratio * m.atan(length * left))
        bound = m.minimum(ratio * m.atan(length * most), gate.delta_sw_max)
        tight = m.minimum(ratio * m.atan(length * least), gate.delta_sw_max)
        turned = m.clip(command, -tight, bound) - before + 0.0 * v  # a NaN in any of them stays
        return before + m.clip(turned, low - before, high - before)
