"""Model predictive steering, with a linear and with the nonlinear motion of the car."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, NamedTuple, Self

import casadi
import numpy as np

from steerkit._support.errors import number, require
from steerkit.controllers.mpc.path_model import NX, V_HIGH, V_LOW, PathModel
from steerkit.controllers.mpc.programme import NOTHING, PREDICTION, SOLUTION, Programme, StageQp, Stages
from steerkit.controllers.stanley import Stanley
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.units import radians_of
from steerkit.estimators.vehicle_state import Rhs
from steerkit.task import STOP, TRIP
from steerkit.vehicles.rollout import on_their_way, slewed

SOLVED, PLAN, FALLBACK, HELD = 0.0, 1.0, 2.0, 3.0
"""Where a command came from: this sample's solution, an earlier one's plan, the fallback law, the command before."""
NO_FAULT, NOT_FINITE, FAILED, LATE, STANDING = 0.0, 1.0, 2.0, 3.0, 4.0
"""Why there is no solution: an input is NaN or infinite, the solver or its check failed, too late, too slow a car."""
_NOTHING = 1e9  # residual of a solution that is not finite
_BETA, _R = 0.8, 5.0  # rad and rad/s: no sensor that works reports more
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

    A solution is used only if the solver reports success, all is finite, and the optimality conditions hold to
    `tolerance`. Else, or when it comes later than `budget`, the plan of the last good solution is followed for
    `patience` samples; then `fallback`, by default Stanley, steers, with e, psi_e, r and the wheel as predicted for
    after the delay, as if its drive began in this sample. Where these cannot be predicted either (e, psi_e, v, r or the
    preview is not finite), the command is held. Below `v_stop`, in reverse too, it is held as well: there the wheel
    does not move the car sideways. All commands keep `limit` and `rate_limit`.

    Inputs: e [m], psi_e [rad] and preview [1/m] (curvatures at s + j*v*dt) at `reference`; v [m/s], beta [rad] and r
    [rad/s] of the centre of gravity; delta_sw_meas [rad], where the wheel is. Outputs: delta_sw [rad]; status [1]:
    where it came from, 0 solution, 1 plan, 2 fallback, 3 the command before; fault [1]: 0 none, 1 an input not finite,
    2 solver or check, 3 late, 4 standing; iterations [1] of the solver; milliseconds [1] since the inputs came;
    residual [1] of the optimality conditions, NaN for an input that is not finite, 1e9 for a solution that is not; plan
    [rad/s], the rates from this sample on. State: the commands on their way, the plan, the samples since its solution.
    valid: v from 0.5 to 40 m/s (beyond, the model of the nearest is used), curvature up to 0.25/m. Beyond e_reach, e
    counts as e_reach. A batch is solved car by car. Equal arguments give equal results, except for milliseconds (0 with
    clock=None) and for what a `budget` makes of them. A command that is replaced on its way to the wheel (while another
    controller steers) is not known here. Of compiled loops those in C and in generated Python run it, to the same
    commands, and milliseconds is 0 there; it has no symbolic form.
    errors: TypeError when it is compiled with a `budget`, since a compiled loop has no clock.
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
    steer_ratio: float = number(unit="1", above=0.0)
    """Steering-wheel angle over road-wheel angle [1]."""
    fallback: Stanley
    """The law that steers when there is no plan; with a `slew`, that of a car steered by torque, it bounds the rate."""
    reference: float = number(0.0, "m", low=-5.0, high=5.0)
    """Where e, psi_e and the preview are measured: metres ahead of the centre of gravity."""
    delay: float = number(0.0, "s", low=0.0, high=2.0)
    """From a command to the motor's answer [s]; any, not only multiples of dt."""
    lag: float = number(0.1, "s", low=0.0, high=1e6)
    """The motor's time constant [s]."""
    horizon: int = number(20, "1", low=2)
    """Samples over which is planned, from `delay` on."""
    q_e: float = number(1.0, "1/m^2", above=0.0)
    """Weight of e^2 [1/m^2]."""
    q_psi: float = number(0.1, "1", low=0.0, high=1e6)
    """Weight of the heading's deviation from steady cornering [1]."""
    q_r: float = number(0.0, "s^2", low=0.0, high=1e6)
    """Weight of the yaw rate's deviation from steady cornering [s^2]."""
    q_rate: float = number(2e-4, "s^2", above=0.0)
    """Weight of the command's rate [s^2]."""
    limit: float = number(STOP, "rad", above=0.0)
    """Largest |command| [rad]."""
    rate_limit: float = number(radians_of(500.0), "rad/s", above=0.0)
    """Largest rate of the command [rad/s]."""
    e_limit: float = number(TRIP, "m", above=0.0)
    """|e| [m] beyond which it costs extra."""
    a_y_limit: float = number(2.8, "m/s^2", above=0.0)
    """|a_y| [m/s^2] beyond which it costs extra; soft, so a little below the 3 m/s^2 of ISO 11270."""
    a_y_room: float = number(1.5, "m/s^2", low=0.0, high=1e6)
    """How much more |a_y| [m/s^2] than the path needs is free where it needs more than a_y_limit. With too little, a
    car that responds less than its model (ratio, offset) is not steered enough: 0.5 lost one at 9 m/s."""
    q_e_limit: float = number(10.0, "1/m^2", low=0.0, high=1e6)
    """Weight of (|e| - e_limit)^2 [1/m^2]."""
    q_a_y_limit: float = number(100.0, "s^4/m^2", low=0.0, high=1e6)
    """Weight of (|a_y| - a_y_limit)^2 [s^4/m^2]."""
    e_reach: float = number(1.0, "m", above=0.0)
    """Largest |e| that the programme sees [m]: it bounds the approach angle from further away."""
    tolerance: float = number(1e-5, "1", above=0.0)
    """Largest residual of the optimality conditions of a solution that is used."""
    budget: float | None = number(None, "s", above=0.0)
    """A solution later than this [s] is not used; None: any is, so that a simulation can be repeated."""
    patience: int = number(4, "1", low=1)
    """Samples for which an old plan is followed."""
    v_stop: float = number(0.1, "m/s", above=0.0)
    """Speed below which the command is held [m/s]."""
    clock: Callable[[], float] | None = time.perf_counter
    """Seconds, for milliseconds and the budget; None: no time is taken."""
    preview_points: int = field(init=False, default=0)
    """Entries of the preview: over the delay and the horizon."""

    class X(NamedTuple):
        """What `State` holds, unpacked: commands on their way, oldest first; planned rates; samples since solved."""

        commands: tuple[float, ...]
        plan: tuple[float, ...]
        age: float

    def __post_init__(self) -> None:
        super().__post_init__()
        require(isinstance(self.fallback, Stanley), type(self).__name__, "fallback of another kind than Stanley")
        timed = self.budget is None or self.clock is not None
        require(timed, type(self).__name__, f"budget = {self.budget} [s] needs a clock")
        object.__setattr__(self, "preview_points", math.ceil(_PACE * (len(self.spans) + self.horizon)) + 1)

    @classmethod
    def of(cls, car: Any, **settings: Any) -> Self:
        """The controller for a single-track plant (its `rhs` and `vehicle`), e at its front axle.

        delay, lag [s] are given among the settings, which are any fields. A `SteeringActuator` holds its angle for its
        own dt, which is half of that more delay. Raises ValueError for a car without a right-hand side.
        """
        expected = "no right-hand side to predict with, expected a plant such as NonlinearSingleTrack(vehicle=...)"
        require(hasattr(car, "rhs"), cls.__name__, f"{type(car).__name__} has {expected}")
        given: dict[str, Any] = dict(
            rhs=car.rhs,
            steer_ratio=float(car.vehicle.steer_ratio),
            reference=float(car.vehicle.l_f),
            limit=float(car.vehicle.delta_sw_max),
            fallback=Stanley.of(car.vehicle, dt=settings.get("dt", cls.dt)),
        )
        return cls(**(given | settings))

    @cached_property
    def spans(self) -> tuple[float, ...]:
        """For how long each command on its way still acts when one is given [s], oldest first."""
        return on_their_way(self.delay, self.dt)

    @property
    def waiting(self) -> int:
        """Commands to remember: those on their way when one is given, one at least."""
        return max(len(self.spans), 1)

    @cached_property
    def model(self) -> PathModel:
        """The car in path coordinates; its tables take a moment when first used."""
        return PathModel(self)

    @cached_property
    def qp(self) -> StageQp:
        """The quadratic programme of a sample."""
        return StageQp(self)

    @cached_property
    def programme(self) -> Programme:
        """From the state now to the rates that solve this sample's programme."""
        return Programme(self)

    @cached_property
    def _routine(self) -> m.Routine:
        programme = self.programme
        return m.Routine(name=type(self).__name__, size=programme.size, call=programme)

    def __getstate__(self) -> dict[str, Any]:
        """Its fields: what is made of them once holds a solver and its memory, and a copy makes its own."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def init(self, batch: tuple[int, ...] = ()) -> tuple[Any, ...]:
        zeros = (0.0,) * (self.waiting + self.horizon)
        return tuple([m.filled(value, batch) for value in (*zeros, float(self.patience))])

    def settle(self, t: float, x: tuple[Any, ...], u: Any) -> tuple[Any, ...]:
        self._routine(SOLUTION, *[1.0] * self.programme.given.size)  # makes tables and solver before they are needed
        n = self.waiting
        now = m.where(m.is_finite(u.delta_sw_meas), m.clip(u.delta_sw_meas, -self.limit, self.limit), 0.0)
        return (*((now,) * n), *x[n:])

    def update(self, t: Any, x: tuple[Any, ...], u: Any, y: Any) -> tuple[Any, ...]:
        n = self.waiting
        age = m.where(y.status == SOLVED, 0.0, x[-1] + 1.0)
        return (*x[1:n], y.delta_sw, *y.plan[1:], 0.0 * y.plan[0], age)

    def output(self, t: Any, x: tuple[Any, ...], u: Any) -> Any:
        """The outputs: of one car, or of a batch one by one."""
        values = (*x, *u[:6], *u.preview)
        if {*map(type, values)} == {float}:
            return self._one(x, u)
        if any(m.is_symbol(value) for value in values):
            if self.budget is not None:
                raise TypeError(f"budget = {self.budget} [s] needs a clock, which a compiled loop has not; valid: None")
            return self._one(x, u)
        cars, n = np.array(np.broadcast_arrays(*map(np.atleast_1d, values)), dtype=float).T.tolist(), len(x)
        each = [self._one(tuple(row[:n]), self.D(*row[n : n + 6], tuple(row[n + 6 :]))) for row in cars]
        if not any(map(np.ndim, values)):  # one car's, but not all Python floats
            return each[0]
        *columns, plans = zip(*each)
        return self.Y(*[np.array(column) for column in columns], tuple(np.array(plans).T))

    def _one(self, x: tuple[Any, ...], u: Any) -> Any:
        """The outputs for one car: of floats, or of symbols (then without a clock)."""
        clock = self.clock if x[0].__class__ is float else None
        start = clock() if clock is not None else 0.0
        state = self.X(x[: self.waiting], x[self.waiting : -1], x[-1])
        known = m.all_finite((u.e, u.psi_e, u.v, u.r, *u.preview))
        finite = m.both(known, m.all_finite((u.beta, u.delta_sw_meas)))
        moving = u.v >= self.v_stop
        wanted = m.where(m.both(finite, moving), SOLUTION, m.where(known, PREDICTION, NOTHING))
        success, iterations, residual, *found = self._routine(*self._asked(state, u, wanted))
        ahead, rates = tuple(found[: -self.horizon]), tuple(found[-self.horizon :])
        solved = m.both(success > 0.0, residual <= self.tolerance)
        fault = m.where(finite, m.where(moving, m.where(solved, NO_FAULT, FAILED), STANDING), NOT_FINITE)
        elapsed = clock() - start if clock is not None else 0.0
        if self.budget is not None:
            fault = m.where(m.both(fault == NO_FAULT, elapsed > self.budget), LATE, fault)
        plan = m.chosen(fault == STANDING, (0.0,) * self.horizon, state.plan)
        plan = m.chosen(fault == NO_FAULT, rates, plan)
        residual = m.where(m.is_finite(residual), residual, _NOTHING)
        residual = m.where(finite, m.where(moving, residual, 0.0), math.nan)
        command, status = self._command(state, u, fault, plan, ahead)
        return self.Y(command, status, fault, iterations, 1e3 * elapsed, residual, plan)

    def _asked(self, state: X, u: Any, wanted: Any) -> tuple[Any, ...]:
        """What the programme is asked: a broken beta or wheel angle is done without."""
        by_axis = self.model.sway_is_speed
        beta = m.clip(m.where(m.is_finite(u.beta), u.beta, 0.0), -_BETA, _BETA)
        wheel = m.where(m.is_finite(u.delta_sw_meas), u.delta_sw_meas, state.commands[0])
        cos_beta = m.cos(beta) if by_axis else 1.0
        v = m.clip(u.v * cos_beta, V_LOW, V_HIGH)
        measured = (
            m.clip(u.e, -self.e_reach, self.e_reach),
            m.clip(u.psi_e, -m.pi, m.pi),
            v * m.tan(beta) if by_axis else beta,
            m.clip(u.r, -_R, _R),
            m.clip(wheel, -self.limit, self.limit),
        )
        return (wanted, *measured, *state.commands, *state.plan, *u.preview, v, cos_beta, self._fastest(v))

    def _command(self, state: X, u: Any, fault: Any, plan: tuple[Any, ...], ahead: tuple[Any, ...]) -> tuple[Any, Any]:
        """The command and where it came from; ahead: as a programme tells."""
        last, step = state.commands[-1], self._fastest(u.v) * self.dt
        good, planned = fault == NO_FAULT, m.either(fault == NO_FAULT, state.age < self.patience)
        target = last + self.dt * plan[0]
        if planned is not True:
            target = m.where(planned, target, self._fallback(u, ahead))
        status = m.where(good, SOLVED, m.where(planned, PLAN, FALLBACK))
        turned = m.clip(m.clip(target, last - step, last + step), -self.limit, self.limit)
        moves = m.both(fault != STANDING, m.is_finite(target))
        return m.where(moves, turned, last), m.where(moves, status, HELD)

    def _fallback(self, u: Any, ahead: tuple[Any, ...]) -> Any:
        """What the fallback commands [rad], as if its drive began in this sample; NaN if it cannot tell.

        ahead: the state of a stage, with e and psi_e at `reference`, and the curvature [1/m] there.
        """
        known = m.all_finite((u.e, u.psi_e, u.v, u.r, *u.preview))
        e, psi_e, _, r, wheel, _, kappa = ahead
        lead, v = self.fallback.reference - self.reference, m.where(known, u.v, 0.0)
        e, psi_e = e + lead * (psi_e - 0.5 * kappa * lead), psi_e - kappa * lead
        seen = self.fallback.D(e=e, psi_e=psi_e, kappa=kappa, v=v, r=r, delta_sw_meas=wheel)
        fresh = self.fallback.settle(0.0, self.fallback.init(), seen)
        return m.where(known, self.fallback.output(0.0, fresh, seen).delta_sw, math.nan)

    def _fastest(self, v: Any) -> Any:
        """How fast a command may change [rad/s]; a car steered by torque is slow where little wheel does much."""
        if self.fallback.slew is None:
            return self.rate_limit
        return m.where(m.is_finite(v), m.minimum(slewed(self.fallback, v), self.rate_limit), self.rate_limit)

    def motion(self, plan: Any, x0: Any, v: Any, substeps: Any, kappa: Any, bends: Any, table: Any) -> Stages:
        """The motion from x0 (6,) over stages of curvatures kappa (N,), as x_k+1 = A_k x_k + B_k rate_k - gap_k.

        All are CasADi's symbols. plan (N,): the rates of the plan before; bends (6, N): steady cornering at these
        curvatures; table: the model's at this speed; substeps: which of the model's `all_substeps`. Returns A of the
        stages 1 to N-1 side by side, B of all; gap (6, N), where gap_0 holds A_0 x0 too; and at the soft stages
        a_y = row' x + offset, rows (6, n).
        """
        raise NotImplementedError


@dataclass(frozen=True, eq=False, kw_only=True)
class MPC(PredictiveSteering):
    """Model predictive steering with a motion that is linear about steady cornering, and varies with speed:

        x_{k+1} - x_ss(kappa_k) = A(v) (x_k - x_ss(kappa_k)) + B(v) rate_k,

    A, B the exact answer of `rhs`, linearised about straight driving, to a command held for dt; x_ss from the
    nonlinear `rhs`. So it is one convex programme a sample, and exact in steady bends. See `PredictiveSteering`.
    """

    def motion(self, plan: Any, x0: Any, v: Any, substeps: Any, kappa: Any, bends: Any, table: Any) -> Stages:
        n, soft = self.horizon, self.qp.soft
        a, b, row, _ = table
        gap = a @ bends - bends
        gap[:, 0] -= a @ x0
        offset = (v * bends[3, soft] - row.T @ bends[:, soft]).T
        return casadi.repmat(a, 1, n - 1), casadi.repmat(b, 1, n), gap, casadi.repmat(row, 1, len(soft)), offset


@dataclass(frozen=True, eq=False, kw_only=True)
class NonlinearMPC(PredictiveSteering):
    """Model predictive steering with the nonlinear motion, by one Gauss-Newton step a sample (real-time iteration).

    Prepare: the last plan, moved on by a sample, is driven from the predicted state with x_{k+1} = F(x_k, rate_k), F
    the nonlinear `rhs` by Runge-Kutta, and F and a_y are linearised along it. Feed back: one convex programme,

        x_{k+1} = F(xp_k, p_k) + A_k (x_k - xp_k) + B_k (rate_k - p_k),

    whose solution is the next plan; from sample to sample the plans converge. Both steps are taken within the
    sample: prepared with its own speed and preview, and together short against dt. See `PredictiveSteering`.
    source: Diehl, Bock, Schloeder 2005; Gros et al. 2020.
    """

    def motion(self, plan: Any, x0: Any, v: Any, substeps: Any, kappa: Any, bends: Any, table: Any) -> Stages:
        n, soft = self.horizon, self.qp.soft
        each = [self.model.affine_step(count).mapaccum(f"driven{count}", n) for count in self.model.all_substeps]
        driven = casadi.Function.conditional("driven", each, each[-1])(
            substeps, x0, plan.T, casadi.repmat(v, 1, n), kappa.T
        )
        _, a, b, gap, row, offset = driven
        gap[:, 0] -= a[:, :NX] @ x0
        return a[:, NX:], b, gap, row[:, soft], offset[soft].T
