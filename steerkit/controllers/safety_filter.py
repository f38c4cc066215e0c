"""A safety filter between a controller and the wheel: it changes only commands that could end beside the path."""

import math
from collections.abc import Callable, Mapping, Sequence
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
from steerkit.estimators.steering_response import at as picked
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
_SAID = 1.5
"""Factor on the doubt from which on it is told."""
BEHIND_GATE: Mapping[str, float] = MappingProxyType({"hold": 4, "horizon": 2.0, "preview_points": 26})
"""How far a safety filter looks ahead where a gate makes the wheel slow: at 3 m/s^2 and 5 m/s^3 it takes 1.2 s from one
side to the other. A command is held for less: in 0.4 s the gate turns the wheel by 2 m/s^2, and as long back."""
_ADAPT = 0.5
"""Time in which the yaw rate's slow part, and by how much the model has it wrong, are averaged [s]."""
_WANDERS = 5.0
"""Time over which it is found how far `wrong` goes from its own average [s]."""
_NOTICED = 2.0
"""Time over which the yaw rate is compared with what each dead time would have made of the commands [s]."""
_FORGETS = 15.0
"""Time in which a doubt that was widened narrows again [s]."""


class _Known(NamedTuple):
    """The state before the bank and the commands on their way."""

    r_model: Scalar
    """What the model makes of the measured wheel [rad/s]."""
    wrong: Scalar
    r_slow: Scalar
    wheel_before: Scalar
    plan: Scalar
    """The command that was found safe last, less the path's own angle [rad]."""
    hold: Scalar
    """Samples for which it is to be held."""
    wrong_slow: Scalar
    wrong_square: Scalar
    late: Scalar
    """Samples that commands arrive later than believed."""
    widened: Scalar
    wheel: Scalar
    """As commanded [rad]."""
    r_sent: Scalar
    """p_0 [rad/s], and its average."""
    r_sent_slow: Scalar
    square: Scalar
    """Mean squares of the yaw rate's change and of what is allowed."""
    allowed: Scalar


_BANK = len(_Known._fields)
"""Where in the state the bank begins."""


class _Now(NamedTuple):
    """What a roll-out starts from; mirrored for the right side."""

    motion: Motion
    wheel_before: Scalar
    wrong: Scalar
    r_slow: Scalar
    commands: tuple[Scalar, ...]
    """On their way [rad], from the one that the late car gets now."""
    waiting: tuple[Scalar, ...]
    """Those that it still waits for when a command of now arrives."""
    kappa: tuple[Scalar, ...]
    """The path's curvature in the middle of each sample until then [1/m]."""
    ahead: tuple[Scalar, ...]
    """That of every half sample from then on."""
    bends: tuple[Scalar, ...]
    """The path's own angle of the wheel [rad], of every sample from then on."""
    doubt: Scalar
    ratio_doubt: Scalar
    dead: Scalar
    """Samples until then."""

    def mirrored(self) -> "_Now":
        """The mirror image."""
        others = {name: -getattr(self, name) for name in ("wheel_before", "wrong", "r_slow")}
        for name in ("commands", "waiting", "kappa", "ahead", "bends"):
            others[name] = tuple([-value for value in getattr(self, name)])
        return self._replace(motion=Motion._make([-value for value in self.motion]), **others)


class _Pushed(NamedTuple):
    """A car that is pushed: its wheel had it got all commands soon, and late; the wheel before; the push."""

    car: Motion
    soon: Scalar
    late: Scalar
    before: Scalar
    push: Scalar


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
    corrections calm: they begin earlier (multi-step filter); the one-step filter, hold = 1, chatters at the bound.

    reach is the worst case within the stated doubts. Two cars are rolled out (see `Rollout`), one pushed to the left,
    and by the same equations on mirrored states one to the right. The left one begins e_doubt further left and turned
    psi_doubt further left than measured, and its yaw rate is

        r = r_model + wrong + yaw_doubt + widened ratio_doubt |r - r_slow|;

    its wheel is the further left one of two, of which one gets commands after `delay` + late and the other delay_doubt
    and a sample later; its backup is given e and psi_e by e_doubt and psi_doubt too far right, without the push until
    then. `wrong` and r_slow are averages over 0.5 s. With a `gate` each command is what that lets through.

    With `yaw_doubt_least` the yaw rate's doubt is wide at first and narrow where the model proves right:

        yaw_doubt_now = 3 sqrt(<(wrong - <wrong>)^2>),   between yaw_doubt_least and yaw_doubt, where it begins,

    <.> averages over 5 s, but a mean square grows within 0.5 s, so that a car that changes is doubted again after about
    a second. What was found safe with a narrow doubt holds only while that doubt bounds the errors.

    Where the yaw rate proves these doubts too small, the model moves. p_k is what its yaw rate would be if commands
    arrived k samples later than believed, up to `later` and the doubt; p_k and r are compared without their averages,
    in the mean < > over 2 s, with a g free within 1 +- widest ratio_doubt:

        J_k(g) = <(r - g p_k)^2>
        late    = dt argmin_k J_k     once 2 min_k J_k + (yaw_doubt/2)^2 < J_k of all k that late and delay_doubt allow
        widened = sqrt(min_k J_k(1)/allowed),   allowed = <(yaw_doubt + ratio_doubt |r - r_slow|)^2>

    with widened within 1 and `widest`; it falls within 15 s. Where late moves, the plan is dropped: it was safe for
    another car. Until a car has been steered for about half a second nothing is proven. Commands that arrive sooner
    than believed are not noticed.

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
    of w; reason [1], the number of one of `REASONS`; late [s] and widened [1]. State: `_Known`, then p_k, <r p_k>,
    <p_k^2> of each k, then commands on their way, oldest first. Where a command is not finite, or an input is NaN, the
    last plan goes on, then the backup steers; a NaN in an input of the backup gives NaN, which the gate before a bus
    refuses. A negative v counts as 0. Raises ValueError for a backup that is not Stanley.

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
    late = Out("s")
    widened = Out("1")

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
    later: float = number(0.4, "s", low=0.0, high=2.0)
    """How much later than believed they are found to arrive at the most [s]; 0: the believed delay stays."""
    widest: float = number(4.0, "1", low=1.0, high=10.0)
    """Largest factor on `ratio_doubt` where the yaw rate proves that too small [1]; 1: it stays."""
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
    ) -> "SafetyFilter":
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
    def _spread(self) -> int:
        """Samples more after which it acts at the latest."""
        return math.floor((self.backup.model.delay + self.delay_doubt) / self.dt + 1e-9) + 1 - self._soonest

    @cached_property
    def _later(self) -> int:
        """Samples more that are found at the most."""
        return math.ceil(self.later / self.dt - 1e-9)

    @property
    def _kept(self) -> int:
        """Commands in the state."""
        return self._soonest + self._later + self._spread

    @property
    def _candidates(self) -> int:
        """Dead times in the bank."""
        return self._later + self._spread + 1

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
        known = _Known(*[zero] * _BANK)._replace(wrong_square=zero + (self.yaw_doubt / 3.0) ** 2, widened=zero + 1.0)
        return (*known, *[zero] * (3 * self._candidates + self._kept))

    def settle(self, t: float, x: State, u: Any) -> State:
        wheel = u.delta_sw_meas + 0.0
        none = 0.0 * wheel
        steady = self._model.yaw_rate_after(u.r, wheel, m.maximum(u.v, 0.0), math.inf)
        known = _Known(*[none + at_first for at_first in self.init()[:_BANK]])._replace(
            r_model=u.r + 0.0,
            r_slow=u.r + 0.0,
            wheel_before=wheel,
            plan=wheel,
            wheel=wheel,
            r_sent=steady,
            r_sent_slow=steady,
        )
        return (*known, *[none] * (3 * self._candidates), *[wheel] * self._kept)

    def on_standby(self, x: State, settled: State) -> State:
        """The state `settled`; what was found of the car stays."""
        known = _known(x)
        return (*_known(settled)._replace(late=known.late, widened=known.widened), *settled[_BANK:])

    def output(self, t: Any, x: State, u: Any) -> Any:
        v, sound = m.maximum(u.v, 0.0), m.is_finite(u.command)
        now, known = self._now(x, u, v), _known(x)
        within = u.command
        if self.gate is None:
            within = limited(self._law, u.command, x[-1], v, v * v * m.absolute(u.preview[0]))
        sides = [(side, self._arrived(side, v)) for side in (now, now.mirrored())]
        reach = self._reach(sides, v, within)
        safe = m.both(sound, reach <= self.bound)
        found = (self.dt * known.late, known.widened + 0.0)
        if safe is True:  # one car whose command is kept, as nearly all are: the rest need not be computed
            return self.Y(within, within - u.command, 0.0, reach, 0.0 if within == u.command else 1.0, *found)
        own = self._own(now, v)
        low = m.where(sound, within, own)
        high, share, step = own, 1.0, 1.0
        for _ in range(self.halvings):
            step = 0.5 * step
            middle = 0.5 * (low + high)
            good = self._reach(sides, v, middle) <= self.bound
            low, high = m.where(good, low, middle), m.where(good, middle, high)
            share = m.where(good, share - step, share)
        share = m.where(safe, 0.0, m.where(sound, share, 1.0))
        plan = m.both(share >= 1.0, known.hold > 0.5)
        planned = m.clip(known.plan + now.bends[0], -self._law.limit, self._law.limit)
        delta_sw = m.where(safe, within, m.where(plan, planned, m.where(sound, high, own)))
        changed = m.where(share < 1.0, m.where(share > 0.0, 2.0, m.where(within == u.command, 0.0, 1.0)), 3.0)
        reason = m.where(plan, 5.0, m.where(sound, changed, 4.0))
        return self.Y(delta_sw, delta_sw - u.command, share, reach, reason, *found)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        part, slowly, planned = self.dt / _ADAPT, self.dt / _WANDERS, y.share < 1.0
        known, v = _known(x), m.maximum(u.v, 0.0)
        left = (known.wrong - known.wrong_slow) ** 2
        bend = self._model.steady_wheel(self._ahead(tuple(u.preview), known.late, 1)[0], v)
        found, bank = self._found(x, u, v, (*self._sent(x, u), y.delta_sw))
        goes_on = m.where(y.reason < len(REASONS), m.maximum(known.hold - 1.0, 0.0), 0.0)
        new = found._replace(
            r_model=self._model.yaw_rate_after(known.r_model, u.delta_sw_meas, v, self.dt),
            wrong=known.wrong + part * (u.r - known.r_model - known.wrong),
            r_slow=known.r_slow + part * (u.r - known.r_slow),
            wheel_before=u.delta_sw_meas,
            plan=m.where(planned, y.delta_sw - bend, known.plan),
            hold=m.where(found.late == known.late, m.where(planned, self.hold - 1.0, goes_on), 0.0),
            wrong_slow=known.wrong_slow + slowly * (known.wrong - known.wrong_slow),
            wrong_square=known.wrong_square
            + m.where(left > known.wrong_square, part, slowly) * (left - known.wrong_square),
        )
        after = (*new, *bank, *self._sent(x, u)[1:], y.delta_sw)
        kept = len(x) - self._kept
        before = (*x[:kept], *x[kept + 1 :], x[-1])  # what is no number was not measured, or never left
        return tuple([m.where(m.is_finite(new), new + 0.0, old) for new, old in zip(after, before, strict=True)])

    def _found(self, x: State, u: Any, v: Scalar, sent: State) -> tuple[_Known, State]:
        """How late commands arrive, by what factor the doubt is widened, and the bank that says so, after a sample."""
        n, part, tight = self._candidates, self.dt / _NOTICED, (0.5 * self.yaw_doubt) ** 2
        changes, products, squares = (x[_BANK + i * n : _BANK + (i + 1) * n] for i in range(3))
        known = _known(x)
        change, late = u.r - known.r_slow, known.late
        square = known.square + part * (change * change - known.square)
        most = (self.yaw_doubt + self.ratio_doubt * m.absolute(change)) ** 2
        allowed = known.allowed + part * (most - known.allowed)
        products = tuple([c + part * (change * p - c) for c, p in zip(products, changes)])
        squares = tuple([s + part * (p * p - s) for s, p in zip(squares, changes)])
        wide, best, place, within, off = self.widest * self.ratio_doubt, 1e9, 0.0, 1e9, 1e9
        for k, (c, s) in enumerate(zip(products, squares)):
            gain = m.clip(c / (s + 1e-12), 1.0 - wide, 1.0 + wide)
            left = square - gain * (2.0 * c - gain * s)
            place = m.where(left < best, float(k), place)
            best = m.minimum(left, best)
            within = m.where(
                m.absolute(k - late - 0.5 * self._spread) < 0.5 * self._spread + 0.5, m.minimum(left, within), within
            )
            off = m.minimum(square - 2.0 * c + s, off)
        late = m.where(within > 2.0 * best + tight, m.minimum(place, float(self._later)), late)
        excess = m.sqrt(m.maximum(off, 0.0) / m.maximum(allowed, tight))
        widened = m.maximum(excess, known.widened - self.dt / _FORGETS * (known.widened - 1.0))
        turned = lag_step(sent[-1 - self._soonest] - known.wheel, self._follow, slewed(self._model, v) * self.dt)
        r = self._model.yaw_rate_after(known.r_sent, known.wheel + 0.5 * turned, v, self.dt)
        slow = known.r_sent_slow + self.dt / _ADAPT * (known.r_sent - known.r_sent_slow)
        found = known._replace(
            late=late,
            widened=m.minimum(widened, self.widest),
            wheel=known.wheel + turned,
            r_sent=r,
            r_sent_slow=slow,
            square=square,
            allowed=allowed,
        )
        return found, (r - slow, *changes[:-1], *products, *squares)

    def _sent(self, x: State, u: Any) -> State:
        """The commands on their way; of the last one a gate says what it made of it."""
        sent = x[len(x) - self._kept :]
        return sent if self.gate is None else (*sent[:-1], u.applied)

    def _answer(self, seen: Motion, v: Scalar, kappa: Scalar, wheel_before: Scalar, command: Scalar) -> Scalar:
        """The backup's command [rad] after another, for what it sees."""
        law = self._law
        u = law.D(e=seen.e, psi_e=seen.psi_e, kappa=kappa, v=v, r=seen.r, delta_sw_meas=seen.wheel)
        return law.output(0.0, StanleyState(wheel_before / law.steer_ratio, command), u).delta_sw

    def _now(self, x: State, u: Any, v: Scalar) -> _Now:
        """What roll-outs start from."""
        known, sent, preview = _known(x), self._sent(x, u), tuple(u.preview)
        late = known.late
        last = len(sent) - 1
        commands = [[sent[min(k + self._later - n, last)] for n in range(self._later + 1)] for k in range(len(sent))]
        middles = range(self._soonest + (round(late) if isinstance(late, float) else self._later))
        ahead = self._ahead(preview, late, 2 * round(self.horizon / self.dt))
        doubt: Scalar = self.yaw_doubt
        if self.yaw_doubt_least is not None:
            doubt = m.clip(3.0 * m.sqrt(known.wrong_square), self.yaw_doubt_least, self.yaw_doubt)
        return _Now(
            Motion(u.e, u.psi_e, u.r, u.delta_sw_meas),
            known.wheel_before,
            known.wrong,
            known.r_slow,
            tuple([picked(late, row) for row in commands]),
            sent[-self._spread :],
            tuple([self._model.kappa(preview, (k + 0.5) * self.dt) for k in middles]),
            ahead,
            tuple([self._model.steady_wheel(kappa, v) for kappa in ahead[: 2 * self.hold : 2]]),
            doubt,
            known.widened * self.ratio_doubt,
            self._soonest + late,
        )

    def _ahead(self, preview: tuple[Scalar, ...], late: Scalar, count: int) -> tuple[Scalar, ...]:
        """The path's curvature [1/m], every half sample from when a command of now arrives."""
        model, half, first = self._model, 0.5 * self.dt, 2 * self._soonest
        if isinstance(late, float):
            first = first + 2 * round(late)
            return tuple([model.kappa(preview, (first + k) * half) for k in range(count)])
        halves = [model.kappa(preview, (first + k) * half) for k in range(2 * self._later + count)]
        return tuple([picked(late, halves[k : k + 2 * self._later + 1 : 2]) for k in range(count)])

    def _until(self, dead: Scalar, step: Callable[..., Any], values: Any) -> Any:
        """The values after so many samples (k, values) -> values."""
        one = isinstance(dead, float)
        for k in range(round(dead) if one else self._soonest + self._later):
            after = step(k, *values)
            values = after if one else tuple([m.where(k < dead - 0.5, *pair) for pair in zip(after, values)])
        return values

    def _own(self, now: _Now, v: Scalar) -> Scalar:
        """The backup's command now: that of the state in which it will arrive, as believed."""
        model, most, w = self._model, slewed(self._model, v) * self.dt, self._spread

        def waits(k: int, *values: Scalar) -> tuple[Scalar, ...]:
            motion = Motion(*values[:4])
            turned = lag_step(now.commands[k + w] - motion.wheel, self._follow, most)
            return *model.moved(motion, self.dt, turned, now.kappa[k], v, now.wrong), motion.wheel

        *motion, before = self._until(now.dead, waits, (*now.motion, now.wheel_before))
        return self._answer(Motion(*motion), v, now.ahead[0], before, now.commands[-1])

    def _reach(self, sides: Sequence[tuple[_Now, _Pushed]], v: Scalar, command: Scalar) -> Scalar:
        """The furthest that the car may get to either side after a command [m]."""
        left, right = sides
        return m.maximum(self._left(*left, v, command), self._left(*right, v, -command))

    def _moved(self, now: _Now, v: Scalar, kappa: Scalar, commands: tuple[Scalar, Scalar], at: _Pushed) -> _Pushed:
        """A sample more of a car that is pushed to the left; one of its wheels gets the one command, one the other."""
        most = slewed(self._model, v) * self.dt
        soon = at.soon + lag_step(commands[0] - at.soon, self._follow, most)
        late = at.late + lag_step(commands[1] - at.late, self._follow, most)
        push = now.doubt + now.ratio_doubt * m.absolute(at.car.r - now.r_slow)
        turned = m.maximum(soon, late) - at.car.wheel
        car = self._model.moved(at.car, self.dt, turned, kappa, v, now.wrong + push)
        return _Pushed(car, soon, late, at.car.wheel, push)

    def _arrived(self, now: _Now, v: Scalar) -> _Pushed:
        """The car that is pushed to the left, until a command of now arrives."""

        def waits(k: int, *values: Scalar) -> tuple[Scalar, ...]:
            commands = now.commands[k + self._spread], now.commands[k]
            after = self._moved(now, v, now.kappa[k], commands, _Pushed(Motion(*values[:4]), *values[4:]))
            return *after.car, *after[1:]

        late = m.maximum(now.motion.wheel, now.wheel_before)
        begin = now.motion.e + self.e_doubt, now.motion.psi_e + self.psi_doubt, now.motion.r, late
        values = self._until(now.dead, waits, (*begin, now.motion.wheel, late, late, now.doubt))
        return _Pushed(Motion(*values[:4]), *values[4:])

    def _left(self, now: _Now, at: _Pushed, v: Scalar, command: Scalar) -> Scalar:
        """The furthest to the left, of a car that is pushed there."""
        dead, commands = now.dead * self.dt, list(now.waiting)
        furthest, e_before = -1e9, at.car.e
        for k in range(round(self.horizon / self.dt)):
            if k < self.hold:
                given = command + now.bends[k] - now.bends[0]
            else:
                unaware = 2.0 * self.psi_doubt + at.push * dead
                e_seen = at.car.e - 2.0 * self.e_doubt - v * unaware * dead
                seen = Motion(e_seen, at.car.psi_e - unaware, at.car.r, at.car.wheel)
                given = self._answer(seen, v, now.ahead[2 * k], at.before, given)
            if self.gate is not None:
                early = self.gate.frame_dt if k == 0 else 0.0
                given = self.gate.pushed(given, commands[-1], v, self.dt, early)
            commands.append(given)
            e_before = at.car.e
            at = self._moved(now, v, now.ahead[2 * k + 1], (given, commands[k]), at)
            furthest = m.maximum(at.car.e, furthest)
        return m.maximum(at.car.e + self.approach * (at.car.e - e_before) / self.dt, furthest)


def _known(x: State) -> _Known:
    """The first entries of a state of `SafetyFilter`."""
    return _Known._make(x[:_BANK])


def doubted(late: float, widened: float) -> str:
    """What the filter found of the car beyond its doubts, in words, from late [s] and widened [1]; "" for nothing."""
    delay = f"commands arrive {late:.2f} s later than believed" if late > 0.0 else ""
    ratio = f"ratio and tyres doubted {widened:.1f} times as much" if widened > _SAID else ""
    return ", ".join(filter(None, (delay, ratio)))
