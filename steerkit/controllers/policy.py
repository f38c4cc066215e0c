"""The ports of every policy that picks actions for a dynamic output element."""

from __future__ import annotations

from dataclasses import dataclass

from steerkit.block import Block, In, Out


@dataclass(frozen=True, eq=False, kw_only=True)
class Policy(Block):
    """Picks an action from the learner's state; abstract.

    Inputs, all direct: e [m], e_dot [m/s], v [m/s], psi_e [rad], r_e [rad/s], doe [rad] (the dynamic output element's
    angle). Outputs: action [rad]; q [1], the expected cost to go; ready [1], whether to be trusted with the wheel.
    """

    e = In("m")
    e_dot = In("m/s")
    v = In("m/s")
    psi_e = In("rad")
    r_e = In("rad/s")
    doe = In("rad")
    action = Out("rad")
    q = Out("1")
    ready = Out("1", direct=())
