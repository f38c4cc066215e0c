"""Drives of learned policies in a loop that is compiled once for all of a kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from steerkit._support.errors import require
from steerkit.compiled import TraceError, compile
from steerkit.compiled.trace import parameter
from steerkit.controllers.nfq_policy import NfqPolicy, OpenPolicy, numbers_of
from steerkit.controllers.supervisor import ExceptionGuard
from steerkit.diagram import maths as m
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log
from steerkit.scenario.assembly import controller_of, with_controller

PIECE = 10.0
"""Seconds of driving after which a drive may end early."""


class PolicyDrives:
    """Drives of learned policies of one kind in one kind of loop, which is compiled once for all of them.

    loop: one of the drives, with an `NfqPolicy` as its controller. record: signals to keep, one sample of the
    controller each. parameters: block fields that differ between the drives besides the policy, such as
    "car.vehicle.m". The numbers are those of `simulate`, to the last bit. Raises TraceError for a loop with a block
    that cannot be compiled.
    """

    def __init__(self, loop: Loop, record: Sequence[str], parameters: Sequence[str] = ()):
        self._policy = _policy_of(loop)
        self._open = tuple(parameters)
        nets = m.Routine(name="nets", size=len(self._policy.actions), call=lambda *s: self._policy.values(*s))
        stands = OpenPolicy.of(self._policy, nets)
        guarded = isinstance(loop.blocks["controller"], ExceptionGuard)
        self._numbers = "controller.block.numbers" if guarded else "controller.numbers"
        self._compiled = compile(
            with_controller(loop, stands),
            backend="python",
            record=record,
            every=round(self._policy.dt / loop.dt),
            parameters=[*self._open, self._numbers],
        )

    def run(self, loop: Loop, seconds: float, *, over: Callable[[Log], bool] = lambda log: False) -> Log:
        """The drive of the policy in `loop`, a loop like the one this was made for, for so many seconds.

        over: is nothing left to see after this piece of the drive, of `PIECE` seconds? Then the drive ends with it.
        """
        self._policy = _policy_of(loop)
        values = {name: parameter(loop, name) for name in self._open}
        values[self._numbers] = numbers_of(self._policy)
        parts, left, state = list[Log](), seconds, loop.init()
        while left > 0.5 * loop.dt and not (parts and over(parts[-1])):
            parts.append(self._compiled.run(min(PIECE, left), state=state, parameters=values, allow_nonfinite=True))
            state, left = parts[-1].state or state, left - PIECE
        signals = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        return Log(np.concatenate([part.t for part in parts]), signals, parts[0].units, loop=loop, state=state)


def policy_drives(loop: Loop, record: Sequence[str], parameters: Sequence[str] = ()) -> PolicyDrives | None:
    """`PolicyDrives`, or None where a block of the loop cannot be compiled, and drives are interpreted."""
    try:
        return PolicyDrives(loop, record, parameters)
    except TraceError:
        return None


def _policy_of(loop: Loop) -> NfqPolicy:
    policy = controller_of(loop)
    kind = type(policy).__name__
    require(isinstance(policy, NfqPolicy), "PolicyDrives", f"the controller is a {kind}, expected an NfqPolicy")
    return policy  # type: ignore[return-value]
