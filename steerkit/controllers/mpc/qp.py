"""The quadratic programme of predictive steering: stated in symbols, solved by HPIPM through CasADi, and checked."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi

from steerkit.controllers.mpc.path_model import NX

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
