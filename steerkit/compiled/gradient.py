"""Gradients of a run's cost with respect to block parameters, by CasADi's algorithmic differentiation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np

from steerkit.compiled.trace import Layout, trace, traced, with_parameters
from steerkit.diagram.loop import Loop, Sample

Cost = Callable[[Sequence[float]], tuple[float, np.ndarray]]


def gradient(loop: Loop, duration: float, *, parameters: Sequence[str], cost: Callable[[Sample], Any]) -> Cost:
    """A function of parameter values that gives the mean of `cost` over a run, and its gradient.

        J(p) = 1/T sum_k cost(y_k(p)),   S_{k+1} = dF/dz S_k

    dJ/dp by forward sensitivities S of what goes from period to period, z = [J, p, state], one column a parameter, next
    to the run itself and in the same pass.

    cost: of one sample, in `steerkit.diagram.maths`: `lambda y: y["path.e"] ** 2`. parameters: block fields, such as
    "controller.k". All values start as the loop does. The gradient is that of the branch taken: at a limit or a table's
    knot it is one-sided. Raises TraceError for an unknown field.
    """
    trace(loop, parameters=parameters)  # which says what a block does wrong
    start = loop.init()
    layout, m = Layout(loop, start), len(parameters)
    traced("the cost", lambda new: [cost(Sample(loop, new(), layout.unpack([new() for _ in layout.names])[1]))], [])
    head = [float(value) for value in layout.pack(start.x, start.y)]
    n = 2 + m + len(head)
    z, slopes = casadi.MX.sym("z", n), casadi.MX.sym("S", n, m)
    after = _period(loop, layout, parameters, cost, z)
    period = casadi.Function("period", [z], [after])
    both = casadi.horzcat(after, period.forward(m)(z, after, slopes))
    count = max(1, round(duration / (loop.dt * loop.period)))
    step = casadi.Function("step", [casadi.horzcat(z, slopes)], [both])
    run = step.fold(count)
    seed = np.vstack((np.zeros((1, m)), np.eye(m), np.zeros((n - 1 - m, m))))

    def evaluate(values: Sequence[float]) -> tuple[float, np.ndarray]:
        first = np.array([0.0, *values, 0.0, *head])
        total = np.asarray(run(np.column_stack((first, seed))))[0] / (count * loop.period)
        return float(total[0]), total[1:]

    return evaluate


def _period(loop: Loop, layout: Layout, parameters: Sequence[str], cost: Callable[[Sample], Any], z: Any) -> Any:
    """z = [J, p, tick, slots] after one period."""
    total, *numbers = casadi.vertsplit(z)
    values, (k, *slots) = numbers[: len(parameters)], numbers[len(parameters) :]
    open_loop = with_parameters(loop, dict(zip(parameters, values)))
    x, y = layout.unpack(slots)
    for phase in range(loop.period):
        t = (k + phase) * loop.dt
        open_loop.run_phase(phase, t, x, y)
        total += cost(Sample(open_loop, t, y))
    return casadi.vertcat(total, *values, k + loop.period, *layout.pack(x, y))
