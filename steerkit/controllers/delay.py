"""A Smith predictor for controllers of a steering with dead time and lag."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from steerkit._support.errors import require
from steerkit.controllers.limits import slewed
from steerkit.controllers.stanley import Stanley
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State, entries_of
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import DT
from steerkit.vehicles import Vehicle, require_vehicle

_TRUST = 0.1
"""Share of a sample in how far a slow wheel is taken to be off its model: half a second."""


_SHARE_OF_TORQUE = 0.3
"""Of a car steered by torque (`Stanley.share`): with all of it sensor noise, or a gain 25 % off, makes it swing."""


class Step(NamedTuple):
    """A piece of the way into the future: its length [s], which command acts in it, where in the preview it lies."""

    h: float
    command: int
    preview: int
    share: float


class Motion(NamedTuple):
    """Where the car is beside its path, and how it turns."""

    e: Scalar
    psi_e: Scalar
    r: Scalar
    wheel: Scalar


@dataclass(frozen=True, eq=False, kw_only=True)
class DelayPredictor(Block):
    """Wraps a controller so that it sees e, psi_e, r and the wheel as they will be when its command has arrived.

    The state is carried `delay + lag` ahead under the commands on their way (the last one is held after `delay`):

        delta_sw' = (command(t - delay) - delta_sw)/lag  within +-rate_limit,  delta = delta_sw/steer_ratio,
        r_m' = (v tan(delta)/(L + K v^2) - r_m)/(yaw_time v),  r = r_m + (r measured - r_m now),
        side = r (reference + l_r - rear_slip v^2),
        e' = v sin(psi_e) + side cos(psi_e),
        psi_e' = r - kappa (v cos(psi_e) - side sin(psi_e))/(1 - kappa e),  kappa from the preview,

    a steadily sliding rear axle, and a yaw rate that lags as that of the linear single track; what the model has wrong
    now (ratio, tyres, offset) it is taken to have wrong all the way. One midpoint step (lag and yaw: exact) a command.
    A car steered by torque turns its wheel slowly; then more time passes until what was begun can be ended. So with a
    `slew` the state is carried on until the wheel is back at the path's own angle, turned there as fast as the slew
    allows, for 2 a_y_limit/slew at most: a wheel that stands there already costs no time.
    To a controller without a model the car then looks as if it had neither delay nor lag, and damping that fought these
    is no longer wanted: see `delayed_stanley`. For a linear law this is what delay states give an LQR.

    Inputs: e [m], psi_e [rad] and preview [1/m] (kappa every preview_dt of driving) at `reference`; v [m/s]; r [rad/s];
    delta_sw_meas [rad]. Output: delta_sw [rad]. State: that of the wrapped block; r_m (with a slew: of the sample
    before, the wheel of then, the model's own wheel and by how much that is off, averaged over half a second: commands
    are taken to be off by that); then the commands on their way, oldest first; one that is not finite never left, so
    the wheel's angle stands in for it. A negative v counts as 0.
    NaN in an input that the wrapped block or the prediction needs gives NaN out. A command replaced on its way to the
    wheel (by another controller in charge, a limiter) is not known here: for `delay` after a hand-over the prediction
    is wrong by the difference. Raises ValueError for parameters out of range and for a wrapped block with other ports.

    Source: Smith 1957 (predictor); Rajamani 2012, sections 2.3 and 3.3 (the car).
    """

    e = In("m")
    psi_e = In("rad")
    preview = In("1/m", size="preview_points")
    v = In("m/s")
    r = In("rad/s")
    delta_sw_meas = In("rad")
    delta_sw = Out("rad")

    block: Block
    """The controller: any with inputs among e, psi_e, kappa, v, r, delta_sw_meas and an output delta_sw."""
    delay: float = 0.0
    """Pure delay from command to wheel [s]."""
    lag: float = 0.0
    """First-order time constant of the wheel [s]."""
    wheelbase: Scalar = 2.7
    """L [m]."""
    understeer: Scalar = 0.0
    """K, understeer gradient [rad s^2/m]."""
    l_r: Scalar = 1.5
    """Centre of gravity to rear axle [m]."""
    rear_slip: Scalar = 0.0
    """m l_f/(c_r L): rear slip angle over v r [rad s^2/m]."""
    yaw_time: Scalar = 0.0033
    """i_z/(c_f l_f^2 + c_r l_r^2): lag of the yaw rate over v [s^2/m]."""
    steer_ratio: Scalar = 15.6
    """Steering-wheel angle over road-wheel angle [1]."""
    rate_limit: Scalar = radians_of(550.0)
    """Fastest steering wheel [rad/s]."""
    slew: float | None = None
    """Fastest change of the lateral acceleration of a car that is steered by torque [m/s^3]; None: no bound."""
    a_y_limit: float = 3.0
    """Its largest lateral acceleration [m/s^2]; nothing without a slew."""
    reference: Scalar = 1.2
    """Where e, psi_e and the preview are measured: metres ahead of the centre of gravity."""
    preview_points: int = 1
    """Entries of the preview; (delay + lag + 2 a_y_limit/slew)/preview_dt + 2 or more see the whole way."""
    preview_dt: float = DT
    """Time between them [s]."""

    def __post_init__(self) -> None:
        where, have = "DelayPredictor", {p.name for p in self.inputs} - {"preview"} | {"kappa"}
        asks = {p.name for p in self.block.inputs}
        kind = type(self.block).__name__
        require(
            asks <= have,
            where,
            f"{kind} needs {', '.join(sorted(asks - have))}; predicted are {', '.join(sorted(have))}",
        )
        gives = [p.name for p in self.block.outputs]
        require(gives == ["delta_sw"], where, f"block with outputs {gives}, expected delta_sw only")
        require(self.dt == self.block.dt, where, f"dt = {self.dt} s, but the wrapped block has {self.block.dt} s")
        for name in ("delay", "lag"):
            require(0.0 <= getattr(self, name) <= 2.0, where, f"{name} = {getattr(self, name)} [s], expected 0 to 2")
        for name in ("wheelbase", "steer_ratio", "rate_limit", "yaw_time", "preview_dt", "a_y_limit"):
            require(getattr(self, name) > 0.0, where, f"{name} = {getattr(self, name)}, expected > 0")
        require(self.slew is None or self.slew > 0.0, where, f"slew = {self.slew} [m/s^3], expected > 0, or None")
        require(self.preview_points >= 1, where, f"preview_points = {self.preview_points}, expected >= 1")

    @classmethod
    def around(
        cls,
        block: Block,
        vehicle: Vehicle,
        *,
        delay: float,
        lag: float,
        slew: float | None = None,
        a_y_limit: float | None = None,
    ) -> DelayPredictor:
        """`block` told of a steering delay and lag [s], with geometry, tyres and ratio of a `Vehicle`.

        slew [m/s^3], a_y_limit [m/s^2]: of a car that is steered by torque; None: without.
        """
        require_vehicle(vehicle, "DelayPredictor.around")
        L = vehicle.wheelbase
        bound = cls.a_y_limit if a_y_limit is None else a_y_limit
        back = 0.0 if slew is None else 2.0 * bound / slew
        return cls(
            block=block,
            delay=delay,
            lag=lag,
            wheelbase=L,
            understeer=vehicle.understeer_gradient,
            l_r=vehicle.l_r,
            rear_slip=vehicle.m * vehicle.l_f / (vehicle.c_r * L),
            yaw_time=vehicle.i_z / (vehicle.c_f * vehicle.l_f**2 + vehicle.c_r * vehicle.l_r**2),
            steer_ratio=vehicle.steer_ratio,
            slew=slew,
            a_y_limit=bound,
            reference=getattr(block, "reference", 0.0),
            preview_points=int((delay + lag + back) / block.dt + 1e-9) + 2,
            preview_dt=block.dt,
            dt=block.dt,
        )

    @cached_property
    def _steps(self) -> tuple[Step, ...]:
        """From now to delay + lag: a piece for each command on its way, then pieces of at most dt under the last."""
        n, steps, t = self._waiting, [], 0.0
        first = self.delay - (n - 1) * self.dt if self.delay > 0.0 else 0.0
        pieces = [(first if i == 0 else self.dt, i) for i in range(n)] if self.delay > 0.0 else []
        tail = int(np.ceil(self.lag / self.dt - 1e-9))
        pieces += [(self.lag / max(tail, 1), n - 1)] * tail
        for h, command in pieces:
            place = (t + 0.5 * h) / self.preview_dt
            entry = min(int(place), max(self.preview_points - 2, 0))
            steps.append(Step(h, command, entry, min(place - entry, 1.0) if self.preview_points > 1 else 0.0))
            t += h
        return tuple(steps)

    @cached_property
    def _waiting(self) -> int:
        """Commands to remember: those that act within the delay; one at least, to hold."""
        return max(1, int(np.ceil(self.delay / self.dt - 1e-9)))

    @property
    def _kept(self) -> int:
        """Numbers of the model in the state: r_m; with a slew the wheel before, its own wheel, how far that is off."""
        return 1 if self.slew is None else 4

    @cached_property
    def _inner(self) -> Any:
        return entries_of(self.block)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*self.block.init(batch), *[m.filled(0.0, batch)] * (self._kept + self._waiting))

    def settle(self, t: float, x: State, u: Any) -> State:
        make, n = self._inner
        wheel = (u.delta_sw_meas + 0.0,)
        model = () if self.slew is None else (*wheel * 2, 0.0 * u.delta_sw_meas)
        added = (u.r + 0.0, *model, *wheel * self._waiting)
        return (*self.block.settle(t, make(x[:n]), self._ahead(self.block.D, (*x[:n], *added), u)), *added)

    def output(self, t: Any, x: State, u: Any) -> Any:
        make, n = self._inner
        return self.Y(self.block.output(t, make(x[:n]), self._ahead(self.block.D, x, u)).delta_sw)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        make, n = self._inner
        inner = self.block.update(t, make(x[:n]), self._ahead(self.block.U, x, u), self.block.Y(y.delta_sw))
        sent = m.where(m.is_finite(y.delta_sw), y.delta_sw, u.delta_sw_meas)
        if self.slew is not None:  # how far a slow wheel got within the sample is known at its end
            commands = (*x[n + 4 :], sent)
            off = x[n + 3] + _TRUST * (u.delta_sw_meas - x[n + 2] - x[n + 3])
            model = (self._model_now(x, u), u.delta_sw_meas + 0.0, self._wheel(x[n + 2], commands, u.v), off)
            return (*inner, *[m.where(m.is_finite(value), value, 0.0) for value in model], *commands[1:])
        r = self.yaw_rate(x[n], u.delta_sw_meas, u.v)
        return (*inner, m.where(m.is_finite(r), r, 0.0), *x[n + 2 :], sent)

    def yaw_rate(self, r: Scalar, wheel: Scalar, v: Scalar) -> Scalar:
        """The model's yaw rate a sample after it was r, with this wheel [rad]."""
        steady, fade = self._yaw(m.maximum(v, 0.0))
        after = steady * m.tan(wheel / self.steer_ratio)
        return after + (r - after) * m.exp(fade * self.dt)

    def _wheel(self, wheel: Scalar, commands: State, v: Scalar) -> Scalar:
        """The model's wheel [rad] a sample later, under the oldest command and the one after it."""
        fastest, first = self._fastest(m.maximum(v, 0.0)), self._steps[0].h if self.delay > 0.0 else 0.0
        for h, command in zip((first, self.dt - first), commands):
            follow = 1.0 - float(np.exp(-h / self.lag)) if self.lag > 0.0 else 1.0
            wheel = wheel + m.clip(follow * (command - wheel), -fastest * h, fastest * h)
        return wheel

    def _model_now(self, x: State, u: Any) -> Scalar:
        """The model's yaw rate now, of a state that has it of the sample before, with the wheel of then."""
        _, n = self._inner
        return self.yaw_rate(x[n], 0.5 * (x[n + 1] + u.delta_sw_meas), u.v)

    def _ahead(self, ports: Any, x: State, u: Any) -> Any:
        """The wrapped block's inputs, `delay + lag` from now."""
        _, n = self._inner
        r_model = x[n] if self.slew is None else self._model_now(x, u)
        commands = x[n + self._kept :]
        if self.slew is not None:
            commands = tuple([command + x[n + 3] for command in commands])
        values = self.predict(r_model, commands, u)
        return ports(**{name: values[name] for name in ports._fields})

    def predict(self, r_model: Scalar, commands: State, u: Any) -> dict[str, Scalar]:
        """e, psi_e, kappa, v, r, delta_sw_meas when the next command has arrived; `commands` oldest first."""
        v = m.maximum(u.v, 0.0)
        now = Motion(u.e, u.psi_e, u.r, u.delta_sw_meas)
        wrong = u.r - r_model
        fastest = self._fastest(v)
        for h, command, entry, share in self._steps:
            follow = 1.0 - float(np.exp(-h / self.lag)) if self.lag > 0.0 else 1.0
            step = fastest * h
            moved = m.clip(follow * (commands[command] - now.wheel), -step, step)
            now = self.moved(now, h, moved, self._kappa(u.preview, entry, share), v, wrong)
        last = min(round((self.delay + self.lag) / self.preview_dt), self.preview_points - 1)
        kappa = u.preview[last]
        if self.slew is not None:
            now, kappa = self._back(now, kappa, u.preview, v, wrong)
        return dict(e=now.e, psi_e=now.psi_e, kappa=kappa, v=u.v, r=now.r, delta_sw_meas=now.wheel)

    def _back(self, now: Motion, kappa: Scalar, preview: Any, v: Scalar, wrong: Scalar) -> tuple[Motion, Scalar]:
        """The motion, and the path's curvature, when the wheel has been turned back to the path's own angle."""
        per_kappa = self.wheelbase + self.understeer * v * v
        fastest, going = self._fastest(v), 1.0
        for piece in range(math.ceil(2.0 * self.a_y_limit / (self.slew or math.inf) / self.dt)):
            place = (self.delay + self.lag + (piece + 0.5) * self.dt) / self.preview_dt
            entry = min(int(place), max(self.preview_points - 2, 0))
            ahead = self._kappa(preview, entry, min(place - entry, 1.0) if self.preview_points > 1 else 0.0)
            gap = self.steer_ratio * m.atan(per_kappa * ahead) - now.wheel
            moved = going * m.clip(gap, -fastest * self.dt, fastest * self.dt)
            h = m.absolute(moved) / fastest
            now = self.moved(now, h, moved, ahead, v, wrong)
            kappa = m.where(going > 0.5, ahead, kappa)
            going = m.where(m.absolute(gap) > fastest * self.dt, going, 0.0)
        return now, kappa

    def moved(self, now: Motion, h: Scalar, moved: Scalar, kappa: Scalar, v: Scalar, wrong: Scalar) -> Motion:
        """The motion h [s] later, in which the wheel moves so far [rad]: one midpoint step, exact in lag and yaw.

        kappa [1/m] of the path, v >= 0 [m/s]; wrong [rad/s]: by how much the car turns faster than the model.
        """
        steady, fade = self._yaw(v)
        lever = self.reference + self.l_r - self.rear_slip * v * v
        r_steady = steady * m.tan((now.wheel + 0.5 * moved) / self.steer_ratio) + wrong
        r = r_steady + (now.r - r_steady) * m.exp(fade * h)
        turn = 0.5 * (now.r + r)
        e, psi_e = now.e, now.psi_e
        e_dot, psi_dot = self._drift(v, e, psi_e, turn, lever, kappa)
        e_dot, psi_dot = self._drift(v, e + 0.5 * h * e_dot, psi_e + 0.5 * h * psi_dot, turn, lever, kappa)
        return Motion(e + h * e_dot, psi_e + h * psi_dot, r, now.wheel + moved)

    @staticmethod
    def _kappa(preview: Any, entry: int, share: float) -> Scalar:
        """The curvature between two entries of the preview."""
        kappa = preview[entry]
        return kappa + share * (preview[entry + 1] - kappa) if share > 0.0 else kappa

    def _fastest(self, v: Scalar) -> Scalar:
        """How fast the wheel turns [rad/s]."""
        car = dict(wheelbase=self.wheelbase, understeer=self.understeer, steer_ratio=self.steer_ratio)
        return slewed(self.rate_limit, self.slew, v, **car)

    def _yaw(self, v: Scalar) -> tuple[Scalar, Scalar]:
        """Steady yaw rate over tan(delta) [1/s], and the model's pole [1/s]."""
        return v / (self.wheelbase + self.understeer * v * v), -1.0 / (self.yaw_time * m.maximum(v, 0.5))

    @staticmethod
    def _drift(v: Scalar, e: Scalar, psi_e: Scalar, r: Scalar, lever: Scalar, kappa: Scalar) -> tuple[Scalar, Scalar]:
        """e' and psi_e'."""
        c, s, side = m.cos(psi_e), m.sin(psi_e), r * lever
        return v * s + side * c, r - kappa * (v * c - side * s) / m.maximum(1.0 - kappa * e, 0.2)


def delayed_stanley(
    vehicle: Vehicle,
    *,
    delay: float,
    lag: float,
    slew: float | None = None,
    a_y_limit: float | None = None,
    dt: float = DT,
) -> DelayPredictor:
    """Stanley for a steering delay and lag [s], 0 to 0.3 s and about 0.1 s: predicted, with gains tuned for that.

    The gains are what `python -m benchmarks study tune_stanley` chose: with the prediction, damping only costs.
    slew [m/s^3], a_y_limit [m/s^2]: of a car that is steered by torque; None: without.
    """
    gains: dict[str, float] = dict(k=3.0, k_d_yaw=0.0, k_d_steer=0.0, share=1.0 if slew is None else _SHARE_OF_TORQUE)
    stanley = replace(Stanley.of(vehicle, dt=dt), slew=slew, a_y_limit=a_y_limit, **gains)
    return DelayPredictor.around(stanley, vehicle, delay=delay, lag=lag, slew=slew, a_y_limit=a_y_limit)
