"""A sample of predictive steering on numbers: prediction over the delay, path ahead, motion, programme, solution."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from steerkit.controllers.mpc.path_model import KAPPA_HIGH
from steerkit.controllers.mpc.qp import DATA
from steerkit.diagram.maths import Array

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
