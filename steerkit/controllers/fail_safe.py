"""A guard around a safety filter: where that raises, is late or not finite, the recovery controller steers."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number, require
from steerkit.controllers.safety_filter import REASONS
from steerkit.controllers.supervisor import Guard
from steerkit.diagram import maths as m
from steerkit.diagram.block import In

RAISED, LATE, NOTHING = (float(len(REASONS) + n) for n in range(3))
"""What `reason` is when the recovery controller steers in the filter's place."""
FAULTS = {
    RAISED: "recovery: the filter raised an exception",
    LATE: "recovery: the filter was late",
    NOTHING: "recovery: the filter's answer is not finite",
}
"""In words."""


def said(reason: float) -> str:
    """What a value of the output `reason` means; for one that is none, that it is unknown."""
    words = (*REASONS, *FAULTS.values())
    return words[int(reason)] if reason in range(len(words)) else f"unknown reason {reason:g}"


@dataclass(frozen=True, eq=False, kw_only=True)
class FailSafe(Guard):
    """Wraps a `SafetyFilter` so that the recovery controller steers where the filter fails.

        delta_sw = recovery     if the filter raises, takes longer than `budget`, or its command is not finite
                 = its command  otherwise

    `reason` then says which it was (see `FAULTS`), share is 1, correction recovery - command, reach, late and widened
    NaN where they are not known. Each failure is logged on the logger `steerkit`, an exception with its traceback, but
    not while a loop is traced, compiled or batched, where nothing can be late. The filter runs again in the next
    sample: its state is updated with the command that was sent, and stays as it was where its update raises.

    Inputs: those of `block`, and recovery [rad]. Outputs, state and sample time: those of `block`. A NaN in `recovery`
    goes through; the gate before a bus refuses it. An exception while a loop is traced goes through too.
    Raises ValueError for a block without the outputs of a filter.
    """

    recovery = In("rad")

    budget: float | None = number(None, "s", above=0.0)
    """An answer that took longer is not used [s]; None: any may."""
    clock: Callable[[], float] = time.perf_counter
    """Seconds, for the budget."""

    def __post_init__(self) -> None:
        where, outputs = "FailSafe", {port.name for port in self.block.outputs}
        wanted = {"delta_sw", "correction", "share", "reach", "reason", "late", "widened"}
        require(outputs == wanted, where, f"block with outputs {', '.join(sorted(outputs))}, expected a SafetyFilter")
        super().__post_init__()

    def seen(self, u: Any) -> Any:
        return self.block.U(*u[:-1])

    def output(self, t: Any, x: Any, u: Any) -> Any:
        began = self.clock()
        y, taken = self.tried("output", self.inner_output, t, x, u), self.clock() - began
        if y is None:
            return self._instead(u, RAISED)
        if self.budget is not None and taken > self.budget:
            logging.getLogger("steerkit").error(
                "safety filter at t = %s s: %s, %.1f ms of %.1f ms", t, FAULTS[LATE], 1e3 * taken, 1e3 * self.budget
            )
            return self._instead(u, LATE, y)
        sound = m.is_finite(y.delta_sw)
        if sound is False:  # one car
            logging.getLogger("steerkit").error("safety filter at t = %s s: %s", t, FAULTS[NOTHING])
        other = self._instead(u, NOTHING, y)
        return self.Y(*[m.where(sound, value, instead) for value, instead in zip(y, other, strict=True)])

    def _instead(self, u: Any, reason: float, y: Any = None) -> Any:
        values = {"delta_sw": u.recovery, "correction": u.recovery - u.command, "share": 1.0, "reason": reason}
        known = {name: math.nan if y is None else getattr(y, name) for name in ("reach", "late", "widened")}
        return self.Y(**values, **known)
