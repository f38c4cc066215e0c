"""Steering delay: what a controller should have known, and how to read delay and lag from a log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit import maths as m
from steerkit.block import Block, In, Out, State
from steerkit.controllers.stanley import Stanley
from steerkit.errors import require
from steerkit.maths import Scalar
from steerkit.task import DT
from steerkit.units import radians_of
from steerkit.vehicles import Vehicle

Array = NDArray[np.float64]


class Step(NamedTuple):
    """A piece of the way into the future: its length [s], which command acts in it, where in the preview it lies."""

    h: float
    command: int
    preview: int
    share: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Predicted(Block):
    """Wraps a controller so that it sees e, psi_e, r and the wheel as they will be when its command has arrived.

    The state is carried `delay + lag` ahead under the commands on their way (the last one is held after `delay`):

        delta_sw' = (command(t - delay) - delta_sw)/lag  within +-rate_limit,  delta = delta_sw/steer_ratio,
        r_m' = (v tan(delta)/(L + K v^2) - r_m)/(yaw_time v),  r = r_m + (r measured - r_m now),
        side = r (reference + l_r - rear_slip v^2),
        e' = v sin(psi_e) + side cos(psi_e),
        psi_e' = r - kappa (v cos(psi_e) - side sin(psi_e))/(1 - kappa e),  kappa from the preview,

    a steadily sliding rear axle, and a yaw rate that lags as that of the linear single track; what the model has wrong
    now (ratio, tyres, offset) it is taken to have wrong all the way. One midpoint step (lag and yaw: exact) a command.
    To a controller without a model the car then looks as if it had neither delay nor lag, and damping that fought these
    is no longer wanted: see `delayed_stanley`. For a linear law this is what delay states give an LQR.

    Inputs: e [m], psi_e [rad] and preview [1/m] (kappa every preview_dt of driving) at `reference`; v [m/s]; r [rad/s];
    delta_sw_meas [rad]. Output: delta_sw [rad]. State: that of the wrapped block, r_m, then the commands on their way,
    oldest first; one that is not finite never left, so the wheel's angle stands in for it. A negative v counts as 0.
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
    reference: Scalar = 1.2
    """Where e, psi_e and the preview are measured: metres ahead of the centre of gravity."""
    preview_points: int = 1
    """Entries of the preview; (delay + lag)/preview_dt + 2 or more see the whole way."""
    preview_dt: float = DT
    """Time between them [s]."""

    def __post_init__(self) -> None:
        where, have = "Predicted", {p.name for p in self.inputs} - {"preview"} | {"kappa"}
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
        for name in ("wheelbase", "steer_ratio", "rate_limit", "yaw_time", "preview_dt"):
            require(getattr(self, name) > 0.0, where, f"{name} = {getattr(self, name)}, expected > 0")
        require(self.preview_points >= 1, where, f"preview_points = {self.preview_points}, expected >= 1")

    @classmethod
    def around(cls, block: Block, vehicle: Vehicle, *, delay: float, lag: float) -> Predicted:
        """`block` told of a steering delay and lag [s], with geometry, tyres and ratio of a `Vehicle`."""
        L = vehicle.wheelbase
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
            reference=getattr(block, "reference", 0.0),
            preview_points=int((delay + lag) / block.dt + 1e-9) + 2,
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

    @cached_property
    def _inner(self) -> Any:
        """What makes the wrapped block's state from its entries, and how many these are."""
        like = self.block.init()
        return getattr(type(like), "_make", tuple), len(like)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*self.block.init(batch), *[m.filled(0.0, batch)] * (1 + self._waiting))

    def settle(self, t: float, x: State, u: Any) -> State:
        make, n = self._inner
        added = (u.r + 0.0, *[u.delta_sw_meas + 0.0] * self._waiting)
        return (*self.block.settle(t, make(x[:n]), self._ahead(self.block.D, (*x[:n], *added), u)), *added)

    def output(self, t: Any, x: State, u: Any) -> Any:
        make, n = self._inner
        return self.Y(self.block.output(t, make(x[:n]), self._ahead(self.block.D, x, u)).delta_sw)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        make, n = self._inner
        inner = self.block.update(t, make(x[:n]), self._ahead(self.block.U, x, u), self.block.Y(y.delta_sw))
        sent = m.where(m.is_finite(y.delta_sw), y.delta_sw, u.delta_sw_meas)
        steady, fade = self._yaw(m.maximum(u.v, 0.0))
        r = steady * m.tan(u.delta_sw_meas / self.steer_ratio)
        r = r + (x[n] - r) * m.exp(fade * self.dt)
        return (*inner, m.where(m.is_finite(r), r, 0.0), *x[n + 2 :], sent)

    def _ahead(self, ports: Any, x: State, u: Any) -> Any:
        """The wrapped block's inputs, `delay + lag` from now."""
        _, n = self._inner
        values = self.predict(x[n], x[n + 1 :], u)
        return ports(**{name: values[name] for name in ports._fields})

    def predict(self, r_model: Scalar, commands: State, u: Any) -> dict[str, Scalar]:
        """e, psi_e, kappa, v, r, delta_sw_meas when the next command has arrived; `commands` oldest first."""
        v = m.maximum(u.v, 0.0)
        e, psi_e, r, wheel = u.e, u.psi_e, u.r, u.delta_sw_meas
        wrong = r - r_model
        steady, fade = self._yaw(v)
        lever = self.reference + self.l_r - self.rear_slip * v * v
        for h, command, entry, share in self._steps:
            follow = 1.0 - float(np.exp(-h / self.lag)) if self.lag > 0.0 else 1.0
            step = self.rate_limit * h
            moved = m.clip(follow * (commands[command] - wheel), -step, step)
            r_steady = steady * m.tan((wheel + 0.5 * moved) / self.steer_ratio) + wrong
            r_after = r_steady + (r - r_steady) * m.exp(fade * h)
            kappa = u.preview[entry]
            if share > 0.0:
                kappa = kappa + share * (u.preview[entry + 1] - kappa)
            turn = 0.5 * (r + r_after)
            e_dot, psi_dot = self._drift(v, e, psi_e, turn, lever, kappa)
            e_dot, psi_dot = self._drift(v, e + 0.5 * h * e_dot, psi_e + 0.5 * h * psi_dot, turn, lever, kappa)
            e, psi_e, r, wheel = e + h * e_dot, psi_e + h * psi_dot, r_after, wheel + moved
        last = min(round((self.delay + self.lag) / self.preview_dt), self.preview_points - 1)
        return dict(e=e, psi_e=psi_e, kappa=u.preview[last], v=u.v, r=r, delta_sw_meas=wheel)

    def _yaw(self, v: Scalar) -> tuple[Scalar, Scalar]:
        """Steady yaw rate over tan(delta) [1/s], and the model's pole [1/s]."""
        return v / (self.wheelbase + self.understeer * v * v), -1.0 / (self.yaw_time * m.maximum(v, 0.5))

    @staticmethod
    def _drift(v: Scalar, e: Scalar, psi_e: Scalar, r: Scalar, lever: Scalar, kappa: Scalar) -> tuple[Scalar, Scalar]:
        """e' and psi_e'."""
        c, s, side = m.cos(psi_e), m.sin(psi_e), r * lever
        return v * s + side * c, r - kappa * (v * c - side * s) / m.maximum(1.0 - kappa * e, 0.2)


def delayed_stanley(vehicle: Vehicle, *, delay: float, lag: float, dt: float = DT) -> Predicted:
    """Stanley for a steering delay and lag [s], 0 to 0.3 s and about 0.1 s: predicted, with gains tuned for that.

    The gains are what `python -m benchmarks study tune_stanley` chose: with the prediction, damping only costs.
    """
    stanley = replace(Stanley.of(vehicle, dt=dt), k=3.0, k_d_yaw=0.0, k_d_steer=0.0)
    return Predicted.around(stanley, vehicle, delay=delay, lag=lag)


class Steering(NamedTuple):
    """What `identified` found: delay [s], lag [s], and the RMS of what they leave unexplained [rad]."""

    delay: float
    lag: float
    rms: float


def identified(t: Array, command: Array, wheel: Array, *, longest: float = 0.5) -> Steering:
    """Delay and lag of the steering from a log of commands and measured wheel angles.

    Least squares over wheel(t + dt) = wheel(t) + f (g command(t - delay) + o - wheel(t)) for delays 0, dt, ..., and
    between them (the command is held: a share of a sample is the mean of two); lag = -dt/log(1 - f). A ratio g and an
    offset o of their own take nothing from the delay. The delay is that of the least residual.

    t (T,) [s], even; command, wheel (T,) [rad]. longest [s]: largest delay tried. Valid where neither stops nor rate
    limit act, and the wheel is moved over the record. Raises ValueError for a record that is uneven, too short, not
    finite, or without movement. Source: Ljung 1999, section 4.2 (ARX).
    """
    t, command, wheel = (np.asarray(a, dtype=float) for a in (t, command, wheel))
    where = "identified"
    require(t.ndim == 1 and t.shape == command.shape == wheel.shape, where, "t, command, wheel of different shapes")
    require(np.isfinite([t, command, wheel]).all(), where, "the record holds a NaN or an infinity")
    dt = float(t[1] - t[0]) if len(t) > 1 else 0.0
    require(dt > 0.0 and np.allclose(np.diff(t), dt, rtol=1e-3), where, "t must rise in even steps")
    count = int(longest / dt + 1e-9) + 1
    require(len(t) > 3 * count + 10, where, f"{len(t)} samples, expected more than {3 * count + 10} for {longest} s")
    require(np.ptp(command) > 1e-3 and np.ptp(wheel) > 1e-3, where, "the wheel was not moved in this record")
    now, after = wheel[count:-1], wheel[count + 1 :]
    best: tuple[float, float, float] = (np.inf, 0.0, 0.0)
    for n in range(count):
        recent, older = (command[count - i : len(t) - 1 - i] for i in (n, n + 1))
        columns = np.column_stack((now, recent, older, np.ones_like(now)))
        coefficients, *_ = np.linalg.lstsq(columns, after, rcond=None)
        keep, a, b, _ = coefficients
        if not (0.0 <= keep < 1.0 and a + b > 0.0 and min(a, b) >= -0.2 * max(a, b)):
            continue  # no delay between n and n + 1 samples explains it, nor would it but for noise
        error = float(np.sqrt(np.mean((columns @ coefficients - after) ** 2)))
        lag = -dt / np.log(keep) if keep > 1e-9 else 0.0
        # the older command acts first, for `early`: its share is exp(-(dt - early)/lag) - exp(-dt/lag) of the whole
        share = min(max(0.0, b / (a + b)), 1.0)
        early = dt * share if lag < 1e-6 else dt + lag * np.log(share * (1.0 - keep) + keep)
        if error < best[0] - 1e-12:
            best = (error, n * dt + early, float(lag))
    require(np.isfinite(best[0]), where, f"no delay up to {longest} s explains the wheel; is it the right command?")
    return Steering(float(best[1]), best[2], best[0])
