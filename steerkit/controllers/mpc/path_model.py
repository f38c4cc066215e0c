"""A car's right-hand side in path coordinates, and all that predictive steering needs of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path as FilePath
from typing import Any

import casadi
import numpy as np
from scipy.linalg import expm

from steerkit._support.errors import require
from steerkit.controllers.lqr import cost_to_go
from steerkit.diagram import maths as m
from steerkit.diagram.maths import Array
from steerkit.estimators.vehicle_state import sway_is_speed

NX = 6
"""States of a stage: e, psi_e, sway, r, wheel angle, command."""
V_LOW, V_HIGH, V_STEP = 0.5, 40.0, 0.25
"""Speeds [m/s] between which the car is modelled, and how far apart the tabled ones are."""
SPEEDS = np.arange(V_LOW, V_HIGH + 0.5 * V_STEP, V_STEP)
"""The tabled speeds [m/s]."""
KAPPA_HIGH, KAPPA_STEP = 0.25, 0.005
"""Tabled curvatures [1/m]."""
CURVES = 2 * round(KAPPA_HIGH / KAPPA_STEP) + 1
"""How many curvatures are tabled."""
_STEEPEST = 1.2  # rad: no road wheel turns further, so steady cornering has no larger |psi_e| either
_LEAST_LAG = 1e-3  # s: a motor without lag follows this fast


@dataclass(frozen=True, eq=False)
class PathModel:
    """A point of the car on a path of curvature kappa, at constant speed, the wheel following a command with a lag.

    With (x', y', psi', sway', r') = rhs((0, e, psi_e, sway, r), delta_sw/steer_ratio, v), which is the motion seen
    from the path's tangent,

        along = x' - reference psi' sin(psi_e),  e' = y' + reference psi' cos(psi_e),
        psi_e' = psi' - kappa along/(1 - kappa e),  lag delta_sw' = command - delta_sw.

    law: the `PredictiveSteering` with `rhs` (see `Rhs`), steer_ratio, reference, dt, lag and weights.
    """

    law: Any

    @cached_property
    def sway_is_speed(self) -> bool:
        """See `steerkit.estimators.vehicle_state.sway_is_speed`."""
        return sway_is_speed(self.law.rhs)

    def motion(self, z: Sequence[Any], delta_sw: Any, v: Any, kappa: Any) -> tuple[Any, ...]:
        """(e, psi_e, sway, r)', and the speed along the path's tangent [m/s]."""
        if m.is_symbol(v):
            _ = self._same_on_symbols
        e, psi_e, sway, r = z
        x, y, psi, sway_dot, r_dot = self.law.rhs((0.0 * e, e, psi_e, sway, r), delta_sw / self.law.steer_ratio, v)
        along = x - self.law.reference * psi * m.sin(psi_e)
        drift = y + self.law.reference * psi * m.cos(psi_e)
        return drift, psi - kappa * along / (1.0 - kappa * e), sway_dot, r_dot, along

    def a_y(self, z: Sequence[Any], delta_sw: Any, v: Any) -> Any:
        """Lateral acceleration at the centre of gravity [m/s^2]: v_y' + v r, or v (beta' + r)."""
        sway_dot = self.motion(z, delta_sw, v, 0.0)[2]
        return (sway_dot if self.sway_is_speed else v * sway_dot) + v * z[3]

    @cached_property
    def _field(self) -> casadi.Function:
        """(e, psi_e, sway, r)' (4,) and its slope (4, 5), of (e, psi_e, sway, r, wheel), v, kappa."""
        x, v, kappa = casadi.SX.sym("x", 5), casadi.SX.sym("v"), casadi.SX.sym("k")
        motion = casadi.vertcat(*self.motion([x[i] for i in range(4)], x[4], v, kappa)[:4])
        return casadi.Function("field", [x, v, kappa], [motion, casadi.jacobian(motion, x)])

    @cached_property
    def _same_on_symbols(self) -> bool:
        """Raises ValueError for an rhs that fails on CasADi's symbols, or gives something else on them than on numbers,
        as one does with `math`, which takes a symbol for a NaN."""
        rhs, x, u, point = self.law.rhs, casadi.SX.sym("x", 5), casadi.SX.sym("u", 2), (0.0, 0.02, -0.03, 0.01, 0.05)
        try:
            made = casadi.Function("rhs", [x, u], [casadi.vertcat(*rhs(casadi.vertsplit(x), u[0], u[1]))])
            found, numbers = made(point, (0.02, 6.0)).full()[:, 0], np.array(rhs(point, 0.02, 6.0), dtype=float)
            same = found.shape == numbers.shape and np.allclose(found, numbers, rtol=1e-9, atol=1e-9)
            wrong = "" if same else f"gives {found} on symbols, {numbers} on numbers"
        except (TypeError, ValueError, RuntimeError) as error:
            wrong = f"cannot be run on symbols: {' '.join(str(error).split())[:150]}"
        code = getattr(rhs, "__code__", None)
        place = f" (line {code.co_firstlineno} of {FilePath(code.co_filename).name})" if code else ""
        cure = "write it with steerkit.diagram.maths and arithmetic: no math.*, no numpy, m.where instead of `if`"
        require(not wrong, type(self.law).__name__, f"rhs{place} {wrong}; {cure}")
        return True

    def stepped(self, x: Any, command: Any, v: Any, kappa: Any, h: Any, steps: int) -> tuple[Any, Any]:
        """(e, psi_e, sway, r, wheel) some steps of `h` [s] later, and its slope (5, 6) in these five and the command.

        Runge-Kutta for the car, the exact answer for the wheel; the slope by the chain rule through the stages, which
        is as exact as CasADi's and takes half the operations.
        """
        z, wheel = x[:4], x[4]
        dz, dwheel, dcommand = casadi.SX.eye(6)[:4, :], casadi.SX.eye(6)[4, :], casadi.SX.eye(6)[5, :]
        decay = m.exp(-0.5 * h / max(self.law.lag, _LEAST_LAG))
        for _ in range(steps):
            middle, dmiddle = command + (wheel - command) * decay, dcommand + (dwheel - dcommand) * decay
            end, dend = command + (middle - command) * decay, dcommand + (dmiddle - dcommand) * decay
            after, dafter, k, dk = z, dz, casadi.SX.zeros(4), casadi.SX.zeros(4, 6)
            for reach, share, w, dw in (
                (0.0, 1.0, wheel, dwheel),
                (0.5, 2.0, middle, dmiddle),
                (0.5, 2.0, middle, dmiddle),
                (1.0, 1.0, end, dend),
            ):
                rate, slope = self._field(casadi.vertcat(z + reach * h * k, w), v, kappa)
                k, dk = rate, slope[:, :4] @ (dz + reach * h * dk) + slope[:, 4] @ dw
                after, dafter = after + share * h / 6.0 * k, dafter + share * h / 6.0 * dk
            z, dz, wheel, dwheel = after, dafter, end, dend
        return casadi.vertcat(z, wheel), casadi.vertcat(dz, dwheel)

    def predictor(self, spans: Sequence[float], substeps: int) -> casadi.Function:
        """(e, psi_e, sway, r, wheel) when the commands on their way have acted, each for its span [s].

        inputs: x (5,), commands, v, curvatures; as many commands and curvatures as spans.
        """
        pieces = len(spans)
        x, command, v, kappa, h = (casadi.SX.sym(name, n) for name, n in zip("xcvkh", (5, 1, 1, 1, 1)))
        after = casadi.cse(self.stepped(x, command, v, kappa, h, 1)[0])
        single = casadi.Function("single", [x, command, v, kappa, h], [after])
        steps = [max(1, math.ceil(substeps * span / self.law.dt - 1e-9)) for span in spans]
        each = np.repeat(np.arange(pieces), steps).tolist()
        start, speed = casadi.MX.sym("x", 5), casadi.MX.sym("v")
        commands, curves = casadi.MX.sym("c", pieces), casadi.MX.sym("k", pieces)
        each_h = casadi.DM([[spans[i] / steps[i] for i in each]])
        run = single.mapaccum(f"pieces{substeps}", len(each))
        states = run(start, commands[each].T, casadi.repmat(speed, 1, len(each)), curves[each].T, each_h)
        return casadi.Function(f"predict{substeps}", [start, commands, speed, curves], [states[:, -1]])

    def affine_step(self, substeps: int) -> casadi.Function:
        """The stage map F(x, rate) of the six states, linearised: x+ = A x + B rate - gap and a_y = row x + offset.

        inputs: x (6,), rate, v, kappa; outputs: F (6,), A (6, 6), B (6,), gap (6,), row (6,), offset.
        """
        x, u, v, kappa = casadi.SX.sym("x", NX), *(casadi.SX.sym(name) for name in "uvk")
        command = x[5] + self.law.dt * u
        after, slope = self.stepped(x[:5], command, v, kappa, self.law.dt / substeps, substeps)
        after, slope = casadi.vertcat(after, command), casadi.vertcat(slope, casadi.SX.eye(6)[5, :])
        b, a_y = self.law.dt * slope[:, 5], self.a_y([x[i] for i in range(4)], x[4], v)
        row = casadi.jacobian(a_y, x)
        results = [after, slope, b, slope @ x + b * u - after, row.T, a_y - row @ x]
        return casadi.Function("affine", [x, u, v, kappa], casadi.cse([casadi.densify(one) for one in results]))

    @cached_property
    def _slopes(self) -> casadi.Function:
        """d(e, psi_e, sway, r)'/d(e, psi_e, sway, r, wheel) (4, 5) and d a_y (1, 5) in straight driving at speed v."""
        x, v = casadi.SX.sym("x", 5), casadi.SX.sym("v")
        z = [x[i] for i in range(4)]
        rows = casadi.vertcat(*self.motion(z, x[4], v, 0.0)[:4]), self.a_y(z, x[4], v)
        slopes = [casadi.substitute(casadi.jacobian(row, x), x, casadi.DM.zeros(5)) for row in rows]
        return casadi.Function("slopes", [v], [casadi.densify(slope) for slope in slopes])

    @cached_property
    def _substeps(self) -> list[int]:
        """Runge-Kutta steps a period between the tabled speeds; h times the fastest rate: 2.3 (unstable from 2.785)."""
        rates = np.array([np.abs(np.linalg.eigvals(self._slopes(v)[0].full()[:, :4])).max() for v in SPEEDS])
        needed = np.maximum(np.ceil(self.law.dt * rates / 2.3), 2.0).astype(int)
        return np.maximum(needed[1:], needed[:-1]).tolist()

    @property
    def all_substeps(self) -> list[int]:
        """The numbers of steps that some speed needs."""
        return sorted(set(self._substeps))

    def which_substeps(self, v: Any) -> Any:
        """Which of `all_substeps` a period needs at speed v, a symbol: a slow car's tyres answer faster."""
        which = casadi.MX([self.all_substeps.index(n) for n in self._substeps])
        return which[casadi.fmin(casadi.floor((_within(v) - V_LOW) / V_STEP), len(SPEEDS) - 2.0)]

    def linear(self, v: float) -> tuple[Array, Array, Array]:
        """A (6, 6), B (6,), and the row of a_y (6,), about straight driving at v: the exact answer to held commands.

        x(t + dt) = A x + B rate, where the command that acts from t on is already command(t) + dt*rate.
        """
        return _linear(self._slopes, v, self.law.lag, self.law.dt)

    @cached_property
    def _schedule(self) -> casadi.Function:
        """A, B, the row of a_y, and P of the cost to go, by rows (84,), of v: a cubic spline between the speeds."""
        weights = *self.law.qp.q.full().ravel().tolist(), self.law.q_rate
        return _scheduled(self._slopes.serialize(), self.law.lag, self.law.dt, weights)

    def schedule(self, v: Any) -> tuple[Any, Any, Any, Any]:
        """A (6, 6), B (6,), row of a_y (6,) and P (6, 6) at a speed, a number or a symbol."""
        a, b, row, p = casadi.vertsplit(self._schedule(_within(v)), np.cumsum([0, NX * NX, NX, NX, NX * NX]).tolist())
        return casadi.reshape(a, NX, NX).T, b, row, casadi.reshape(p, NX, NX).T

    @cached_property
    def _steady(self) -> Array:
        """(speeds, curvatures from -0.25/m up, 7): steady cornering; see `cornering`."""
        w = casadi.SX.sym("w", 4)
        v, kappa = casadi.SX.sym("v"), casadi.SX.sym("k")
        *motion, along = self.motion([casadi.SX(0.0), w[0], w[1], w[2]], w[3], v, kappa)
        residual = casadi.vertcat(*motion)
        after = w - casadi.solve(casadi.jacobian(residual, w), residual)
        newton = casadi.Function("newton", [w, v, kappa], [after, casadi.mmax(casadi.fabs(residual)), along / v])
        return _steady_cornering(newton.serialize(), self.law.steer_ratio)

    @cached_property
    def _corners(self) -> casadi.Function:
        """Steady cornering (7,) of (v, kappa), linear between the tabled speeds and curvatures."""
        grid = [SPEEDS.tolist(), np.linspace(-KAPPA_HIGH, KAPPA_HIGH, CURVES).tolist()]
        values = self._steady.swapaxes(0, 1).ravel().tolist()
        return casadi.interpolant("corners", "linear", grid, values, {"lookup_mode": ["exact", "exact"]})

    def cornering(self, v: Any, kappa: Any) -> Any:
        """(7, n): the six states that hold curvatures kappa (n,) [1/m] at speed v for ever, e = 0; and s'/v."""
        n = kappa.shape[0]
        at = casadi.vertcat(casadi.repmat(_within(v), 1, n), casadi.fmin(casadi.fmax(kappa, -KAPPA_HIGH), KAPPA_HIGH).T)
        return self._corners.map(n)(at)


def _linear(slopes: casadi.Function, v: float, lag: float, dt: float) -> tuple[Array, Array, Array]:
    """What `PathModel.linear` says, of its `_slopes`."""
    slope, row = (value.full() for value in slopes(v))
    lag = max(lag, _LEAST_LAG)
    flow = np.zeros((NX, NX))
    flow[:4, :5] = slope
    flow[4, 4], flow[4, 5] = -1.0 / lag, 1.0 / lag
    a = expm(flow * dt)
    return a, dt * a[:, 5], np.append(row, 0.0)


@lru_cache(maxsize=64)
def _scheduled(slopes: str, lag: float, dt: float, weights: tuple[float, ...]) -> casadi.Function:
    """`PathModel._schedule`: the same for all dead times of a car, of which an adaptive controller has a law each.

    slopes: CasADi's text of `PathModel._slopes`. weights: of the states (36,), and of the command's rate.
    """
    made, values = casadi.Function.deserialize(slopes), []
    *q, q_rate = weights
    for v in SPEEDS:
        a, b, row = _linear(made, float(v), lag, dt)
        values.append(np.concatenate([a.ravel(), b, row, cost_to_go(a, b, np.reshape(q, (NX, NX)), q_rate).ravel()]))
    return casadi.interpolant("schedule", "bspline", [SPEEDS.tolist()], np.ravel(values).tolist())


@lru_cache(maxsize=64)
def _steady_cornering(newton: str, steer_ratio: float) -> Array:
    """Steady cornering at all tabled speeds and curvatures by Newton's method from straight, for `PathModel._steady`.

    newton: CasADi's text of the step (psi_e, sway, r, wheel), v, kappa -> the next four, |residual|, s'/v; the text,
    so that cars which move alike share a table, whoever made them. Where the tyres cannot hold a curvature, the row is
    that of the largest which they can.
    """
    step, all_speeds = casadi.Function.deserialize(newton).map(len(SPEEDS)), SPEEDS[None, :]
    rows, good = [np.zeros((len(SPEEDS), 5))], np.ones(len(SPEEDS), dtype=bool)
    rows[0][:, 4] = 1.0
    for kappa_i in np.arange(KAPPA_STEP, KAPPA_HIGH + 0.5 * KAPPA_STEP, KAPPA_STEP):
        guess = 2.0 * rows[-1] - rows[-2] if len(rows) > 1 else rows[-1]
        for _ in range(8):
            solution, error, pace = step(guess[:, :4].T, all_speeds, np.full_like(all_speeds, kappa_i))
            guess = np.vstack((solution.full(), pace.full())).T
        with np.errstate(invalid="ignore"):
            more = np.abs(guess[:, 3]) > np.abs(rows[-1][:, 3])  # not past the tyres' best
            steep = np.abs(guess[:, [0, 3]] / (1.0, steer_ratio)).max(axis=1)  # Newton may leap to another turn of both
            good = good & more & (error.full()[0] < 1e-8) & (steep < _STEEPEST)
        rows.append(np.where(good[:, None], guess, rows[-1]))
    left = np.array(rows).swapaxes(0, 1)
    right = left[:, :0:-1] * (-1.0, -1.0, -1.0, -1.0, 1.0)
    psi_e, sway, r, wheel, pace = np.moveaxis(np.concatenate((right, left), axis=1), 2, 0)
    table = np.stack((0.0 * psi_e, psi_e, sway, r, wheel, wheel, pace), axis=2)
    table.flags.writeable = False
    return table


def _within(v: Any) -> Any:
    """A speed among the tabled ones."""
    return casadi.fmin(casadi.fmax(v, V_LOW), V_HIGH)
