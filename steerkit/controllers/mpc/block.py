"""Model predictive steering: what its kinds share."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from steerkit import maths as m
from steerkit.block import Block, In, Out
from steerkit.controllers.mpc.fallback import asked
from steerkit.controllers.mpc.path_model import KAPPA_HIGH, V_HIGH, V_LOW, Array, Motion, PathModel, Rhs, Table
from steerkit.controllers.mpc.qp import Answer, StageQp
from steerkit.controllers.mpc.settings import check
from steerkit.controllers.stanley import Stanley
from steerkit.errors import require
from steerkit.task import DT, STOP, TRIP
from steerkit.units import radians_of

SOLVED, PLAN, FALLBACK, HELD = 0.0, 1.0, 2.0, 3.0
"""Where a command came from: this sample's solution, an earlier one's plan, the fallback law, the command before."""
NO_FAULT, NOT_FINITE, FAILED, LATE, STANDING = 0.0, 1.0, 2.0, 3.0, 4.0
"""Why there is no solution: an input is NaN or infinite, the solver or its check failed, too late, too slow a car."""
_NOTHING = 1e9  # residual of a solution that is not finite
_BETA, _R = 0.8, 5.0  # rad and rad/s: no sensor that works has more to say
_PACE = 1.15  # in tight bends the front axle is that much faster than the centre of gravity


@dataclass(frozen=True, eq=False, kw_only=True)
class PredictiveSteering(Block):
    """Steering by a quadratic programme over the coming `horizon` samples; abstract.

    min  sum_k q_e e^2 + q_psi (psi_e - psi_ss)^2 + q_r (r - r_ss)^2 + q_rate rate^2  +  (x_N - x_ss)' P (x_N - x_ss)
    subject to the motion,  |rate| <= rate_limit,  |command| <= limit,  and softly  |e| <= e_limit, |a_y| <= a_y_limit
    (where the path at this speed needs more: that and a_y_room)

    over x = (e, psi_e, sway, r, wheel angle, command), from when the commands on their way have acted (`delay` [s]
    from now, predicted with the model) and with the curvature of the path ahead. x_ss(kappa, v) is steady cornering.
    P(v) is the Riccati solution without limits: while none is near, this is LQR with curve feed-forward, and the
    delay costs it nothing but the prediction. The motion is `rhs`, a plant's own, in path coordinates (`PathModel`).

    A solution leaves the block only if the solver reports success, all is finite, and the optimality conditions hold
    to `tolerance`. Else, or when it comes later than `budget`, the plan of the last good solution is followed for
    `patience` samples, then `fallback`, here Stanley, is asked with e, psi_e, r and the wheel as they will be after
    the delay, as if its drive began in this sample. When that cannot be formed either (e, psi_e, v, r or the preview
    is not finite), the command stays. Below `v_stop`, in reverse too, it stays as well: turning the wheel does not
    move the car sideways there. All commands keep `limit` and `rate_limit`.

    Inputs: e [m], psi_e [rad] and preview [1/m] (curvatures at s + j*v*dt) at `reference`; v [m/s], beta [rad] and
    r [rad/s] of the centre of gravity; delta_sw_meas [rad], where the wheel is. Outputs: delta_sw [rad]; status [1]:
    where it came from, 0 solution, 1 plan, 2 fallback, 3 the command before; fault [1]: 0 none, 1 an input not
    finite, 2 solver or check, 3 late, 4 standing; iterations [1] of the solver; milliseconds [1] since the inputs
    came; residual [1] of the optimality conditions, NaN for an input that is not finite, 1e9 for a solution that is
    not; plan [rad/s], the rates from this sample on. State: the commands on their way, the plan, the samples since
    its solution.
    valid: v from 0.5 to 20 m/s (beyond, the model of the nearest is used), curvature up to 0.25/m. From e_reach on the
    path is taken to be that far away, whatever e is. A batch is solved car by car. Equal arguments give equal
    results, except for milliseconds (0 with clock=None) and for what a `budget` makes of them. A command replaced on
    its way to the wheel (by another controller in charge) is not known here. It cannot be traced: it runs a solver.
    errors: ValueError for bad parameters, and for a fallback with other ports than Stanley's.
    source: Rawlings, Mayne, Diehl 2017, sections 1.3 and 2.5; Frison, Diehl 2020 (HPIPM); Hoffmann et al. 2007.
    """

    e = In("m")
    psi_e = In("rad")
    v = In("m/s")
    beta = In("rad")
    r = In("rad/s")
    delta_sw_meas = In("rad")
    preview = In("1/m", size="preview_points")
    delta_sw = Out("rad")
    status = Out("1")
    fault = Out("1")
    iterations = Out("1")
    milliseconds = Out("1")
    residual = Out("1")
    plan = Out("rad/s", size="horizon")

    rhs: Rhs
    """The car's right-hand side: (x', y', psi', sway', r') of ((x, y, psi, sway, r), delta, v)."""
    steer_ratio: float
    """Steering-wheel angle over road-wheel angle [1]."""
    fallback: Block
    """Who steers when there is no plan: inputs among e, psi_e, kappa, v, r, delta_sw_meas, output delta_sw."""
    reference: float = 0.0
    """Where e, psi_e and the preview are measured: metres ahead of the centre of gravity."""
    delay: float = 0.0
    """From a command to the motor's answer [s]; any, not only multiples of dt."""
    lag: float = 0.1
    """The motor's time constant [s]."""
    horizon: int = 20
    """Samples over which is planned, from `delay` on."""
    q_e: float = 1.0
    """Weight of e^2 [1/m^2]."""
    q_psi: float = 0.1
    """Weight of the heading's deviation from steady cornering [1]."""
    q_r: float = 0.0
    """Weight of the yaw rate's deviation from steady cornering [s^2]."""
    q_rate: float = 2e-4
    """Weight of the command's rate [s^2]."""
    limit: float = STOP
    """Largest |command| [rad]."""
    rate_limit: float = radians_of(500.0)
    """Largest rate of the command [rad/s]."""
    slew: float | None = None
    """Fastest change of the lateral acceleration of a car steered by torque [m/s^3]: bounds the rate; None: none."""
    e_limit: float = TRIP
    """|e| [m] that costs extra beyond."""
    a_y_limit: float = 2.8
    """|a_y| [m/s^2] that costs extra beyond; soft, so a little below the 3 that are meant."""
    a_y_room: float = 1.5
    """How much more |a_y| [m/s^2] than the path needs is free where it needs more than a_y_limit. Too little, and a car
    that answers less than the model thinks (ratio, offset) is not steered enough: 0.5 lost one at 9 m/s."""
    q_e_limit: float = 10.0
    """Weight of (|e| - e_limit)^2 [1/m^2]."""
    q_a_y_limit: float = 100.0
    """Weight of (|a_y| - a_y_limit)^2 [s^4/m^2]."""
    e_reach: float = 1.0
    """The car is taken to be at most so far off [m]: from further away it comes at no steeper an angle."""
    soft_first: int = 4
    """The soft limits are asked for at the first so many samples, ..."""
    soft_every: int = 4
    """... and from there on at every so many: what is far is planned anew before it comes."""
    solver: str = "hpipm"
    """hpipm, piqp, or qpoases (condensed; for short horizons)."""
    tolerance: float = 1e-5
    """Largest residual of the optimality conditions that is let through."""
    budget: float | None = None
    """A solution later than this [s] is not used; None: any is, so that a simulation can be repeated."""
    patience: int = 4
    """Samples for which an old plan is followed."""
    v_stop: float = 0.1
    """Below this speed [m/s] the command stays."""
    clock: Callable[[], float] | None = time.perf_counter
    """Seconds, for milliseconds and the budget; None: no time is taken."""
    preview_points: int = field(init=False, default=0)
    """Curvatures wanted ahead: over the delay and the horizon."""
    preview_dt: float = field(init=False, default=DT)
    """Time between them [s]: dt."""

    class X(NamedTuple):
        """What `State` holds, unpacked: commands on their way, oldest first; planned rates; samples since solved."""

        commands: tuple[float, ...]
        plan: tuple[float, ...]
        age: float

    def __post_init__(self) -> None:
        check(self)
        object.__setattr__(self, "preview_points", math.ceil(_PACE * (self.pieces + self.horizon)) + 1)
        object.__setattr__(self, "preview_dt", self.dt)

    @classmethod
    def of(cls, car: Any, actuator: Any = None, **settings: Any) -> Self:
        """The controller for a single-track plant (its `rhs` and `vehicle`), e at its front axle.

        delay, lag [s] are given among the settings, which are any fields; or with an `actuator` to read them from, a
        `SteeringActuator`. That holds its angle for its own dt, which is half of that more delay. Raises ValueError
        for a car without a right-hand side.
        """
        expected = "no right-hand side to predict with, expected a plant such as NonlinearSingleTrack(vehicle=...)"
        require(hasattr(car, "rhs"), cls.__name__, f"{type(car).__name__} has {expected}")
        known = (
            {}
            if actuator is None
            else dict(
                delay=actuator.delay + 0.5 * actuator.dt,
                lag=float(actuator.lag),
                limit=min(float(actuator.limit), float(car.vehicle.delta_sw_max)),
                rate_limit=min(float(actuator.rate_limit), cls.rate_limit),
            )
        )
        base = dict(
            rhs=car.rhs,
            steer_ratio=float(car.vehicle.steer_ratio),
            reference=float(car.vehicle.l_f),
            limit=float(car.vehicle.delta_sw_max),
            fallback=Stanley.of(car.vehicle, dt=settings.get("dt", cls.dt)),
        )
        return cls(**(base | known | settings))

    # ---- what is made once --------------------------------------------------------------------------------------

    @property
    def pieces(self) -> int:
        """Commands on their way when one is given."""
        return math.ceil(self.delay / self.dt - 1e-9)

    @cached_property
    def model(self) -> PathModel:
        """The car in path coordinates; its tables take a moment when first used."""
        weights = (self.q_e, self.q_psi, self.q_r, self.q_rate)
        return PathModel(
            rhs=self.rhs,
            steer_ratio=self.steer_ratio,
            reference=self.reference,
            dt=self.dt,
            lag=self.lag,
            weights=weights,
        )

    @cached_property
    def qp(self) -> StageQp:
        """The programme, with all that stays the same filled in."""
        soft = tuple(self._soft.tolist())
        qp = StageQp(horizon=self.horizon, nx=6, solver=self.solver, soft=soft)
        d, at = qp.data, qp.place
        d["h"][at["q"]] = np.diag(self.model.stage_cost[0])
        d["h"][at["r"]] = self.q_rate
        d["h"][at["r_slack"]] = (self.q_e_limit, self.q_a_y_limit)
        for name, sign in (("lbx", -1.0), ("ubx", 1.0)):
            d[name][qp.at_u] = sign * self.rate_limit
            d[name][at["x"][:, 5]] = sign * self.limit
        d["a"][at["rows"][:, 0, 0]] = 1.0
        d["lba"][at["limit"][:, 0]], d["uba"][at["limit"][:, 0]] = -self.e_limit, self.e_limit
        return qp

    @cached_property
    def times(self) -> Array:
        """When a curvature is wanted [s]: half-way of each command on its way; at the stages; half-way between."""
        first = self.delay - max(self.pieces - 1, 0) * self.dt
        pieces = [0.5 * first, *[first + (i + 0.5) * self.dt for i in range(self.pieces - 1)]][: self.pieces]
        stages = [self.delay + k * self.dt for k in range(self.horizon + 1)]
        return np.array([*pieces, *stages, *[t + 0.5 * self.dt for t in stages[:-1]]])

    @cached_property
    def _entries(self) -> Array:
        return np.arange(float(self.preview_points))

    @cached_property
    def _predict(self) -> dict[int, Callable[..., Array]]:
        """By substeps: (x (5,), commands, v, curvatures) -> x (5,) when the commands on their way have acted."""
        n, first = self.pieces, self.delay - (self.pieces - 1) * self.dt
        return {k: self.model.prediction(n, first, k) for k in self.model.all_substeps}

    def _warm_up(self) -> None:
        """Drives a sample straight on, so that tables and solver are made before they are needed."""
        state = self.X((0.0,) * max(self.pieces, 1), (0.0,) * self.horizon, 0.0)
        self._solved(state, self.D(0.0, 0.0, 5.0, 0.0, 0.0, 0.0, (0.0,) * self.preview_points))

    # ---- a sample -------------------------------------------------------------------------------------------

    def init(self, batch: tuple[int, ...] = ()) -> tuple[Any, ...]:
        zeros = (0.0,) * (max(self.pieces, 1) + self.horizon)
        return tuple([m.filled(value, batch) for value in (*zeros, float(self.patience))])

    def settle(self, t: float, x: tuple[Any, ...], u: Any) -> tuple[Any, ...]:
        self._warm_up()
        n = max(self.pieces, 1)
        now = m.where(m.is_finite(u.delta_sw_meas), m.clip(u.delta_sw_meas, -self.limit, self.limit), 0.0)
        return (*((now,) * n), *x[n:])

    def update(self, t: Any, x: tuple[Any, ...], u: Any, y: Any) -> tuple[Any, ...]:
        n = max(self.pieces, 1)
        age = m.where(y.status == SOLVED, 0.0, x[-1] + 1.0)
        return (*x[1:n], y.delta_sw, *y.plan[1:], 0.0 * y.plan[0], age)

    def _steer(self, x: tuple[Any, ...], u: Any) -> Any:
        """The outputs: of one car, or of a batch one by one."""
        values = (*x, *u[:6], *u.preview)
        if {*map(type, values)} == {float}:
            return self._one(x, u)
        if any(m.is_symbol(value) for value in values):
            raise TypeError(f"{type(self).__name__} runs a solver, which has no symbolic form")
        cars = np.broadcast_shapes((1,), *[np.shape(value) for value in values])[0]
        states, scalars, previews = (
            np.array([np.broadcast_to(value, cars) for value in values], dtype=float).T.tolist()
            for values in (x, u[:6], u.preview)
        )
        each = [self._one(tuple(a), self.D(*b, tuple(c))) for a, b, c in zip(states, scalars, previews)]
        if not any(map(np.ndim, values)):  # one car's, but not all Python floats
            return each[0]
        *columns, plans = zip(*each)
        return self.Y(*[np.array(column) for column in columns], tuple(np.array(plans).T))

    def _one(self, x: tuple[float, ...], u: Any) -> Any:
        start = self.clock() if self.clock is not None else 0.0
        n = max(self.pieces, 1)
        state = self.X(x[:n], x[n:-1], x[-1])
        fault, iterations, residual, plan = NO_FAULT, 0.0, 0.0, state.plan
        if not all(map(math.isfinite, (*u[:6], *u.preview))):
            fault, residual = NOT_FINITE, math.nan
        elif u.v < self.v_stop:
            fault, plan = STANDING, (0.0,) * self.horizon
        else:
            answer = self._solved(state, u)
            iterations, residual = answer.iterations, answer.residual
            if not answer.success or not residual <= self.tolerance:
                fault, residual = FAILED, residual if math.isfinite(residual) else _NOTHING
            else:
                plan = tuple(answer.x[self.qp.at_u].tolist())
        elapsed = self.clock() - start if self.clock is not None else 0.0
        if fault == NO_FAULT and self.budget is not None and elapsed > self.budget:
            fault, plan = LATE, state.plan
        command, status = self._command(state, u, fault, plan)
        return self.Y(command, status, fault, iterations, 1e3 * elapsed, residual, plan)

    def _command(self, state: X, u: Any, fault: float, plan: tuple[float, ...]) -> tuple[float, float]:
        """The command and where it came from."""
        last, step = state.commands[-1], self._fastest(u.v) * self.dt
        if fault == STANDING:
            return last, HELD
        if fault == NO_FAULT or state.age < self.patience:
            target, status = last + self.dt * plan[0], SOLVED if fault == NO_FAULT else PLAN
        else:
            target, status = self._fallback(state, u), FALLBACK
        if not math.isfinite(target):
            return last, HELD
        return m.clip(m.clip(target, last - step, last + step), -self.limit, self.limit), status

    def _fallback(self, state: X, u: Any) -> float:
        """What the fallback commands [rad]; NaN if it cannot tell. A broken beta or wheel angle is done without."""
        if not all(map(math.isfinite, (u.e, u.psi_e, u.v, u.r, *u.preview))):
            return math.nan
        beta, wheel = (
            value if math.isfinite(value) else instead
            for value, instead in ((u.beta, 0.0), (u.delta_sw_meas, state.commands[0]))
        )
        _, x, then = self._ahead(state, u._replace(beta=beta, delta_sw_meas=wheel))
        return asked(self.fallback, self.reference, x, float(then[self.pieces, 6]), u.v)

    def _ahead(self, state: X, u: Any) -> tuple[float, Array, Array]:
        """v [m/s]; x (6,) when the commands on their way have acted; steady cornering and curvature at `times` (n, 7).

        An entry of the preview is v*dt further along the path than that before, where the point that follows it gets
        to at the pace of steady cornering.
        """
        n, by_axis = self.pieces, self.model.sway_is_speed
        beta = m.clip(u.beta, -_BETA, _BETA)
        cos_beta = m.cos(beta) if by_axis else 1.0
        v = m.clip(u.v * cos_beta, V_LOW, V_HIGH)
        preview = np.minimum(np.maximum(u.preview, -KAPPA_HIGH), KAPPA_HIGH)
        rows = self.model.steady(v, preview)
        half = 0.5 * self.dt / (cos_beta * rows[:, 6])  # of the time from an entry to the next
        rows[:, 6] = preview
        at = np.interp(self.times, 2.0 * np.cumsum(half) - half - half[0], self._entries)
        j = np.minimum(at.astype(np.intp), len(rows) - 2)
        low = rows[j]
        then = low + (at - j)[:, None] * (rows[j + 1] - low)
        e, psi_e = m.clip(u.e, -self.e_reach, self.e_reach), m.clip(u.psi_e, -m.pi, m.pi)
        wheel = m.clip(u.delta_sw_meas, -self.limit, self.limit)
        measured = (e, psi_e, v * m.tan(beta) if by_axis else beta, m.clip(u.r, -_R, _R), wheel)
        x = np.empty(6)
        x[:5] = self._predict[self.model.substeps(v)](measured, state.commands, v, then[:n, 6])
        x[5] = state.commands[-1]
        return v, x, then

    def _solved(self, state: X, u: Any) -> Answer:
        """This sample's programme, filled and solved."""
        v, x0, then = self._ahead(state, u)
        goal, between = then[self.pieces :][: self.horizon + 1, :6], then[self.pieces + self.horizon + 1 :]
        table = self.model.at(v)
        terminal = table[3]
        d, at, soft = self.qp.data, self.qp.place, self._soft
        a, b, gap, row, offset = self._motion(state, x0, v, between[:, 6], between[:, :6], table)
        d["a"][at["a"]], d["a"][at["b"]] = a, b
        d["lba"][at["gap"]] = d["uba"][at["gap"]] = gap
        path = v * goal[soft, 3]
        d["a"][at["rows"][:, 1]] = row
        d["lba"][at["limit"][:, 1]] = np.minimum(-self.a_y_limit, path - self.a_y_room) - offset
        d["uba"][at["limit"][:, 1]] = np.maximum(self.a_y_limit, path + self.a_y_room) - offset
        if self.slew is not None:
            d["ubx"][self.qp.at_u] = self._fastest(v)
            d["lbx"][self.qp.at_u] = -self._fastest(v)
        d["h"][at["p"]] = terminal
        d["g"][at["x"][:-1]] = self._minus_q * goal[1:-1]
        d["g"][at["x"][-1]] = -terminal @ goal[-1]
        return self.qp.solve()

    def _fastest(self, v: float) -> float:
        """How fast a command may change [rad/s]; a car steered by torque is slow where little wheel does much."""
        if self.slew is None or not math.isfinite(v):
            return self.rate_limit
        return min(self.rate_limit, self.slew * self.model.per_a_y(v))

    @cached_property
    def _soft(self) -> Any:
        """The stages at which the soft limits are asked for."""
        near = self.soft_first
        stages = [*range(1, near + 1), *range(near + self.soft_every, self.horizon, self.soft_every)]
        return np.array([k for k in stages if k < self.horizon], dtype=np.intp)

    @cached_property
    def _minus_q(self) -> Array:
        return -np.diag(self.model.stage_cost[0])

    def _motion(self, state: X, x0: Array, v: float, kappa: Array, bends: Array, table: Table) -> Motion:
        """The motion from x0 over stages of curvatures kappa (N,), as x_k+1 = A_k x_k + B_k rate_k - gap_k.

        bends (N, 6): steady cornering at these curvatures; table: the model's at this speed. Returns A of the stages
        1 to N-1 and B of all (or one for all); gap (N, 6), where gap_0 holds A_0 x0 too; and at the soft stages
        a_y = row x + offset.
        """
        raise NotImplementedError
