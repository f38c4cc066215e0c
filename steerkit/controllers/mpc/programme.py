"""A sample of predictive steering on numbers: prediction over the delay, path ahead, motion, programme, solution."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi
import numpy as np

from steerkit.controllers.mpc.path_model import KAPPA_HIGH, NX
from steerkit.diagram.maths import Array

FAR = 1e4
"""Stands for no bound: HPIPM needs 20 times longer with its own 1e8."""
DATA = ("h", "g", "a", "lba", "uba", "lbx", "ubx")
"""The numbers of a programme by CasADi's names: min 1/2 z'Hz + g'z,  lba <= A z <= uba,  lbx <= z <= ubx."""
_SOFT_FIRST, _SOFT_EVERY = 4, 4
"""The soft limits hold at the first so many samples, and from there on at every so many."""
_HPIPM = {"mode": "speed", "iter_max": 40, "mu0": 1e-4} | dict.fromkeys(
    ("res_g_max", "res_b_max", "res_d_max", "res_m_max"), 1e-7
)


class Statement(NamedTuple):
    """A programme in CasADi's form: what changes from sample to sample -> `DATA`; the number of entries of each u_k;
    where in z the rates are, and the states x_1, ..., x_N, one after the other."""

    data: casadi.Function
    inputs: list[int]
    rates: list[int]
    states: list[int]


@dataclass(frozen=True, eq=False)
class StageQp:
    """The quadratic programme over z = (u_0, x_1, u_1, ..., u_N-1, x_N), with `NX` states in x_k:

        min  sum_k 1/2 x_k' Q x_k + slope_k' x_k + 1/2 q_rate rate_k^2 + 1/2 slack_k' S slack_k   (at x_N: P for Q)
        x_{k+1} = A_k x_k + B_k rate_k - gap_k,  |rate_k| <= fastest,  |x_k[5]| <= limit,
        |x_k[0] - slack_k[0]| <= e_limit,  low_k <= row_k' x_k - slack_k[1] <= high_k   at the stages `soft`.

    u_k is the rate and, at the stages `soft`, two slacks: a slack of either sign, which costs its square, takes up what
    a limit cannot hold. x_0 is known; A_0 x_0 stands in gap_0. law: the `PredictiveSteering` with weights and limits.
    """

    law: Any

    @cached_property
    def soft(self) -> list[int]:
        """The stages with soft limits: near ones all, then some, since what is far is planned anew before it comes."""
        far = range(_SOFT_FIRST + _SOFT_EVERY, self.law.horizon, _SOFT_EVERY)
        return [k for k in (*range(1, _SOFT_FIRST + 1), *far) if k < self.law.horizon]

    @property
    def q(self) -> casadi.DM:
        """Q (6, 6)."""
        return casadi.diag(casadi.DM([self.law.q_e, self.law.q_psi, 0.0, self.law.q_r, 0.0, 0.0]))

    @cached_property
    def statement(self) -> Statement:
        """Its function is of a (6, 6(N-1)), b, gap, slope (6, N), row (6, n), low, high (n,), p (6, 6), fastest."""
        n, soft, sx = self.law.horizon, len(self.soft), casadi.SX
        a, (b, gap, slope) = sx.sym("a", NX, NX * (n - 1)), (sx.sym(name, NX, n) for name in ("b", "gap", "slope"))
        row, low, high = sx.sym("row", NX, soft), sx.sym("low", soft), sx.sym("high", soft)
        p, fastest = sx.sym("p", NX, NX), sx.sym("fastest")
        q, q_slack = self.q, casadi.diag(casadi.DM([self.law.q_e_limit, self.law.q_a_y_limit]))
        z, bound, held, lower, upper = sx(0, 1), sx(0, 1), sx(0, 1), sx(0, 1), sx(0, 1)
        inputs, rates, states = list[int](), list[int](), list[int]()
        cost, x = sx(0), sx(NX, 1)
        for k in range(n):
            rate, slack, after = sx.sym("rate"), sx.sym("slack", 2 if k in self.soft else 0), sx.sym("x", NX)
            inputs.append(1 + slack.shape[0])
            rates.append(z.shape[0])
            states += range(z.shape[0] + inputs[k], z.shape[0] + inputs[k] + NX)
            moved = b[:, k] * rate - after + (a[:, NX * (k - 1) : NX * k] @ x if k else 0)
            cost += 0.5 * self.law.q_rate * rate**2 + casadi.dot(slope[:, k], after)
            cost += 0.5 * casadi.bilin(p if k == n - 1 else q, after, after)
            held = casadi.vertcat(held, moved)
            lower, upper = casadi.vertcat(lower, gap[:, k]), casadi.vertcat(upper, gap[:, k])
            if k in self.soft:
                i = self.soft.index(k)
                cost += 0.5 * casadi.bilin(q_slack, slack, slack)
                held = casadi.vertcat(held, x[0] - slack[0], casadi.dot(row[:, i], x) - slack[1])
                lower = casadi.vertcat(lower, -self.law.e_limit, low[i])
                upper = casadi.vertcat(upper, self.law.e_limit, high[i])
            z = casadi.vertcat(z, rate, slack, after)
            bound = casadi.vertcat(bound, fastest, FAR * sx.ones(slack.shape[0] + NX - 1), self.law.limit)
            x = after
        hessian, gradient = casadi.hessian(cost, z)
        gradient = casadi.densify(casadi.substitute(gradient, z, sx.zeros(z.shape[0])))
        numbers = [hessian, gradient, casadi.jacobian(held, z), lower, upper, -bound, bound]
        given = [a, b, gap, slope, row, low, high, p, fastest]
        return Statement(casadi.Function("data", given, numbers, [], list(DATA)), inputs, rates, states)

    @cached_property
    def solver(self) -> casadi.Function:
        """HPIPM; it says in its statistics whether it succeeded."""
        data, inputs, _, _ = self.statement
        options: dict[str, Any] = {
            "error_on_fail": False,
            "N": self.law.horizon,
            "nx": [0] + [NX] * self.law.horizon,
            "nu": [*inputs, 0],
            "ng": [*[i - 1 for i in inputs], 0],
            "inf": FAR,
            "hpipm": _HPIPM,
        }
        return casadi.conic("qp", "hpipm", {name: data.sparsity_out(name) for name in ("h", "a")}, options)

    @cached_property
    def solve(self) -> casadi.Function:
        """`DATA` -> z; and the largest violation of the optimality conditions, infinite if anything is not finite.

        The solver is wrapped, since HPIPM, called through a buffer of its own, keeps the vectors of its first call.
        """
        given = {name: casadi.MX.sym(name, self.statement.data.sparsity_out(name)) for name in DATA}
        answer = self.solver(**given)
        residual = violation(given, answer["x"], answer["lam_x"], answer["lam_a"])
        return casadi.Function("solve", list(given.values()), [answer["x"], residual], list(DATA), ["z", "residual"])


def violation(data: dict[str, Any], z: Any, lam_z: Any, lam_a: Any) -> Any:
    """The largest violation of the conditions under which z is the optimum, for the multipliers of its bounds and rows:

        H z + g + A' lam_a + lam_z = 0,  all bounds kept,  lam (value - its bound) = 0.

    Infinite where anything is not finite. data: symbols or matrices, named as in `DATA`.
    """
    rows = data["a"] @ z
    stationary = data["h"] @ z + data["g"] + data["a"].T @ lam_a + lam_z
    worst = [casadi.norm_inf(stationary)]
    for low, value, high, lam in ((data["lba"], rows, data["uba"], lam_a), (data["lbx"], z, data["ubx"], lam_z)):
        above, below = value - high, low - value
        pull = casadi.fmax(lam, 0.0) * above + casadi.fmax(-lam, 0.0) * below
        worst += [casadi.mmax(above), casadi.mmax(below), casadi.norm_inf(pull)]
    total = casadi.sum1(stationary) + casadi.sum1(rows)  # a maximum may pass over a NaN, a sum does not
    return casadi.if_else(casadi.fabs(total) < casadi.inf, casadi.mmax(casadi.vertcat(*worst)), casadi.inf)


NOTHING, PREDICTION, SOLUTION = 0.0, 1.0, 2.0
"""What is asked of a programme."""
Stages = tuple[Any, Any, Any, Any, Any]
"""A, B, gaps, rows and offsets of a_y: CasADi's symbols."""


@dataclass(frozen=True, eq=False)
class Programme:
    """What is asked and the measured numbers in, a solution out; it works on arrays in place.

    It answers 1 if the solver reports success; its iterations; the largest violation of the optimality conditions,
    infinite if anything is not finite; the six states when the commands on their way have acted, and the curvature of
    the path there [1/m]; the rates. NOTHING gives zeros; PREDICTION leaves out the solution. The numbers in: x (5,),
    the state now; commands on their way; rates of the plan before; preview; v; cos(beta); the largest rate.

    law: the `PredictiveSteering` that asks.
    """

    law: Any

    @cached_property
    def times(self) -> Array:
        """When a curvature is wanted [s]: half-way of each command on its way; at the stages; half-way between."""
        spans, dt = self.law.spans, self.law.dt
        stages = [self.law.delay + k * dt for k in range(self.law.horizon + 1)]
        return np.array([*np.cumsum(spans) - 0.5 * np.array(spans), *stages, *[t + 0.5 * dt for t in stages[:-1]]])

    @cached_property
    def prepare(self) -> casadi.Function:
        """The numbers as one vector -> ahead (7,); then (7, n): steady cornering and curvature at `times`; `DATA`."""
        n, horizon, soft = len(self.law.spans), self.law.horizon, self.law.qp.soft
        sizes = (5, max(n, 1), horizon, self.law.preview_points, 1, 1, 1)
        given = casadi.MX.sym("given", sum(sizes))
        now, commands, plan, preview, v, cos_beta, fastest = casadi.vertsplit(given, np.cumsum([0, *sizes]).tolist())
        then = self._then(preview, v, cos_beta)
        goal, between = then[:6, n : n + horizon + 1], then[:, n + horizon + 1 :]
        substeps = self.law.model.which_substeps(v)
        x = now
        if n:
            each = [self.law.model.predictor(self.law.spans, count) for count in self.law.model.all_substeps]
            x = casadi.Function.conditional("predicted", each, each[-1])(substeps, now, commands, v, then[6, :n].T)
        x = casadi.vertcat(x, commands[-1])
        table = self.law.model.schedule(v)
        a, b, gap, row, offset = self.law.motion(plan, x, v, substeps, between[6, :].T, between[:6, :], table)
        path = v * goal[3, soft].T  # the a_y that the path needs
        low = casadi.fmin(-self.law.a_y_limit, path - self.law.a_y_room) - offset
        high = casadi.fmax(self.law.a_y_limit, path + self.law.a_y_room) - offset
        p = table[3]
        slope = casadi.horzcat(-self.law.qp.q @ goal[:, 1:-1], -p @ goal[:, -1])
        data = self.law.qp.statement.data(a, b, gap, slope, row, low, high, p, fastest)
        ahead = casadi.vertcat(x, then[6, n])
        found = [ahead, casadi.densify(then), *data]
        return casadi.Function("prepare", [given], found, ["given"], ["ahead", "then", *DATA])

    def _then(self, preview: Any, v: Any, cos_beta: Any) -> Any:
        """Steady cornering and curvature at `times` (7, n).

        An entry of the preview is v*dt further along the path than that before, where the point that follows it gets
        to at the pace of steady cornering.
        """
        preview = casadi.fmin(casadi.fmax(preview, -KAPPA_HIGH), KAPPA_HIGH)
        pace = cos_beta * self.law.model.cornering(v, preview)[6, :].T
        half = 0.5 * self.law.dt / pace  # of the time from an entry to the next
        knots = 2.0 * casadi.cumsum(half) - half - half[0]
        times = casadi.MX(casadi.DM(self.times))
        j = casadi.low(knots, times)
        part = casadi.fmin(casadi.fmax((times - knots[j]) / (knots[j + 1] - knots[j]), 0.0), 1.0)
        kappa = preview[j] + part * (preview[j + 1] - preview[j])
        return casadi.vertcat(self.law.model.cornering(v, kappa)[:6, :], kappa.T)

    @cached_property
    def given(self) -> Array:
        """The numbers that `prepare` reads."""
        return np.zeros(self.prepare.nnz_in(0))

    @cached_property
    def found(self) -> dict[str, Array]:
        """What `prepare` and the solver found, by name."""
        functions = (self.prepare, self.law.qp.solve)
        return {name: np.zeros(f.nnz_out(name)) for f in functions for name in f.name_out()}

    @cached_property
    def _calls(self) -> list[Callable[[], None]]:
        """What prepares, and what solves."""
        return [in_place(f, self.found | {"given": self.given}) for f in (self.prepare, self.law.qp.solve)]

    @property
    def size(self) -> int:
        """How many numbers it answers."""
        return 10 + self.law.horizon

    def __call__(self, asked: float, *values: float) -> Sequence[float]:
        """A programme that is not finite (whatever broke in the motion shows in a gap) is not solved."""
        if not asked > 0.0:
            return (0.0,) * self.size
        self.given[:] = values
        prepare, solve = self._calls
        prepare()
        ahead, rates = self.found["ahead"].tolist(), [0.0] * self.law.horizon
        if asked < SOLUTION:
            return (0.0, 0.0, 0.0, *ahead, *rates)
        if not math.isfinite(float(self.found["lba"].sum())):  # CasADi would raise an error
            return (0.0, 0.0, math.inf, *ahead, *rates)
        solve()
        residual = float(self.found["residual"][0])
        report = self.law.qp.solver.stats(self._memory)
        if math.isfinite(residual):
            rates = self.found["z"][self.law.qp.statement.rates].tolist()
        return (float(report["success"]), float(report["iter_count"]), residual, *ahead, *rates)

    @cached_property
    def _memory(self) -> int:
        """Number of the solver's memory that the wrapping function uses; asked after its first call."""
        for number in range(8):
            try:
                self.law.qp.solver.stats(number)
            except RuntimeError:
                continue
            return number
        raise RuntimeError("Programme: HPIPM gives no statistics, so its success is not known")


def in_place(function: casadi.Function, arrays: dict[str, Array]) -> Callable[[], None]:
    """The function, from the arrays of its inputs' names to those of its outputs' names, without copies."""
    buffer: Any
    buffer, call = function.buffer()
    for i, name in enumerate(function.name_in()):
        buffer.set_arg(i, memoryview(arrays[name]))  # type: ignore[arg-type]
    for i, name in enumerate(function.name_out()):
        buffer.set_res(i, memoryview(arrays[name]))  # type: ignore[arg-type]

    def run(_kept: Any = (buffer, arrays)) -> None:  # CasADi holds addresses only
        call()

    return run
