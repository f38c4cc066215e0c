"""Blocks stepped sample by sample, by hand and through symbols."""

import casadi
import numpy as np


def run(block, inputs, x=None):
    """Outputs at each sample, then the last state; inputs: one tuple a sample."""
    x = block.init() if x is None else x
    ys = []
    for k, values in enumerate(inputs):
        u = block.U(*values)
        d = block.D(*[getattr(u, name) for name in block.D._fields])
        x = block.settle(0.0, x, d) if k == 0 else x
        y = block.output(k * block.dt, x, d)
        x = block.update(k * block.dt, x, u, y)
        ys.append(y)
    return ys, x


def traced(block, steps, update_inputs):
    """Outputs and states of `block` through a CasADi function of one sample; inputs as in `run`."""
    start = block.init()
    x, u = casadi.SX.sym("x", len(start)), casadi.SX.sym("u", max(1, len(block.U._fields)))
    state = casadi.vertsplit(x)
    state = type(start)._make(state) if hasattr(start, "_make") else tuple(state)
    inputs = block.U(*casadi.vertsplit(u)[: len(block.U._fields)])
    direct = block.D(*[getattr(inputs, name) for name in block.D._fields])
    y = block.output(0.0, state, direct)
    sample = casadi.Function(
        "sample", [x, u], [casadi.vertcat(*y), casadi.vertcat(*block.update(0.0, state, inputs, y))]
    )
    values = block.settle(0.0, start, block.D(*update_inputs[0][: len(block.D._fields)]))
    ys = []
    for k in range(steps):
        y, values = sample(casadi.DM(values), casadi.DM(update_inputs[k] or [0.0]))
        ys.append(np.array(y).ravel())
    return ys, np.array(values).ravel()
