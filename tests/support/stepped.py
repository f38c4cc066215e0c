"""Blocks stepped sample by sample, by hand and through symbols."""

from functools import cache

import casadi
import numpy as np

_AT_ONCE = 2000  # CasADi takes longer for each sample, the more there are


def run(block, inputs, x=None):
    """Outputs at each sample, then the last state; inputs: one tuple a sample."""
    x = block.init() if x is None else x
    ys = []
    for k, values in enumerate(inputs):
        u = block.U(*values)
        x = _settled(block, x, values) if k == 0 else x
        d = block.D(*[getattr(u, name) for name in block.D._fields])
        y = block.output(k * block.dt, x, d)
        x = block.update(k * block.dt, x, u, y)
        ys.append(y)
    return ys, x


def run_fast(block, inputs):
    """Outputs at each sample, an array (T, n), then the last state: as `run` to rounding, for long tapes.

    In CasADi's machine; not for a block that asks for the time.
    """
    return from_there(block, _settled(block, block.init(), inputs[0]), inputs)


def from_there(block, x, inputs):
    """The same from a state on."""
    x, step = casadi.DM(x), sample(block)
    rows, found = np.array(inputs, dtype=float), []
    for part in np.split(rows, range(_AT_ONCE, len(rows), _AT_ONCE)):
        xs, ys = step.mapaccum(len(part))(x, casadi.DM(part.T))
        x = xs[:, -1]
        found.append(np.array(ys).T)
    return np.concatenate(found), np.array(x).ravel()


@cache
def sample(block):
    """The next state and the outputs, of a state and inputs, as a CasADi function."""
    start = block.init()
    x, u = casadi.SX.sym("x", len(start)), casadi.SX.sym("u", max(1, len(block.U._fields)))
    state = casadi.vertsplit(x)
    state = type(start)._make(state) if hasattr(start, "_make") else tuple(state)
    inputs = block.U(*casadi.vertsplit(u)[: len(block.U._fields)])
    direct = block.D(*[getattr(inputs, name) for name in block.D._fields])
    y = block.output(0.0, state, direct)
    after = block.update(0.0, state, inputs, y)
    return casadi.Function("sample", [x, u], [casadi.vertcat(*after), casadi.vertcat(*y)])


def _settled(block, x, values):
    """The state `x` once the inputs `values` are there."""
    u = block.U(*values)
    return block.settle(0.0, x, block.D(*[getattr(u, name) for name in block.D._fields]))
