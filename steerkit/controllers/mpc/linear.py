"""Model predictive steering with a linear motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from steerkit.controllers.mpc.block import PredictiveSteering
from steerkit.controllers.mpc.preparation import Motion


@dataclass(frozen=True, eq=False, kw_only=True)
class MPC(PredictiveSteering):
    """Model predictive steering with a motion that is linear about steady cornering, and varies with speed:

        x_{k+1} - x_ss(kappa_k) = A(v) (x_k - x_ss(kappa_k)) + B(v) rate_k,

    A, B the exact answer of `rhs`, linearised about straight driving, to a command held for dt; x_ss from the
    nonlinear `rhs`. So it is one convex programme a sample, and exact in steady bends. See `PredictiveSteering`.
    """

    def output(self, t: Any, x: tuple[Any, ...], u: Any) -> Any:
        return self._steer(x, u)

    def _motion(self, plan: Any, x0: Any, v: Any, choice: Any, kappa: Any, bends: Any, table: Any) -> Motion:
        a, b, row, _ = table
        gap = a @ bends - bends
        gap[:, 0] -= a @ x0
        bend = bends[:, list(self.qp.soft)]
        return a, b, gap, row, (v * bend[3, :] - row.T @ bend).T
