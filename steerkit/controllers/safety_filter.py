"""A safety filter between a controller and the wheel: it changes only commands that could end beside the path."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

from steerkit._support.errors import number, require, require_within
from steerkit.controllers.delay import DelayPredictor
from steerkit.controllers.limits import limited
from steerkit.controllers.stanley import Stanley, StanleyState
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State, without_port
from steerkit.diagram.maths import Scalar
from steerkit.task import TRIP
from steerkit.vehicles import Vehicle
from steerkit.vehicles.rollout import GateModel, Motion, Rollout, lag_share, lag_step, slewed

REASONS = (
    "passed",
    "wheel limits",
    "corrected",
    "backup: nothing else is safe",
    "backup: the command is not finite",
    "plan: what was found safe goes on",
)
"""What each value of the output `reason` means."""
BEHIND_GATE: Mapping[str, float] = MappingProxyType({"hold": 4, "horizon": 2.0, "preview_points": 26})
"""How far a safety filter looks ahead where a gate makes the wheel slow: at 3 m/s^2 and 5 m/s^3 it takes 1.2 s from one
side to the other. A command is held for less: in 0.4 s the gate turns the wheel by 2 m/s^2, and as long back."""
_ADAPT = 0.5
"""Time in which the yaw rate's slow part, and by how much the model has it wrong, are averaged [s]."""
_WANDERS = 5.0
"""Time over which it is found how far `wrong` goes from its own average [s]."""
_KEPT = 8
"""Numbers in the state before the commands on their way."""


class _Now(NamedTuple):
    """What a roll-out starts from; mirrored for the right side."""

    motion: Motion
    wheel_before: Scalar
    wrong: Scalar
    r_slow: Scalar
    doubt: Scalar
    commands: tuple[Scalar, ...]
    preview: tuple[Scalar, ...]

    def mirrored(self) -> _Now:
        """The mirror image."""
        sides = Motion._make([-value for value in self.motion]), -self.wheel_before, -self.wrong, -self.r_slow
        return _Now(*sides, self.doubt, tuple([-c for c in self.commands]), tuple([-kappa for kappa in self.preview]))


@dataclass(frozen=True, eq=False, kw_only=True)
class SafetyFilter(Block):
    """Passes a command if a backup can still keep the car on its path after it, else the nearest one for which it can.

    The backup is Stanley on the state that is predicted for the time at which its command arrives. In each sample

        reach(c) = max over t of |e(t)|,   c held for `hold` samples, then the backup, for `horizon` in all,
        w        = command within wheel stop, wheel speed and a_y (see `limits`)
        delta_sw = w                          if reach(w) <= bound
                 = w + share (backup - w)     otherwise: the least share with reach <= bound, by `halvings`
                 = the last of these, held    where there is none, for the rest of its `hold`
                 = backup                     afterwards

    A held command follows the bends: the path's own angle is added as it changes. Holding it for several samples keeps
    the corrections calm: they begin earlier (multi-step filter); hold = 1 is the one-step filter, which chatters at the
    bound.

    reach is the worst case within the stated doubts. Two cars are rolled out (see `Rollout`), one pushed to the left,
    and by the same equations on mirrored states one to the right. The left one begins e_doubt further left and turned
    psi_doubt further left than measured, and its yaw rate is

        r = r_model + wrong + yaw_doubt + ratio_doubt |r - r_slow|;

    its wheel is the further left one of two, of which one gets commands after `delay` and the other delay_doubt and a
    sample later; its backup is given e and psi_e by e_doubt and psi_doubt too far right, without the push during the
    delay. `wrong` and r_slow are averages over 0.5 s. With a `gate` each command is what that lets through.

    With `yaw_doubt_least` the yaw rate's doubt is wide at first and narrow where the model proves right:

        yaw_doubt_now = 3 sqrt(<(wrong - <wrong>)^2>),   between yaw_doubt_least and yaw_doubt, where it begins,

    <.> averages over 5 s, but a mean square grows within 0.5 s, so that a car that changes is doubted again after about
    a second. What was found safe with a narrow doubt holds only while that doubt bounds the errors.

    Guarantee: while the true car stays between the pushed ones, one that got a command with reach <= bound has
    |e| <= bound for `horizon` from then on, since after it either another such command is sent, or that one is held
    and then the backup steers, which is what was rolled out. The car stays between them if the doubts bound its errors
    and a wheel further left keeps it further left. Beyond the horizon the roll-out's last drift is extrapolated for
    `approach`: that a car which is coming back there stays is measured, not shown. Not covered: a path that bends
    beyond its preview faster than the wheel may turn, and a car that slides.

    Cost: at most 2 (1 + halvings) roll-outs of fixed length, without solver or branches, for floats, batches and C.

    Inputs: command [rad]; e [m], psi_e [rad], preview [1/m] (kappa every preview_dt of driving) at `reference`;
    v [m/s]; r [rad/s]; delta_sw_meas [rad]; with a `gate` also applied [rad], what it let through last. Outputs:
    delta_sw [rad]; correction [rad], delta_sw - command; share [1], 0 for none, 1 where nothing of w is left; reach [m]
    of w; reason [1], the number of one of `REASONS`. State: r_model, `wrong`, r_slow, the wheel one sample before, the
    command that was found safe last, less the path's own angle, for how many samples it is to be held, <wrong> and the
    mean square of what is left of `wrong`; then commands on their way, oldest first. Where a command is not finite, or
    an input is NaN, the last plan goes on, then the backup steers; a NaN in an input of the backup gives NaN, which the
    gate before a bus refuses. A negative v counts as 0.
    Raises ValueError for parameters out of range and for a backup that is not Stanley.

    Source: Wabersich, Zeilinger 2018 and 2021 (predictive safety filter); Gurriet et al. 2020 (a backup rolled out);
    Pizarro Bejarano, Brunke, Schoellig 2023 (multi-step filters).
    """

    command = In("rad")
    e = In("m")
    psi_e = In("rad")
    preview = In("1/m", size="preview_points")
    v = In("m/s")
    r = In("rad/s")
    delta_sw_meas = In("rad")
    applied = In("rad")
    delta_sw = Out("rad")
    correction = Out("rad")
    share = Out("1")
    reach = Out("m")
    reason = Out("1")

    backup: DelayPredictor
    """Stanley, and the model that is rolled out: geometry, ratio, dead time and lag as they are believed."""
    bound: float = number(TRIP, "m", low=0.05, high=100.0)
    """|e| that is not to be exceeded [m]."""
    horizon: float = 1.3
    """How far is looked ahead from when the command arrives [s]; at least 0.3 s longer than the hold."""
    hold: int = number(8, "1", low=1)
    """Samples for which a command is taken to be held."""
    halvings: int = number(5, "1", low=1)
    """How often the share is halved between one that is safe and one that is not."""
    e_doubt: float = number(0.03, "m", low=0.0, high=10.0)
    """Largest error of the measured e [m]."""
    psi_doubt: float = number(0.005, "rad", low=0.0, high=1.0)
    """Largest error of the measured psi_e [rad]."""
    yaw_doubt: float = number(0.01, "rad/s", low=0.0, high=1.0)
    """Largest error of the yaw rate that is neither constant nor in proportion to its changes [rad/s]."""
    yaw_doubt_least: float | None = None
    """How far that may narrow while the model proves right [rad/s]; None: it stays as it is."""
    ratio_doubt: float = number(0.1, "1", low=0.0, high=1.0)
    """Largest error of the yaw rate as a share of its change [1]: steering ratio, tyres."""
    delay_doubt: float = number(0.05, "s", low=0.0, high=2.0)
    """How much later than believed commands may arrive [s]."""
    approach: float = number(0.4, "s", low=0.0, high=10.0)
    """Time for which the drift at the end of a roll-out is extrapolated [s]."""
    preview_points: int = number(20, "1", low=2)
    """Entries of the preview."""
    preview_dt: float = number(0.1, "s", low=1e-3, high=10.0)
    """Time between them [s]."""
    gate: GateModel | None = None
    """What comes between the filter and the wheel, if anything does; then `applied` says what it let through last."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where, turning = "SafetyFilter", self.gate.turning if self.gate else 0.0
        law = isinstance(self.backup, DelayPredictor) and isinstance(self.backup.block, Stanley)
        require(law, where, "backup of another kind than DelayPredictor around Stanley, such as SafetyFilter.of makes")
        require(self.dt == self.backup.dt, where, f"dt = {self.dt} s, but the backup has {self.backup.dt} s")
        require_within(where, "horizon", self.horizon, "s", self.hold * self.dt + max(0.3, turning), 10.0)
        if self.yaw_doubt_least is not None:
            require_within(where, "yaw_doubt_least", self.yaw_doubt_least, "rad/s", 0.0, self.yaw_doubt)
        if self.gate is None:
            without_port(self, "applied")

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        *,
        delay: float = 0.0,
        lag: float = 0.1,
        rate_limit: float = Rollout.rate_limit,
        **settings: Any,
    ) -> SafetyFilter:
        """For a `Vehicle`, with the believed delay [s], lag [s] and rate limit [rad/s] of its steering.

        settings: any other fields.
        """
        law = replace(Stanley.of(vehicle), rate_limit=rate_limit)
        steering = dict(delay=delay, lag=lag, rate_limit=rate_limit)
        return cls(backup=DelayPredictor.around(law, vehicle, **steering), **settings)

    @property
    def reference(self) -> Scalar:
        """Where e, psi_e and the preview are measured: metres ahead of the centre of gravity."""
        return self.backup.reference

    @property
    def _law(self) -> Stanley:
        return self.backup.block  # type: ignore[return-value]

    @cached_property
    def _soonest(self) -> int:
        """Samples after which a command acts at the soonest."""
        return math.floor(self.backup.model.delay / self.dt + 1e-9)

    @cached_property
    def _latest(self) -> int:
        """Samples after which it acts at the latest."""
        return math.floor((self.backup.model.delay + self.delay_doubt) / self.dt + 1e-9) + 1

    @cached_property
    def _model(self) -> Rollout:
        """The backup's model, with the preview that this block is given."""
        return replace(self.backup.model, preview_dt=self.preview_dt)

    @cached_property
    def _follow(self) -> float:
        """Share of the way to its command that the wheel goes in a sample."""
        return lag_share(self.dt, self._model.lag)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero = m.filled(0.0, batch)
        return (*[zero] * (_KEPT - 1), zero + (self.yaw_doubt / 3.0) ** 2, *[zero] * self._latest)

    def settle(self, t: float, x: State, u: Any) -> State:
        wheel = u.delta_sw_meas + 0.0
        none = 0.0 * wheel
        first = (u.r + 0.0, 0.0 * u.r, u.r + 0.0, wheel, wheel, none, none, none + (self.yaw_doubt / 3.0) ** 2)
        return (*first, *[wheel] * self._latest)

    def output(self, t: Any, x: State, u: Any) -> Any:
        v, sound = m.maximum(u.v, 0.0), m.is_finite(u.command)
        motion = Motion(u.e, u.psi_e, u.r, u.delta_sw_meas)
        now = _Now(motion, x[3], x[1], x[2], self._yaw_doubt(x[7]), self._sent(x, u), tuple(u.preview))
        within = u.command
        if self.gate is None:
            within = limited(self._law, u.command, x[-1], v, v * v * m.absolute(u.preview[0]))
        reach = self._reach(now, v, within)
        safe = m.both(sound, reach <= self.bound)
        if safe is True:  # one car whose command is kept, as nearly all are: the rest need not be computed
            return self.Y(within, within - u.command, 0.0, reach, 0.0 if within == u.command else 1.0)
        own = self._own(now, v)
        low = m.where(sound, within, own)
        high, share, step = own, 1.0, 1.0
        for _ in range(self.halvings):
            step = 0.5 * step
            middle = 0.5 * (low + high)
            good = self._reach(now, v, middle) <= self.bound
            low, high = m.where(good, low, middle), m.where(good, middle, high)
            share = m.where(good, share - step, share)
        share = m.where(safe, 0.0, m.where(sound, share, 1.0))
        plan = m.both(share >= 1.0, x[5] > 0.5)
        planned = m.clip(x[4] + self._bend(now.preview, v, self._soonest), -self._law.limit, self._law.limit)
        delta_sw = m.where(safe, within, m.where(plan, planned, m.where(sound, high, own)))
        changed = m.where(share < 1.0, m.where(share > 0.0, 2.0, m.where(within == u.command, 0.0, 1.0)), 3.0)
        reason = m.where(plan, 5.0, m.where(sound, changed, 4.0))
        return self.Y(delta_sw, delta_sw - u.command, share, reach, reason)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        part, slowly, planned = self.dt / _ADAPT, self.dt / _WANDERS, y.share < 1.0
        left = (x[1] - x[6]) ** 2
        after = (
            self._model.yaw_rate_after(x[0], u.delta_sw_meas, m.maximum(u.v, 0.0), self.dt),
            x[1] + part * (u.r - x[0] - x[1]),
            x[2] + part * (u.r - x[2]),
            u.delta_sw_meas,
            m.where(planned, y.delta_sw - self._bend(tuple(u.preview), m.maximum(u.v, 0.0), self._soonest), x[4]),
            m.where(planned, self.hold - 1.0, m.where(y.reason < len(REASONS), m.maximum(x[5] - 1.0, 0.0), 0.0)),
            x[6] + slowly * (x[1] - x[6]),
            x[7] + m.where(left > x[7], part, slowly) * (left - x[7]),
            *self._sent(x, u)[1:],
            y.delta_sw,
        )
        before = (*x[:_KEPT], *x[_KEPT + 1 :], x[-1])  # what is no number was not measured, or never left
        return tuple([m.where(m.is_finite(new), new + 0.0, old) for new, old in zip(after, before, strict=True)])

    def _yaw_doubt(self, square: Scalar) -> Scalar:
        """Of the yaw rate now [rad/s], from the mean square of what is left of `wrong`."""
        if self.yaw_doubt_least is None:
            return self.yaw_doubt
        return m.clip(3.0 * m.sqrt(square), self.yaw_doubt_least, self.yaw_doubt)

    def _bend(self, preview: tuple[Scalar, ...], v: Scalar, samples: int) -> Scalar:
        """The path's own angle of the wheel [rad], so many samples ahead."""
        return self._model.steady_wheel(self._model.kappa(preview, samples * self.dt), v)

    def _sent(self, x: State, u: Any) -> State:
        """The commands on their way; of the last one a gate says what it made of it."""
        return x[_KEPT:] if self.gate is None else (*x[_KEPT:-1], u.applied)

    def _answer(self, seen: Motion, v: Scalar, kappa: Scalar, wheel_before: Scalar, command: Scalar) -> Scalar:
        """The backup's command [rad] after another, for what it sees."""
        law = self._law
        u = law.D(e=seen.e, psi_e=seen.psi_e, kappa=kappa, v=v, r=seen.r, delta_sw_meas=seen.wheel)
        return law.output(0.0, StanleyState(wheel_before / law.steer_ratio, command), u).delta_sw

    def _own(self, now: _Now, v: Scalar) -> Scalar:
        """The backup's command now: that of the state in which it will arrive, as believed."""
        model, motion, before, most = self._model, now.motion, now.wheel_before, slewed(self._model, v) * self.dt
        for k in range(self._soonest):
            turned = lag_step(now.commands[k - self._soonest] - motion.wheel, self._follow, most)
            before = motion.wheel
            motion = model.moved(motion, self.dt, turned, model.kappa(now.preview, (k + 0.5) * self.dt), v, now.wrong)
        return self._answer(motion, v, model.kappa(now.preview, self._soonest * self.dt), before, now.commands[-1])

    def _reach(self, now: _Now, v: Scalar, command: Scalar) -> Scalar:
        """The furthest that the car may get to either side after a command [m]."""
        return m.maximum(self._left(now, v, command), self._left(now.mirrored(), v, -command))

    def _left(self, now: _Now, v: Scalar, command: Scalar) -> Scalar:
        """The furthest to the left, of a car that is pushed there."""
        model, dt, soonest, latest = self._model, self.dt, self._soonest, self._latest
        dead, follow, most = soonest * dt, self._follow, slewed(model, v) * dt
        commands = list(now.commands)
        soon, late = now.motion.wheel, m.maximum(now.motion.wheel, now.wheel_before)
        car = Motion(now.motion.e + self.e_doubt, now.motion.psi_e + self.psi_doubt, now.motion.r, late)
        push, before, furthest = now.doubt, late, -1e9
        bend = self._bend(now.preview, v, soonest)
        for k in range(soonest + round(self.horizon / dt)):
            if k >= soonest:
                if k < soonest + self.hold:
                    given = command + self._bend(now.preview, v, k) - bend
                else:
                    unaware = 2.0 * self.psi_doubt + push * dead
                    e_seen = car.e - 2.0 * self.e_doubt - v * unaware * dead
                    seen = Motion(e_seen, car.psi_e - unaware, car.r, car.wheel)
                    given = self._answer(seen, v, model.kappa(now.preview, k * dt), before, given)
                if self.gate is not None:
                    early = self.gate.frame_dt if k == soonest else 0.0
                    given = self.gate.pushed(given, commands[-1], v, dt, early)
                commands.append(given)
            soon = soon + lag_step(commands[k + latest - soonest] - soon, follow, most)
            late = late + lag_step(commands[k] - late, follow, most)
            push = now.doubt + self.ratio_doubt * m.absolute(car.r - now.r_slow)
            before, e_before = car.wheel, car.e
            turned = m.maximum(soon, late) - before
            car = model.moved(car, dt, turned, model.kappa(now.preview, (k + 0.5) * dt), v, now.wrong + push)
            if k >= soonest:  # until then nothing that is commanded now makes a difference
                furthest = m.maximum(car.e, furthest)
        return m.maximum(car.e + self.approach * (car.e - e_before) / dt, furthest)
