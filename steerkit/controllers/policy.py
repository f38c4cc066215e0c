"""The ports of every policy that picks actions for a dynamic output element, and the columns of the learner's state."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.diagram.block import Block, In, Out


@dataclass(frozen=True, eq=False, kw_only=True)
class Policy(Block):
    """Picks an action from the learner's state; abstract.

    Inputs, all direct: e [m], e_dot [m/s], v [m/s], psi_e [rad], r_e [rad/s], doe [rad] (the dynamic output element's
    angle). Outputs: action [rad]; ready [1], whether the policy may steer.
    """

    e = In("m")
    e_dot = In("m/s")
    v = In("m/s")
    psi_e = In("rad")
    r_e = In("rad/s")
    doe = In("rad")
    action = Out("rad")
    ready = Out("1", direct=())


COLUMNS = tuple(port.name for port in Policy.inputs)
"""The columns of the learner's state, in recorded transitions and in a net's input: a policy's inputs, in order."""
UNITS = {port.name: port.unit for port in Policy.inputs}
"""Their units."""
E, E_DOT, V, PSI_E, R_E, DOE = range(len(COLUMNS))
"""Their numbers: `s[:, DOE]` are the output element's angles of the states s (n, columns)."""
LARGEST_POLICY = 64_000_000
"""Bytes that a policy's file may ask for in memory: a hundred thousand times the paper's net."""
ACTION = -1
"""In a net's input, the candidate action: the last column, after the state's."""


def check_layers(layers: Sequence[tuple[NDArray[Any], NDArray[Any]]], n_in: int | None, where: str) -> int:
    """Units of the last layer (W, b); raises ValueError unless they fit together, from n_in inputs, and are finite.

    n_in: None: as many as the first W has columns.
    """
    n = n_in
    for i, (w, b) in enumerate(layers):
        n = w.shape[-1] if n is None and w.ndim else n
        fits = w.ndim == 2 and w.shape[1] == n and b.shape == (w.shape[0],)
        require(fits, where, f"layer {i}: W {w.shape}, b {b.shape}, expected W (n_out, {n}), b (n_out,)")
        finite = bool(np.isfinite(w).all() and np.isfinite(b).all())
        require(finite, where, f"layer {i} holds a NaN or an infinity, expected finite weights")
        n = w.shape[0]
    require(n is not None, where, "no layers, expected at least one")
    return n or 0
