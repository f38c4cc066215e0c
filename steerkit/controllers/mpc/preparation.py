"""From a sample's numbers to those of its programme: prediction over the delay, path ahead, motion, goals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from steerkit.controllers.mpc.path_model import CURVES, KAPPA_HIGH, NX, ROW, Array, PathModel, between
from steerkit.controllers.mpc.qp import StageQp

Motion = tuple[Any, Any, Any, Any, Any]
"""A, B, gaps, rows and offsets of a_y: CasADi's symbols."""


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """One CasADi function, `prepare`, and where its results go in the numbers of a `StageQp`.

    It is handed x (5,), the state now, `commands` on their way, `plan`, `preview`, the numbers in `now`, rows of the
    model's tables at this speed, and the block's `settings`; it gives `ahead`: x (6,) when the commands have acted and
    the curvature there; `then`: steady cornering and curvature at `times` (7, n); and `fresh`: what of the programme
    changes from sample to sample, A, B, gaps, rows of a_y, their limits, goals, P, and the rate's bounds.

    motion: as `PredictiveSteering._motion`. times: where a curvature is wanted; first: for how long the oldest
    command still acts.
    """

    model: PathModel
    qp: StageQp
    motion: Callable[..., Motion]
    pieces: int
    first: float
    times: Array
    preview_points: int

    @cached_property
    def sizes(self) -> dict[str, int]:
        """What is handed in, in order, and how many numbers each is."""
        return {
            "x": 5,
            "commands": max(self.pieces, 1),
            "plan": self.qp.horizon,
            "preview": self.preview_points,
            "now": 4,  # v, where between two speeds of the tables, cosine of beta, bound of the rate
            "spline": ROW,
            "steady": 2 * CURVES * 7,
            "settings": 5,  # q_e, q_psi, q_r, a_y_limit, a_y_room
        }

    @cached_property
    def _made(self) -> tuple[casadi.Function, dict[str, int]]:
        given = {name: casadi.MX.sym(name, n) for name, n in self.sizes.items()}
        v, t, cos_beta, fastest = casadi.vertsplit(given["now"])
        then = self._then(given, t, cos_beta)
        n, horizon = self.pieces, self.qp.horizon
        x = casadi.vertcat(self._predicted(given, v, then[6, :n].T), given["commands"][-1])
        goal, between = then[:6, n : n + horizon + 1], then[:, n + horizon + 1 :]
        table = self.model.spline(given["spline"], t)
        soft = list(self.qp.soft)
        plan, choice = given["plan"], given["spline"][-1]
        a, b, gap, row, offset = self.motion(plan, x, v, choice, between[6, :].T, between[:6, :], table)
        weights, limit, room = given["settings"][:3], given["settings"][3], given["settings"][4]
        q = casadi.diag(casadi.vertcat(weights[0], weights[1], 0.0, weights[2], 0.0, 0.0))
        path = v * goal[3, soft].T
        fresh = {
            "a": a,
            "b": b,
            "gap": gap,
            "row": row,
            "low": casadi.fmin(-limit, path - room) - offset,
            "high": casadi.fmax(limit, path + room) - offset,
            "g": casadi.horzcat(-q @ goal[:, 1:-1], -table[3] @ goal[:, -1]),
            "p": table[3],
            "fastest": fastest,
            "slowest": -fastest,
        }
        columns = [casadi.vec(casadi.densify(matrix)) for matrix in fresh.values()]
        results = [casadi.vertcat(x, then[6, n]), casadi.densify(then), casadi.vertcat(*columns)]
        made = casadi.Function("prepare", list(given.values()), results, list(given), ["ahead", "then", "fresh"])
        return made, {name: column.shape[0] for name, column in zip(fresh, columns)}

    @property
    def prepare(self) -> casadi.Function:
        """See above."""
        return self._made[0]

    @property
    def _fresh(self) -> dict[str, int]:
        """What `fresh` holds, in order, and how many numbers each is; of A, B, row: of all stages, or one for all."""
        return self._made[1]

    def _then(self, given: dict[str, Any], t: Any, cos_beta: Any) -> Any:
        """Steady cornering and curvature at `times` (7, n).

        An entry of the preview is v*dt further along the path than that before, where the point that follows it gets
        to at the pace of steady cornering.
        """
        preview = casadi.fmin(casadi.fmax(given["preview"], -KAPPA_HIGH), KAPPA_HIGH)
        rows = self.model.corners(given["steady"], t, preview)
        half = 0.5 * self.model.dt / (cos_beta * rows[6, :].T)  # of the time from an entry to the next
        rows = casadi.vertcat(rows[:6, :], preview.T)
        knots = 2.0 * casadi.cumsum(half) - half - half[0]
        times = casadi.MX(casadi.DM(self.times))
        j = casadi.low(knots, times)
        part = (times - knots[j]) / (knots[j + 1] - knots[j])
        return between(rows, casadi.fmin(casadi.fmax(j + part, 0.0), self.preview_points - 1.0))

    def _predicted(self, given: dict[str, Any], v: Any, kappa: Any) -> Any:
        """The five states when the commands on their way have acted."""
        if self.pieces == 0:
            return given["x"]
        each = [self.model.predictor(self.pieces, self.first, k) for k in self.model.all_substeps]
        return chosen("predicted", each)(given["spline"][-1], given["x"], given["commands"], v, kappa)

    @cached_property
    def where(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Places in the programme's numbers that change from sample to sample, and of each the place in `fresh`."""
        qp, at, first, n = self.qp, self.qp.place, self.qp.first, self.qp.horizon
        ends = np.cumsum([0, *self._fresh.values()]).tolist()
        start = dict(zip(self._fresh, ends))
        i, j = np.meshgrid(np.arange(NX), np.arange(NX), indexing="ij")
        stage = np.arange(n)[:, None]

        def each(name: str, size: int, count: int) -> Any:
            """Where the matrices of so many stages begin, which may all be the same one."""
            return start[name] + size * np.arange(count) * (self._fresh[name] > size)

        stages, soft = np.arange(NX) + NX * stage, np.arange(len(qp.soft))
        pairs = [
            (first["a"] + at["a"], each("a", NX * NX, n - 1)[:, None, None] + NX * j + i),
            (first["a"] + at["b"], each("b", NX, n)[:, None] + np.arange(NX)),
            (first["a"] + at["rows"][:, 1], each("row", NX, len(soft))[:, None] + np.arange(NX)),
            *[(first[name] + at["gap"], start["gap"] + stages) for name in ("lba", "uba")],
            (first["lba"] + at["limit"][:, 1], start["low"] + soft),
            (first["uba"] + at["limit"][:, 1], start["high"] + soft),
            (first["g"] + at["x"], start["g"] + stages),
            (first["h"] + at["p"], start["p"] + NX * j + i),
            (first["ubx"] + qp.at_u, np.full(n, start["fastest"])),
            (first["lbx"] + qp.at_u, np.full(n, start["slowest"])),
        ]
        return tuple(np.concatenate([np.ravel(pair[side]) for pair in pairs]).astype(np.int64) for side in (0, 1))  # type: ignore[return-value]


def chosen(name: str, functions: list[casadi.Function]) -> casadi.Function:
    """The function whose number is the first argument, of the others."""
    if len(functions) == 1:
        inputs = [casadi.MX.sym("choice"), *functions[0].mx_in()]
        return casadi.Function(name, inputs, functions[0].call(inputs[1:]))
    return casadi.Function.conditional(name, functions[:-1], functions[-1])
