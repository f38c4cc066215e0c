"""The supervisor that switches between the learned and the recovery controller, and a guard against exceptions."""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from steerkit._support.errors import number, require
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, Port, State, Wrapper
from steerkit.task import RELEASE, STOP, TRIP


class SupervisorState(NamedTuple):
    """Whether the learner steered in the sample before, whether its fault is latched (0.0 or 1.0), and for how long the
    recovery controller has been too far off to hand over [s]."""

    learning: Any
    fault: Any
    waited: Any


@dataclass(frozen=True, eq=False, kw_only=True)
class Supervisor(Block):
    """Switches to the recovery controller when the learned one leaves the path or fails, and back when both are fine.

        fault    = not (|learner| <= limit and ready = 1),   latched until `ready` is 0 once
        learning = ready and not fault and |e| <= trip      if the learner steered in the sample before
        learning = ready and not fault and |e| <  within    otherwise
        within   = min(trip, release max(1, waited/patience))
        delta_sw = learner if learning, else recovery

    waited: the time for which the recovery controller has steered with |e| >= release, less all other time, 0 at least.
    One that cannot stay within `release`, as its car wanders more or as it swings, hands over at what it reaches.

    A fault is a command that is NaN or out of range, or a NaN in `ready`, as an `ExceptionGuard` gives.

    Inputs: e [m] as measured; learner, recovery [rad], both commands; ready [1], whether there is a valid policy.
    Outputs: delta_sw [rad]; learning [1]; tripped [1], 1 in the one sample in which the learner was switched off for
    |e| > trip; fault [1]; within [m]. State: learning and fault of the sample before, and waited [s]; the run starts
    with the recovery controller.
    A NaN in e switches to the recovery controller. A NaN in `recovery` goes through while that steers; the gate before
    the bus refuses it.
    Raises ValueError unless 0 < release <= trip. Source: Riedmiller, Montemerlo, Dahlkamp 2007 (0.5 m and 0.1 m).
    """

    e = In("m")
    learner = In("rad")
    recovery = In("rad")
    ready = In("1")
    delta_sw = Out("rad")
    learning = Out("1")
    tripped = Out("1")
    fault = Out("1")
    within = Out("m", direct=())

    trip: float = TRIP
    """|e| above which the recovery controller takes over [m]."""
    release: float = RELEASE
    """|e| below which the learner takes over, at first [m]."""
    patience: float = number(5.0, "s", above=0.0)
    """Value of `waited` from which that grows in proportion to it [s]."""
    limit: float = number(STOP, "rad", above=0.0)
    """Largest |delta_sw| a learner may command [rad]; more is a fault."""

    def __post_init__(self) -> None:
        super().__post_init__()
        fits, given = 0.0 < self.release <= self.trip, f"release = {self.release} m, trip = {self.trip} m"
        require(fits, "Supervisor", f"{given}, expected 0 < release <= trip")

    def init(self, batch: tuple[int, ...] = ()) -> SupervisorState:
        return SupervisorState(m.filled(0.0, batch), m.filled(0.0, batch), m.filled(0.0, batch))

    def output(self, t: Any, x: SupervisorState, u: Any) -> Any:
        ready = u.ready > 0.5  # a NaN compares false, to whatever it is compared
        sane = m.both(ready, m.absolute(u.learner) <= self.limit * (1.0 + 1e-9))
        fault = m.where(u.ready <= 0.5, 0.0, m.where(sane, x.fault, 1.0))
        steered = x.learning > 0.5
        distance = m.absolute(u.e)
        within = m.minimum(self.trip, self.release * m.maximum(1.0, x.waited / self.patience))
        near = m.where(steered, m.where(distance <= self.trip, 1.0, 0.0), m.where(distance < within, 1.0, 0.0))
        learning = m.where(m.both(ready, fault < 0.5), near, 0.0)
        tripped = m.where(steered, m.where(distance <= self.trip, 0.0, 1.0), 0.0)
        return self.Y(m.where(learning > 0.5, u.learner, u.recovery), learning, tripped, fault, within)

    def update(self, t: Any, x: SupervisorState, u: Any, y: Any) -> SupervisorState:
        fine = m.where(m.absolute(u.e) < self.release, 1.0, y.learning)
        waited = m.where(fine > 0.5, m.maximum(0.0, x.waited - self.dt), x.waited + self.dt)
        return SupervisorState(y.learning, y.fault, waited)


@dataclass(frozen=True, eq=False, kw_only=True)
class Guard(Wrapper):
    """Abstract base of a block around one that may raise: where its `update` does, that is logged and the state stays.

    The logger is `steerkit`. What is raised while a loop is traced goes through.
    """

    def tried(self, what: str, do: Callable[..., Any], t: Any, *rest: Any) -> Any:
        """do(t, *rest), or None, and a line in the log, where that raises; what: the method that is tried."""
        try:
            return do(t, *rest)
        except Exception:
            if m.is_symbol(t):  # a block that cannot be traced is no fault of a drive
                raise
            logging.getLogger("steerkit").exception("%s.%s failed at t = %s s", type(self.block).__name__, what, t)
            return None

    def update(self, t: Any, x: Any, u: Any, y: Any) -> State:
        after = self.tried("update", super().update, t, x, u, y)
        return x if after is None else after


@dataclass(frozen=True, eq=False, kw_only=True)
class ExceptionGuard(Guard):
    """Wraps a block so that an exception in it becomes NaN on all its outputs, which a `Supervisor` answers.

    Ports, units, state and sample time are those of `block`. The exception is logged, with its traceback, on the
    logger `steerkit`. The state stays as it was. What `init` or `settle` raise, before the first sample, and what is
    raised while a loop is traced, goes through.
    """

    def output(self, t: Any, x: Any, u: Any) -> Any:
        y = self.tried("output", self.inner_output, t, x, u)
        if y is not None:
            return y
        sizes = [Port(self, out).size for out in self.outputs]
        return self.Y(*[math.nan if n is None else (math.nan,) * n for n in sizes])
