"""Nonlinear model predictive steering."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi

from steerkit.controllers.mpc.block import PredictiveSteering
from steerkit.controllers.mpc.path_model import NX
from steerkit.controllers.mpc.preparation import Motion, chosen


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

    def _motion(self, plan: Any, x0: Any, v: Any, choice: Any, kappa: Any, bends: Any, table: Any) -> Motion:
        n, soft = self.horizon, list(self.qp.soft)
        each = [self.model.affine_step(count).mapaccum(f"driven{count}", n) for count in self.model.all_substeps]
        driven = chosen("driven", each)(choice, x0, plan.T, casadi.repmat(v, 1, n), kappa.T)
        _, a, b, gap, row, offset = driven
        gap[:, 0] -= a[:, :NX] @ x0
        return a[:, NX:], b, gap, row[:, soft], offset[soft].T
