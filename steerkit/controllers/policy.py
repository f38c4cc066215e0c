"""The ports of every policy that picks actions for a dynamic output element, and the columns of the learner's state."""

from __future__ import annotations

from dataclasses import dataclass

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
