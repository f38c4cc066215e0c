"""A controller that follows the dead time and the steering ratio which estimators find while it drives."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from steerkit._support.errors import number, require, require_within
from steerkit.controllers.offset_free import OffsetFree
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, State, entries_of, require_ports, take_ports, without_port
from steerkit.diagram.maths import Scalar
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import YawDelay
from steerkit.task import STOP

_EVERY = 5.0
"""Samples after which the estimate of the dead time is read again: its fits take longer than all the rest."""
_OWN_COMMAND = 0.01
"""Up to so far from its own command of a sample before, the angle commanded then was its own [rad]."""


class _Own(NamedTuple):
    """The last entries of the state."""

    delay_lag: Scalar
    """Dead time and lag as last read [s]; its deviation [s]; was it valid?"""
    deviation: Scalar
    valid: Scalar
    since: Scalar
    """Samples since then."""
    asked: Scalar
    """Its own command of a sample before [rad]."""
    standby: Scalar
    """Did another controller steer?"""
    delay: Scalar
    """What is believed: dead time [s] ..."""
    ratio: Scalar
    """... and ratio over the data sheet's [1]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Adaptive(Block):
    """Wraps a controller of any kind so that it adapts to its car while it drives; for cars that nobody has measured.

    Two estimators watch its commands and the gyro: `YawDelay` and `SingleTrackFilter`. With the believed dead time d
    and the believed ratio, as a multiple g of the data sheet's,

        delta_sw = sat(g w),   w = (1 - a) w_i(wheel/g) + a w_j(wheel/g),   d = (1 - a) d_i + a d_j,   j = i + 1,

    where w_i is what the controller designed for the dead time d_i commands: tables are not solved anew, but those of
    two dead times are mixed. Both begin with the prior (d = prior_delay, g = 1) and move towards their estimates, at a
    limited rate, only while these are valid, and within bounds; else they stay. The filter gets the estimated dead
    time, with its deviation, not the believed one: a dead time that is wrong or late would be taken for another ratio.
    It pauses, as `delay` does, where the commanded angle jumps faster than wheels turn. It gets g n tan(delta)
    cos(beta) instead of g n delta, n the data sheet's ratio, tan(beta) = tan(delta) l_r/L: tight bends. An offset is
    not estimated: without a heading it cannot be separated from the gyro's zero. `OffsetFree` steers against it, inside
    this block, since the estimators need the command as it is sent.

    Ports and sample time are those of `blocks`, the inputs v and r among them; the preview is the longest. With
    `takes_turns` there is one input more, doe [rad]: the angle commanded a sample before, by whichever controller
    steered. State: those of `blocks`, of `delay` and `steering`, then `_Own`. While another controller steers, integral
    action of `blocks` keeps what it has. In a drive of one car only the two controllers that are mixed are evaluated.
    Samples with NaN in v, r or doe update no estimate, nor do samples on standby: see `on_standby`. Raises ValueError
    for controllers with other ports. Source: Astrom, Wittenmark 1995, sections 1.4 (gain scheduling) and 3.1 (certainty
    equivalence: estimates are used as if they were true).
    """

    doe = In("rad", direct=False)

    blocks: tuple[Block, ...]
    """The same controller, made for each of `delays`."""
    delays: tuple[float, ...]
    """Dead times [s], evenly spaced, from the shortest to the longest that can be believed."""
    delay: YawDelay
    """Estimates the dead time, for a given lag."""
    steering: SingleTrackFilter
    """Estimates the ratio."""
    prior_delay: float = 0.0
    """Dead time believed until there is an estimate [s]; too long a one does less harm than too short a one."""
    lag: float = number(0.1, "s", low=0.0, high=10.0)
    """Lag of the steering for which `blocks` are designed [s]; what it is longer counts as dead time."""
    ratio_least: float = number(0.6, "1", low=0.1, high=1.0)
    """Smallest believed ratio, as a multiple of the data sheet's [1]."""
    ratio_most: float = number(1.6, "1", low=1.0, high=10.0)
    """Largest [1]."""
    delay_rate: float = number(0.5, "s/s", low=0.0, high=10.0)
    """Fastest change of the believed dead time [s/s]."""
    delay_sure: float = number(10.0, "s", low=1e-4, high=10.0)
    """Deviation of its estimate up to which it falls as fast [s]; else with the square of this over the deviation, as
    too short a dead time makes a fast law swing, and what is estimated then is no better."""
    ratio_rate: float = number(0.1, "1/s", low=0.0, high=10.0)
    """That of the ratio [1/s]."""
    limit: float = number(STOP, "rad", low=1e-3, high=30.0)
    """Largest |delta_sw| [rad]."""
    takes_turns: bool = False
    """Does another controller steer now and then, as beside a recovery controller? Then doe is what was commanded."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where, n = "Adaptive", len(self.delays)
        require(
            len(self.blocks) == n and n >= 2, where, f"{len(self.blocks)} blocks for {n} delays, expected 2 or more"
        )
        step = self.delays[1] - self.delays[0]
        even = all(abs(b - a - step) < 1e-9 for a, b in zip(self.delays, self.delays[1:]))
        require(step > 0.0 and even, where, f"delays = {self.delays} [s], expected growing by the same step")
        ports = [{port.name: port.unit for port in (*block.inputs, *block.outputs)} for block in self.blocks]
        require(all(one == ports[0] for one in ports), where, "blocks have different ports, expected the same")
        require_ports(where, self.block, inputs=("v", "r"), outputs=("delta_sw",))
        require_within(where, "prior_delay", self.prior_delay, "s", self.delays[0], self.delays[-1])
        take_ports(self, self.block)
        if not self.takes_turns:
            without_port(self, "doe")

    @property
    def block(self) -> Block:
        """The controller made for the longest dead time: it looks furthest ahead."""
        return self.blocks[-1]

    @cached_property
    def _parts(self) -> tuple[tuple[Any, int, int], ...]:
        """What makes a block's state from its entries, and where in the state these are."""
        parts, first = [], 0
        for block in (*self.blocks, self.delay, self.steering):
            make, count = entries_of(block)
            parts.append((make, first, first + count))
            first += count
        return tuple(parts)

    def _states(self, x: State) -> list[State]:
        return [make(x[first:end]) for make, first, end in self._parts]

    def init(self, batch: tuple[int, ...] = ()) -> State:
        inner = [value for block in (*self.blocks, self.delay, self.steering) for value in block.init(batch)]
        own = _Own(0.0, 0.0, 0.0, since=_EVERY, asked=0.0, standby=0.0, delay=self.prior_delay, ratio=1.0)
        return (*inner, *[m.filled(value, batch) for value in own])

    def believed(self, x: State) -> tuple[Scalar, Scalar]:
        """Dead time [s] and steering ratio over the data sheet's [1] that it believes in state `x`."""
        own = _own(x)
        return own.delay, own.ratio

    def on_standby(self, x: State, settled: State) -> State:
        """The state `settled` with the estimates and beliefs of `x`, for a sample in which another controller steered.

        The next sample updates no estimate, nor do those after it until its own commands have acted. Estimates that
        are not finite are not kept. For one car.
        """
        first = self._parts[len(self.blocks)][1]
        kept = x[first:] if all(map(math.isfinite, x[first:])) else settled[first:]
        return (*settled[:first], *kept[: -len(_Own._fields)], *_own(kept)._replace(standby=1.0))

    def _read(self, t: Any, own: _Own, state: State) -> _Own:
        """`own` with what `delay` says of dead time and lag, where that is due."""
        due = own.since >= _EVERY
        if due is not False:
            y = self.delay.output(t, state, ())
            read = own._replace(
                delay_lag=y.delay_lag, deviation=y.delay_lag_deviation, valid=y.delay_lag_valid, since=0.0
            )
            own = _Own(*[m.where(due, now, old) for now, old in zip(read, own)])
        return own._replace(since=own.since + 1.0)

    def settle(self, t: float, x: State, u: Any) -> State:
        states = self._states(x)
        settled = [
            value
            for block, state in zip(self.blocks, states)
            for value in block.settle(t, state, self._seen(block, block.D, u, _own(x).ratio))
        ]
        return (*settled, *x[len(settled) :])

    def output(self, t: Any, x: State, u: Any) -> Any:
        delay, ratio = self.believed(x)
        place = (delay - self.delays[0]) / (self.delays[1] - self.delays[0])
        states, asked, nearest = self._states(x), 0.0, None
        for i, block in enumerate(self.blocks):
            share = m.clip(1.0 - m.absolute(place - i), 0.0, 1.0)
            if type(share) is float and share == 0.0:  # one car: the others need not be asked
                continue
            y = block.output(t, states[i], self._seen(block, block.D, u, ratio))
            asked = asked + share * y.delta_sw
            if nearest is not None:  # all other outputs are those of the one with the larger share
                pick, pairs = share > 0.5, zip(y, nearest)
                y = type(y)(*[m.chosen(pick, a, b) if isinstance(a, tuple) else m.where(pick, a, b) for a, b in pairs])
            nearest = y
        command = m.clip(ratio * asked, -self.limit, self.limit)
        return nearest._replace(delta_sw=command)  # type: ignore[union-attr]

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        states = self._states(x)
        own = self._read(t, _own(x), states[-2])
        standby, ratio = own.standby, own.ratio
        sheet = y._replace(delta_sw=y.delta_sw / ratio)
        sent = u.doe if self.takes_turns else y.delta_sw
        steers, after = m.absolute(sent - own.asked) <= _OWN_COMMAND, list[State]()
        for block, state in zip(self.blocks, states):
            new = block.update(t, state, self._seen(block, block.U, u, ratio), sheet)
            if self.takes_turns and isinstance(block, OffsetFree):
                new = block.kept(state, new, steers)
            after.append(new)
        known = self.steering.output(t, states[-1], ())
        after.append(self.delay.update(t, states[-2], self.delay.U(sent, 1.0 - standby, u.r, u.v), ()))
        car = self.steering.vehicle
        n = ratio * car.steer_ratio
        steep = m.tan(sent / n)
        lever = car.l_r / car.wheelbase * steep  # tan(beta): v is that of the centre of gravity
        bent = n * steep / m.sqrt(1.0 + lever * lever)
        dead, late = own.delay_lag - self.lag, self.dt if self.takes_turns else 0.0
        step = m.absolute(bent - states[-1][0])  # the filter's state begins with the angle of a sample before
        followed = m.where(m.both(step <= self.delay.rate_limit * self.dt, standby < 0.5), 1.0, 0.0)
        watched = self.steering.U(bent, u.v, u.r, math.nan, dead, self.lag, own.deviation, followed)
        after.append(self.steering.update(t, states[-1], watched, known))
        bounds, ratios = (self.delays[0], self.delays[-1]), (self.ratio_least, self.ratio_most)
        doubt = m.maximum(own.deviation / self.delay_sure, 1.0)
        rates = self.delay_rate / (doubt * doubt), self.delay_rate
        own = own._replace(
            asked=y.delta_sw,
            standby=0.0 * standby,
            delay=self._followed(own.delay, dead + late, own.valid, rates, bounds),
            ratio=self._followed(ratio, known.ratio, known.ratio_valid, (self.ratio_rate,) * 2, ratios),
        )
        return (*[value for state in after for value in state], *own)

    def _followed(
        self, before: Scalar, value: Scalar, valid: Scalar, rates: tuple[Scalar, float], bounds: tuple[float, float]
    ) -> Scalar:
        """What is believed a sample later; rates: the fastest of its fall and of its growth."""
        step = m.clip(m.clip(value, *bounds) - before, -rates[0] * self.dt, rates[1] * self.dt)
        return before + m.where(m.both(valid > 0.5, m.is_finite(value)), step, 0.0)

    def _seen(self, block: Block, ports: Any, u: Any, ratio: Scalar) -> Any:
        """The inputs of one controller: its own preview, and the measured wheel in terms of the data sheet's ratio."""
        values = {name: getattr(u, name) for name in ports._fields}
        if "preview" in values:
            points: int = getattr(block, "preview_points", 0)  # to ask one that has none takes as long as the law
            values["preview"] = tuple([values["preview"][i] for i in range(points)])
        if "delta_sw_meas" in values:
            values["delta_sw_meas"] = values["delta_sw_meas"] / ratio
        return ports(**values)


def _own(x: State) -> _Own:
    """The last entries of a state of `Adaptive`, whose others are those of its blocks."""
    return _Own._make(x[-len(_Own._fields) :])
