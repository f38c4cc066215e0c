"""Gradients of a run's cost with respect to block parameters, by CasADi's algorithmic differentiation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np

from steerkit.compiled.trace import Layout, trace
from steerkit.compiled.vm import VmProgram
from steerkit.diagram.loop import Loop, LoopState, Sample

Cost = Callable[[Sequence[float]], tuple[float, np.ndarray]]


def gradient(
    loop: Loop,
    duration: float,
    *,
    parameters: Sequence[str],
    cost: Callable[[Sample], Any],
    state: LoopState | None = None,
) -> Cost:
    """A function of parameter values that gives the mean of `cost` over a run, and its gradient.

        J(p) = 1/T sum_k cost(y_k(p)),   S_{k+1} = dF/dz S_k + dF/dp

    dJ/dp by forward sensitivities S of the loop's state z, one column a parameter, next to the run itself and in the
    same pass.

    cost: of one sample, in `steerkit.diagram.maths`: `lambda y: y["path.e"] ** 2`. parameters: block fields, such as
    "controller.k". state: where to start, the same for all values (default: `loop.init()`). The gradient is that of
    the branch taken: at a limit or a table's knot it is one-sided. Raises TraceError as `compile` does.
    """
    graphs = trace(loop, parameters=parameters)
    start = loop.init() if state is None else state
    if start.k % loop.period:
        raise ValueError(f"gradient: state at tick {start.k}, expected a multiple of the loop's period {loop.period}")
    outputs = [slot for name in loop.units for slot in graphs.layout.slots_of(name)]
    program = VmProgram(graphs, outputs)
    z = casadi.MX.sym("z", program.phases[0].size1_in(0))
    end, total = z, casadi.MX(0.0)
    of_outputs = _cost_function(loop, graphs.layout, cost)
    for phase in program.phases:
        end, y = phase(end)
        total += of_outputs(y)
    n, m = z.numel(), len(parameters)
    so_far, sensitivity, slope = casadi.MX.sym("J"), casadi.MX.sym("S", n, m), casadi.MX.sym("dJ", 1, m)
    tick = casadi.Function("tick", [z, so_far], [end, so_far + total])
    after, cost_after = tick(z, so_far)
    moved, slope_after = tick.forward(m)(z, so_far, after, cost_after, sensitivity, slope)
    step = casadi.Function("step", [z, so_far, sensitivity, slope], [after, cost_after, moved, slope_after])
    periods = max(1, round(duration / (loop.dt * loop.period)))
    parts = [step.mapaccum(f"run{i}", 2**i, 4) for i in range(periods.bit_length()) if periods >> i & 1]
    slots = graphs.layout.pack(start.x, start.y)
    head = [float(start.k), *[float(slots[slot]) for slot in graphs.persistent]]
    seed = np.vstack((np.zeros((n - m, m)), np.eye(m)))

    def evaluate(values: Sequence[float]) -> tuple[float, np.ndarray]:
        now: list[Any] = [np.array([*head, *values]), 0.0, seed, np.zeros((1, m))]
        for part in parts:
            ends = part(*now)
            now = [np.asarray(end)[:, -width:] for end, width in zip(ends, (1, 1, m, m))]
        ticks = periods * loop.period
        return np.asarray(now[1]).item() / ticks, now[3].ravel() / ticks

    return evaluate


def _cost_function(loop: Loop, layout: Layout, cost: Callable[[Sample], Any]) -> Any:
    """The cost of one sample as a function of all outputs in slot order."""
    first = min(slot for slot, _ in layout.signals.values())
    symbols = casadi.SX.sym("y", len(layout) - first)
    _, y = layout.unpack([0.0] * first + [symbols[i] for i in range(symbols.numel())])
    return casadi.Function("cost", [symbols], [casadi.SX(cost(Sample(loop, math.nan, y)))])
