"""Nonlinear model predictive steering."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from steerkit.controllers.mpc.block import PredictiveSteering
from steerkit.controllers.mpc.path_model import NX, Array, Motion, Table, bound


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

    def output(self, t: Any, x: tuple[Any, ...], u: Any) -> Any:
        return self._steer(x, u)

    @cached_property
    def _rollout(self) -> dict[int, tuple[dict[str, Array], Callable[[], None]]]:
        """The plan driven and linearised: arrays to write (the first four) and read, and the call; by substeps."""
        return {substeps: self._driver(substeps) for substeps in self.model.all_substeps}

    def _driver(self, substeps: int) -> tuple[dict[str, Array], Callable[[], None]]:
        n = self.horizon
        arrays = {
            "x0": np.zeros(NX),
            "rate": np.zeros(n),
            "v": np.zeros(n),
            "kappa": np.zeros(n),
            "x": np.zeros((n, NX)),
            "a": np.zeros((n, NX, NX)),
            "b": np.zeros((n, NX)),
            "a_y": np.zeros(n),
            "row": np.zeros((n, NX)),
        }
        flat = [array.reshape(-1) for array in arrays.values()]
        return arrays, bound(self.model.linearised_step(substeps).mapaccum("rollout", n), flat[:4], flat[4:])

    def _motion(self, state: Any, x0: Array, v: float, kappa: Array, bends: Array, table: Table) -> Motion:
        driven, run = self._rollout[self.model.substeps(v)]
        driven["x0"][:], driven["rate"][:], driven["v"][:], driven["kappa"][:] = x0, state.plan, v, kappa
        run()
        a, b, soft = driven["a"], driven["b"], self._soft
        before = np.vstack((x0, driven["x"][:-1]))
        gap = np.einsum("kij,kj->ki", a, before) + b * driven["rate"][:, None] - driven["x"]
        gap[0] -= a[0] @ x0
        row = driven["row"][soft]
        return a[1:], b, gap, row, driven["a_y"][soft] - np.einsum("ki,ki->k", row, before[soft])
