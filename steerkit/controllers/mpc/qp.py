"""The quadratic programme of predictive steering: its layout, three solvers, and the check of what they answer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from steerkit.controllers.mpc import hpipm
from steerkit.controllers.mpc.bound import Array, Bound

SOLVERS = ("hpipm", "piqp", "qpoases")
FAR = 1e4
"""Stands for no bound: HPIPM needs 20 times longer with its own 1e8."""
_HPIPM = {
    "mode": "speed",
    "iter_max": 40,
    "mu0": 1e-4,
    "res_g_max": 1e-7,
    "res_b_max": 1e-7,
    "res_d_max": 1e-7,
    "res_m_max": 1e-7,
}
_DATA = ("h", "g", "a", "lba", "uba", "lbx", "ubx")
_PIQP = {"eps_abs": 1e-7, "eps_rel": 0.0, "max_iter": 60}


class Answer(NamedTuple):
    """What a solver said, and what of it is true."""

    x: Array
    """All variables, in the order of the programme; a buffer that the next solution overwrites."""
    iterations: float
    success: bool
    residual: float
    """The largest violation of the optimality conditions; infinite if anything is not finite."""


@dataclass(frozen=True, kw_only=True)
class StageQp:
    """min 1/2 z'Hz + g'z,  lba <= A z <= uba,  lbx <= z <= ubx,  over z = (u_0, x_1, u_1, ..., u_N-1, x_N).

    u_k: the rate, and where the limits are soft (`soft` stages) one slack for each of two limits:

        x_{k+1} = A_k x_k + B_k rate_k + c_k,  x_0 known,  |rate_k| <= bound,  |x_k[5]| <= bound,
        low <= rows_k x_k - slack_k <= high,

    so that a slack of either sign, which costs its square, takes up what a limit cannot hold. A solver is asked by
    name; `solve` reads the arrays below, which are filled in place, and checks its answer against

        H z + g + A' lam_a + lam_x = 0,  bounds kept,  lam (z - its bound) = 0.
    """

    horizon: int
    nx: int
    solver: str
    soft: tuple[int, ...]

    @cached_property
    def inputs(self) -> list[int]:
        """Entries of u_k."""
        return [3 if k in self.soft else 1 for k in range(self.horizon)]

    @cached_property
    def at_u(self) -> NDArray[np.intp]:
        """Where u_k starts in z."""
        sizes = [0, *[n + self.nx for n in self.inputs[:-1]]]
        return np.cumsum(sizes).astype(np.intp)

    @cached_property
    def at_x(self) -> NDArray[np.intp]:
        """Where x_k+1 starts in z."""
        return self.at_u + np.array(self.inputs)

    @cached_property
    def at_row(self) -> NDArray[np.intp]:
        """Where the rows of stage k start."""
        sizes = [0, *[self.nx + n - 1 for n in self.inputs[:-1]]]
        return np.cumsum(sizes).astype(np.intp)

    @cached_property
    def size(self) -> tuple[int, int]:
        """Variables and rows."""
        rows = int(self.at_row[-1]) + self.nx + self.inputs[-1] - 1
        return int(self.at_x[-1]) + self.nx, rows

    @cached_property
    def _places(self) -> tuple[sparse.csc_matrix, sparse.csc_matrix, dict[str, NDArray[np.intp]]]:
        """Sparsity of A and of H with entry numbers for data, and the numbers of the blocks that change."""
        nx, n = self.nx, self.horizon
        z, rows = self.size
        a, h = np.zeros((rows, z), dtype=np.intp), np.zeros((z, z), dtype=np.intp)
        for k in range(n):
            row, u, x = int(self.at_row[k]), int(self.at_u[k]), int(self.at_x[k])
            a[row : row + nx, u] = 1
            a[row : row + nx, x : x + nx] = np.eye(nx, dtype=np.intp)
            h[u : u + self.inputs[k], u : u + self.inputs[k]] = np.eye(self.inputs[k])
            h[x : x + nx, x : x + nx] = 1 if k == n - 1 else np.eye(nx)
            if k:
                before = int(self.at_x[k - 1])
                a[row : row + nx, before : before + nx] = 1
            if k in self.soft:
                a[row + nx : row + nx + 2, before : before + nx] = 1
                a[row + nx : row + nx + 2, u + 1 : u + 3] = np.eye(2)
        numbered = []
        for pattern in (a, h):
            matrix = sparse.csc_matrix(pattern)
            matrix.data = np.arange(matrix.nnz) + 1
            numbered.append(matrix)
        an, hn = (np.asarray(matrix.todense()) - 1 for matrix in numbered)
        grid = np.arange(nx)
        place = {
            "a": np.array([an[self.at_row[k] + grid[:, None], self.at_x[k - 1] + grid] for k in range(1, n)]),
            "b": np.array([an[self.at_row[k] + grid, self.at_u[k]] for k in range(n)]),
            "eye": np.array([an[self.at_row[k] + grid, self.at_x[k] + grid] for k in range(n)]),
            "rows": np.array(
                [an[self.at_row[k] + nx + np.arange(2)[:, None], self.at_x[k - 1] + grid] for k in self.soft],
                dtype=np.intp,
            ).reshape(-1, 2, nx),
            "slack": np.array(
                [an[self.at_row[k] + nx + np.arange(2), self.at_u[k] + 1 + np.arange(2)] for k in self.soft],
                dtype=np.intp,
            ).reshape(-1, 2),
            "q": np.array([hn[self.at_x[k] + grid, self.at_x[k] + grid] for k in range(n - 1)]),
            "p": hn[self.at_x[-1] + grid[:, None], self.at_x[-1] + grid],
            "r": np.array([hn[at, at] for at in self.at_u]),
            "r_slack": np.array(
                [hn[self.at_u[k] + 1 + np.arange(2), self.at_u[k] + 1 + np.arange(2)] for k in self.soft], dtype=np.intp
            ).reshape(-1, 2),
            "gap": self.at_row[:, None] + grid,
            "limit": np.array([self.at_row[k] + nx + np.arange(2) for k in self.soft], dtype=np.intp).reshape(-1, 2),
            "x": self.at_x[:, None] + grid,
        }
        return (*numbered, place)

    @cached_property
    def place(self) -> dict[str, NDArray[np.intp]]:
        """Entry numbers in the data arrays of the blocks by name."""
        return self._places[2]

    @cached_property
    def data(self) -> dict[str, Array]:
        """The arrays of the programme: h, g, a, lba, uba, lbx, ubx; filled in place."""
        data = {name: self.numbers[first : first + n] for name, (first, n) in self._spans.items()}
        data["lbx"][:], data["ubx"][:] = -FAR, FAR
        data["a"][self.place["eye"]] = -1.0
        data["a"][self.place["slack"]] = -1.0
        return data

    @cached_property
    def _spans(self) -> dict[str, tuple[int, int]]:
        """Where in `numbers` each array of the programme begins, and its length."""
        z, rows = self.size
        a, h, _ = self._places
        sizes = {"h": h.nnz, "g": z, "a": a.nnz, "lba": rows, "uba": rows, "lbx": z, "ubx": z}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        return {name: (end, n) for end, (name, n) in zip(ends, sizes.items())}

    @property
    def first(self) -> dict[str, int]:
        """Where in `numbers` each array of the programme begins."""
        return {name: start for name, (start, _) in self._spans.items()}

    @cached_property
    def numbers(self) -> Array:
        """The arrays in `data` one after the other, and a zero."""
        return np.zeros(sum(n for _, n in self._spans.values()) + 1)

    @cached_property
    def _patterns(self) -> tuple[casadi.Sparsity, casadi.Sparsity]:
        a, h = (
            casadi.Sparsity(p.shape[0], p.shape[1], p.indptr.tolist(), p.indices.tolist()) for p in self._places[:2]
        )
        return a, h

    @cached_property
    def _out(self) -> dict[str, Array]:
        z, _ = self.size
        x, lam_x, lam_a = np.split(self.answer, [z, 2 * z])
        return {"x": x, "lam_x": lam_x, "lam_a": lam_a, "residual": self.residual}

    @cached_property
    def residual(self) -> Array:
        """The largest violation of the optimality conditions that `check` found (1,)."""
        return np.zeros(1)

    @cached_property
    def answer(self) -> Array:
        """x, lam_x, lam_a one after the other."""
        z, rows = self.size
        return np.zeros(2 * z + rows)

    @cached_property
    def _conic(self) -> casadi.Function:
        a, h = self._patterns
        options: dict[str, Any] = {"error_on_fail": False}
        if self.solver == "hpipm":
            n, states = self.horizon, [0] + [self.nx] * self.horizon
            options |= {
                "N": n,
                "nx": states,
                "nu": [*self.inputs, 0],
                "ng": [*[i - 1 for i in self.inputs], 0],
                "inf": FAR,
                "hpipm": _HPIPM,
            }
        else:
            options["piqp"] = _PIQP
        return casadi.conic("qp", self.solver, {"a": a, "h": h}, options)

    @cached_property
    def _solve_and_check(self) -> Bound:
        """x and its residual, from the arrays in `data`.

        The solver is wrapped, since HPIPM, called through a buffer of its own, keeps the vectors of its first call.
        """
        v = self._symbols
        answer = self._conic(**{name: v[name] for name in _DATA})
        residual = self._residual(v | {"x": answer["x"], "lam_x": answer["lam_x"], "lam_a": answer["lam_a"]})
        return self._bound(
            casadi.Function(
                "solve", [v[name] for name in _DATA], [answer["x"], residual], list(_DATA), ["x", "residual"]
            ),
            in_c=False,
        )

    @cached_property
    def check(self) -> Bound:
        """The residual of x, lam_x, lam_a in `_out`."""
        v = self._symbols
        check = casadi.Function("check", list(v.values()), [self._residual(v)], list(v), ["residual"])
        return self._bound(check, in_c=True)

    @property
    def _symbols(self) -> dict[str, Any]:
        a, h = self._patterns
        z, rows = self.size
        sizes = {"g": z, "lba": rows, "uba": rows, "lbx": z, "ubx": z, "x": z, "lam_x": z, "lam_a": rows}
        matrices = {"h": casadi.MX.sym("h", h), "a": casadi.MX.sym("a", a)}
        return matrices | {name: casadi.MX.sym(name, n) for name, n in sizes.items()}

    @staticmethod
    def _residual(v: dict[str, Any]) -> Any:
        """The largest violation: of stationarity, of a bound, of complementarity; infinite where one is not finite."""
        held = casadi.mtimes(v["a"], v["x"])
        stationary = casadi.mtimes(v["h"], v["x"]) + v["g"] + casadi.mtimes(v["a"].T, v["lam_a"]) + v["lam_x"]
        worst = [casadi.norm_inf(stationary)]
        for low, value, high, lam in ((v["lba"], held, v["uba"], v["lam_a"]), (v["lbx"], v["x"], v["ubx"], v["lam_x"])):
            above, below = value - high, low - value
            worst += [casadi.mmax(above), casadi.mmax(below)]
            size = casadi.fabs(lam)  # lam + |lam| is twice the positive part; one of both parts is zero
            worst += [casadi.norm_inf(0.5 * (lam + size) * above + 0.5 * (lam - size) * below)]
        total = casadi.sum1(stationary) + casadi.sum1(held)  # a maximum may pass over a NaN, a sum does not
        return casadi.if_else(casadi.fabs(total) < casadi.inf, casadi.mmax(casadi.vertcat(*worst)), casadi.inf)

    def _bound(self, function: casadi.Function, *, in_c: bool) -> Bound:
        """A function on this object's arrays, by name."""
        arrays = self.data | self._out
        inputs = [arrays[name] for name in function.name_in()]
        return Bound(function, inputs, [self._out[name] for name in function.name_out()], in_c=in_c)

    def solve(self) -> Answer:
        """Solve the programme in `data` and check the answer.

        One with a bound that is not finite (the gaps hold A x, so whatever broke in the motion shows there) is not
        asked: CasADi would raise an error.
        """
        if not math.isfinite(float(self.data["lba"].sum())):
            return Answer(self._out["x"], 0.0, False, math.inf)
        if self.solver == "qpoases":
            iterations, success = self._condensed()
            self.check()
        elif self.in_c:
            iterations, success = self.direct.solve()
            self.check()
        else:
            self._solve_and_check()
            said = self._conic.stats(self._memory)
            iterations, success = float(said.get("iter_count", -1)), bool(said["success"])
        return Answer(self._out["x"], iterations, success, float(self._out["residual"][0]))

    @cached_property
    def direct(self) -> hpipm.Hpipm:
        """HPIPM without CasADi's interface around it, on `numbers` and `answer`."""
        return hpipm.of(self)

    @cached_property
    def in_c(self) -> bool:
        """Is the solver called from C, without CasADi's interface around it?"""
        return self.solver == "hpipm" and hpipm.there()

    @cached_property
    def _memory(self) -> int:
        """Number of the solver's memory that the wrapping function uses; asked after its first call."""
        for number in range(8):
            try:
                self._conic.stats(number)
            except RuntimeError:
                continue
            return number
        raise RuntimeError(f"StageQp: {self.solver} gives no statistics, so its success is not known")

    # ---- condensing: the states are eliminated, which leaves a small dense programme -------------------------

    @cached_property
    def _split(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Numbers of the variables that are inputs and states, and of the rows that are limits and gaps."""
        z, rows = self.size
        x, gap = self.place["x"].ravel(), self.place["gap"].ravel()
        return np.setdiff1d(np.arange(z), x), x, np.setdiff1d(np.arange(rows), gap), gap

    @cached_property
    def _dense_solver(self) -> Any:
        inputs, _, limits, _ = self._split
        n, m = len(inputs), len(limits) + self.horizon
        shapes = {"h": casadi.Sparsity.dense(n, n), "a": casadi.Sparsity.dense(m, n)}
        return casadi.conic("qp", "qpoases", shapes, {"printLevel": "none", "error_on_fail": False})

    def _condensed(self) -> tuple[float, bool]:
        """By qpOASES for u, with z = T u + s from the gaps; then the gaps' multipliers from the states' columns."""
        d, out = self.data, self._out
        inputs, x, limits, gap = self._split
        a_like, h_like, _ = self._places
        a = np.asarray(sparse.csc_matrix((d["a"], a_like.indices, a_like.indptr), a_like.shape).todense())
        h = np.asarray(sparse.csc_matrix((d["h"], h_like.indices, h_like.indptr), h_like.shape).todense())
        turn = np.zeros((len(d["g"]), len(inputs)))
        shift = np.zeros(len(d["g"]))
        solved = np.linalg.solve(a[np.ix_(gap, x)], np.column_stack((-a[np.ix_(gap, inputs)], d["lba"][gap])))
        turn[inputs, np.arange(len(inputs))] = 1.0
        turn[x], shift[x] = solved[:, :-1], solved[:, -1]
        wheel = self.place["x"][:, -1]
        rows = np.vstack((a[limits] @ turn, turn[wheel]))
        moved = np.concatenate((a[limits] @ shift, shift[wheel]))
        answer = self._dense_solver(
            h=turn.T @ h @ turn,
            g=turn.T @ (h @ shift + d["g"]),
            a=rows,
            lbx=d["lbx"][inputs],
            ubx=d["ubx"][inputs],
            lba=np.concatenate((d["lba"][limits], d["lbx"][wheel])) - moved,
            uba=np.concatenate((d["uba"][limits], d["ubx"][wheel])) - moved,
        )
        lam = answer["lam_a"].full().ravel()
        out["x"][:] = turn @ answer["x"].full().ravel() + shift
        out["lam_x"][:] = 0.0
        out["lam_x"][inputs], out["lam_x"][wheel] = answer["lam_x"].full().ravel(), lam[len(limits) :]
        out["lam_a"][limits] = lam[: len(limits)]
        stationary = h @ out["x"] + d["g"] + out["lam_x"] + a[limits].T @ out["lam_a"][limits]
        out["lam_a"][gap] = np.linalg.solve(a[np.ix_(gap, x)].T, -stationary[x])
        said = self._dense_solver.stats()
        return float(said.get("iter_count", -1)), bool(said["success"])
