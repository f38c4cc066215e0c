"""Drives of learned policies in a loop that is compiled once for all of a kind."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit.compiled import TraceError, compile
from steerkit.compiled.trace import parameter
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.policy import COLUMNS
from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log
from steerkit.scenario.assembly import controller_of, with_controller

PIECE = 10.0
"""Seconds of driving after which a drive may end early."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CalledPolicy(NfqPolicy):
    """Stands for all policies with these ports and this sample time in a loop that is compiled once: they are called.

    Equations, ports and state are those of `NfqPolicy`. Source: see there.
    """

    asked: m.Routine
    """Time, state and inputs to the outputs of the policy that drives ..."""
    remembered: m.Routine
    """... and to its next state."""

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*self.asked(t, *x, *_flat(u)))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return tuple(self.remembered(t, *x, *_flat(u))) if x else ()


def _flat(u: Any) -> tuple[Any, ...]:
    return (*u[: len(COLUMNS)], *(u.preview if len(u) > len(COLUMNS) else ()))


class PolicyDrives:
    """Drives of learned policies in one kind of loop, which is compiled once for all with a policy's ports.

    loop: one of the drives, with an `NfqPolicy` as its controller. record: signals to keep, one sample of the
    controller each. parameters: block fields that differ between the drives besides the policy, such as
    "car.vehicle.m". The numbers are those of `simulate`, to the last bit. Raises TraceError for a loop with a block
    that cannot be compiled.
    """

    def __init__(self, loop: Loop, record: Sequence[str], parameters: Sequence[str] = ()):
        self._policy = _policy_of(loop)
        self._open = tuple(parameters)
        self._entries = len(self._policy.init())
        stands = CalledPolicy(
            preview_points=self._policy.preview_points,
            dt=self._policy.dt,
            asked=m.Routine(name="policy", size=len(self._policy.outputs), call=self._asked),
            remembered=m.Routine(name="policy", size=self._entries, call=self._remembered),
        )
        self._compiled = compile(
            with_controller(loop, stands),
            backend="python",
            record=record,
            every=round(self._policy.dt / loop.dt),
            parameters=self._open,
        )

    def _called(self, values: tuple[float, ...]) -> tuple[State, Any]:
        """State and inputs of the policy, from what a routine is given."""
        seen, n = values[self._entries :], len(COLUMNS)
        return values[: self._entries], self._policy.D(*seen[:n], *([seen[n:]] if self._entries else []))

    def _asked(self, t: float, *values: float) -> Sequence[float]:
        return self._policy.output(t, *self._called(values))

    def _remembered(self, t: float, *values: float) -> Sequence[float]:
        return self._policy.update(t, *self._called(values), None)

    def run(self, loop: Loop, seconds: float, *, over: Callable[[Log], bool] = lambda log: False) -> Log:
        """The drive of the policy in `loop`, a loop like the one this was made for, for so many seconds.

        over: is nothing left to see after this piece of the drive, of `PIECE` seconds? Then the drive ends with it.
        """
        policy, made_for = _policy_of(loop), self._policy
        same = (policy.preview_points, policy.dt) == (made_for.preview_points, made_for.dt)
        require(same, "PolicyDrives", "a policy with another preview or dt, expected those of the one it was made for")
        self._policy = policy
        values = {name: parameter(loop, name) for name in self._open}
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
