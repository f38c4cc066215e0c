"""A loop with a learned policy, driven one control sample at a time, and computed some samples ahead in C."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit._support.native import NoCompilerError, compiler
from steerkit.controllers.nfq_native import Kind, NativeNets, NotTheSameError, OpenPolicy, numbers_of
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.supervisor import ExceptionGuard
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop, LoopState, Sample
from steerkit.diagram.simulation import Log, Recorder, Signal, shown, simulate
from steerkit.scenario.assembly import with_controller

if TYPE_CHECKING:
    from steerkit.compiled.trace import Layout

Backend = Literal["auto", "c", "python"]
AHEAD = 64
"""Samples that are computed at once in C; what comes after an event among them is computed again."""
TRIED = 20
"""Samples that are driven both ways before C is trusted."""
WORTH_COMPILING = 400
"""Samples after which a run that goes on is compiled: before, it may be a short one."""
_NUMBERS = "numbers"


class Refused(RuntimeError):
    """A loop that is interpreted; the message says why."""


class PolicyProgram:
    """C of a loop for all policies like the one in it: made once, for drives that differ in nets, seed and place.

    parameters: block fields that differ too, such as "car.vehicle.m". Traced at once, compiled by `build` (in another
    thread, say) or at its first use. Raises Refused for a loop that can only be interpreted: another controller than
    an `NfqPolicy`, a block that cannot be traced, or one that calls a solver.
    """

    def __init__(self, loop: Loop, parameters: Sequence[str] = ()):
        from steerkit.compiled import TraceError  # here, as CasADi is not for who only interprets
        from steerkit.compiled.exact import ExactProgram

        policy = policy_of(loop)
        self.kind, self._open = Kind(policy), tuple(parameters)
        guard = "block." if isinstance(loop.blocks["controller"], ExceptionGuard) else ""
        try:
            self._exact = ExactProgram(
                with_controller(loop, OpenPolicy.of(policy)),
                ticks=round(policy.dt / loop.dt),
                parameters=[*parameters, f"controller.{guard}{_NUMBERS}"],
            )
        except TraceError as error:
            raise Refused(f"a block cannot be compiled: {error}") from error
        routines = [routine.name for routine in self._exact.trace.routines]
        if len(routines) > 1:  # a solver may begin at what it found before, so that samples cannot be computed twice
            raise Refused(f"{', '.join(routines[1:])} runs code of its own")
        self.layout: Layout = self._exact.trace.layout

    def build(self) -> None:
        """Compile it; raises NoCompilerError."""
        _ = self._exact.library

    def steering(self, loop: Loop) -> Steering:
        """What is open, as it is in that loop; raises NotTheSameError and NoCompilerError as `NativeNets` does, and
        Refused for a policy of another kind."""
        from steerkit.compiled.trace import parameter

        policy = policy_of(loop)
        if Kind(policy) != self.kind:
            raise Refused("the policy is of another kind than the one that was compiled")
        fields = [float(parameter(loop, name)) for name in self._open]
        return Steering(NativeNets(policy), np.array([*fields, *numbers_of(policy)]))

    def run(self, k: int, samples: int, slots: Any, steering: Steering) -> tuple[Any, Any]:
        """See `ExactProgram.run`."""
        return self._exact.run(k, samples, slots, steering.numbers, [steering.nets.addresses])


def program_of(loop: Loop, parameters: Sequence[str] = ()) -> PolicyProgram | None:
    """The program for loops like this one; None where they can only be interpreted, or there is no C compiler."""
    if compiler() is None:
        return None
    try:
        return PolicyProgram(loop, parameters)
    except Refused:
        return None


class Steering(NamedTuple):
    """All that a program leaves open."""

    nets: NativeNets
    numbers: NDArray[np.float64]


class Outputs(Sequence[Any]):
    """The outputs of all blocks, as a loop's list of them, from a row of slots; made when they are asked for."""

    def __init__(self, row: Sequence[float], makers: Sequence[Callable[[Sequence[float]], Any]]):
        self._row, self._makers = row, makers

    def __getitem__(self, i: Any) -> Any:
        return self._makers[i](self._row)

    def __len__(self) -> int:
        return len(self._makers)


class Driver:
    """A loop and its state, advanced one control sample at a time: `begin` it, look at `outputs`, and `end` it.

    backend: "python" interprets; "c" drives in C from the first sample on, and raises Refused where that cannot be;
    "auto" begins interpreted and goes over to C, compiled meanwhile in a thread, once `worth` samples were
    driven; what cannot be compiled stays interpreted, and `why_interpreted` says why. The numbers are the same, bit
    for bit: the first `TRIED` samples in C are interpreted as well and compared, and so is each new net, on some
    states; where they differ, the run stays interpreted. program: made before, for a loop like this one.

    C computes `AHEAD` samples from the state as it is; whoever changes state or policy between two samples (`x`, `y`,
    `steer`) makes it begin anew from there.
    """

    def __init__(
        self,
        loop: Loop,
        *,
        backend: Backend = "auto",
        program: PolicyProgram | None = None,
        worth: int = WORTH_COMPILING,
    ):
        self.loop, self.backend, self.worth = loop, backend, worth
        start = loop.init()
        self._x, self._y = list(start.x), list(start.y)
        self.ticks = round(loop.blocks["controller"].dt / loop.dt)
        self.in_c = 0
        """Samples driven in C."""
        self.why_interpreted = ""
        self._program = program
        self._building: _Building | None = None
        self._steering: Steering | None = None
        self._trusted = False
        self._samples = 0
        self._rows: tuple[list[list[float]], list[list[float]]] = [], []
        self._next = 0
        self._now: Sequence[float] | None = None
        """All slots of now, where C has driven; None: `_x` and `_y` are as of now."""
        if backend == "python":
            self.why_interpreted = "it was asked for"
        elif compiler() is None:
            self._refuse("there is no C compiler")
        elif backend == "c":
            self._make()
            self._join()

    # ---- the state ------------------------------------------------------------------------------------------

    @property
    def x(self) -> list[Any]:
        """The states of all blocks, to look at and to change."""
        self._interpreted()
        return self._x

    @x.setter
    def x(self, x: list[Any]) -> None:
        self._interpreted()
        self._x = x

    @property
    def y(self) -> list[Any]:
        """The outputs of all blocks, to look at and to change."""
        self._interpreted()
        return self._y

    @y.setter
    def y(self, y: list[Any]) -> None:
        self._interpreted()
        self._y = y

    @property
    def outputs(self) -> Sequence[Any]:
        """The outputs of all blocks, to look at."""
        return self._y if self._now is None else Outputs(self._now, self._makers)

    def value(self, signal: str) -> float:
        """A scalar signal of now."""
        if self._now is None:
            i, j = self.loop.locate(signal)
            return self._y[i][j]
        return self._now[self._slot[signal]]

    def state(self, k: int) -> LoopState:
        """All of the state, at tick k."""
        if self._now is None:
            return LoopState(k, tuple(self._x), tuple(self._y))
        x, y = self._layout.unpack(self._now)
        return LoopState(k, tuple(x), tuple(y))

    # ---- driving --------------------------------------------------------------------------------------------

    def begin(self, k: int) -> None:
        """The first tick of the sample at tick k."""
        self._samples += 1
        if self._next < len(self._rows[0]) or self._ahead(k):
            self._now = self._rows[0][self._next]
        else:
            self._interpreted()
            self.loop.advance(k, self._x, self._y)

    def end(self, k: int, ticks: int | None = None) -> None:
        """The other ticks of the sample at tick k; ticks: less than all of them, where the time is up."""
        if ticks is not None and ticks < self.ticks:
            self._interpreted()
        if self._now is not None:
            self._now = self._rows[1][self._next]
            self._next += 1
            self.in_c += 1
            return
        for tick in range(k + 1, k + (ticks or self.ticks)):
            self.loop.advance(tick, self._x, self._y)

    def steer(self, controller: Block) -> None:
        """Another controller of the same ports drives on, from the state as it is."""
        self._interpreted()
        self.loop = with_controller(self.loop, controller)
        self._steering = None

    # ---- inside ---------------------------------------------------------------------------------------------

    def _interpreted(self) -> None:
        """Forget what was computed ahead; states and outputs are objects again."""
        if self._now is not None:
            self._x, self._y = self._layout.unpack(self._now)
            self._now = None
        self._rows, self._next = ([], []), 0

    def _ahead(self, k: int) -> bool:
        """Are there samples from C, from tick k on? Computes them where it can."""
        if self.why_interpreted or (self._program is None and not self._make_in_time()):
            return False
        assert self._program is not None
        if self._building is not None and self._building.is_alive():
            return False
        try:
            if self._steering is None:
                self._steering = self._program.steering(self.loop)
            if not self._trusted:
                self._join()
                self._layout = self._program.layout
                self._slot = {name: first for name, (first, _) in self._layout.signals.items()}
                self._makers = _makers(self._layout)
                if not self._try(k):
                    return False
        except (Refused, NotTheSameError, NoCompilerError) as why:
            self._refuse(str(why))
            return False
        now = self._layout.pack(self._x, self._y) if self._now is None else self._now
        first, last = self._program.run(k, AHEAD, now, self._steering)
        self._rows, self._next = (first.tolist(), last.tolist()), 0
        return len(first) > 0

    def _try(self, k: int) -> bool:
        """Drive some samples both ways; raises Refused where they differ. False: they are to be interpreted."""
        assert self._program is not None
        assert self._steering is not None
        x, y, pack = list(self._x), list(self._y), self._layout.pack
        rows = self._program.run(k, TRIED, pack(x, y), self._steering)
        for first, last in zip(*rows):
            for tick in range(k, k + self.ticks):
                self.loop.advance(tick, x, y)
                row = first if tick == k else last
                if tick in (k, k + self.ticks - 1) and np.array(pack(x, y), dtype=float).tobytes() != row.tobytes():
                    differ = np.flatnonzero(np.array(pack(x, y), dtype=float) != row)
                    names = ", ".join(self._layout.names[i] for i in differ[:3]) or "the sign of a zero"
                    raise Refused(f"C differs from the interpreted loop, first in {names} at {tick * self.loop.dt:g} s")
            k += self.ticks
        self._trusted = len(rows[0]) > 0
        return self._trusted

    def _make_in_time(self) -> bool:
        if self._samples > self.worth:
            try:
                self._make()
            except Refused as why:
                self._refuse(str(why))
        return self._program is not None

    def _make(self) -> None:
        if self._program is None:
            self._program = PolicyProgram(self.loop)
            self._building = _Building(self._program)
            self._building.start()

    def _join(self) -> None:
        if self._building is None:
            return  # a program that was handed over
        self._building.join()
        if self._building.error is not None:
            raise self._building.error

    def _refuse(self, why: str) -> None:
        if self.backend == "c":
            raise Refused(f"the loop cannot be driven in C: {why}")
        self.why_interpreted = why


def driven(
    loop: Loop,
    duration: float,
    *,
    until: Callable[[Sample], bool],
    program: PolicyProgram | None,
    record: Sequence[Signal] | None = None,
    progress: bool = False,
) -> Log:
    """`simulate` with `until`, one sample of the controller kept in each; with a program in C, the same numbers.

    program: made for a loop like this one; None: interpreted.
    """
    every = round(loop.blocks["controller"].dt / loop.dt)
    if program is None:
        return simulate(
            loop, duration, record=record, every=every, until=until, allow_nonfinite=True, progress=progress
        )
    driver, recorder = Driver(loop, program=program), Recorder(loop, record)
    stop = max(1, round(duration / loop.dt))
    k = 0
    for k in shown(range(0, stop, every), progress):
        driver.begin(k)
        recorder.add(k, driver.outputs)
        if until(Sample(loop, k * loop.dt, driver.outputs)):
            return recorder.log(driver.state(k + 1))
        driver.end(k, min(every, stop - k))
    return recorder.log(driver.state(stop))


class _Building(threading.Thread):
    """The compiler at work while the run goes on."""

    def __init__(self, program: PolicyProgram):
        super().__init__(name="steerkit compiler")
        self.program = program
        self.error: NoCompilerError | None = None

    def run(self) -> None:
        try:
            self.program.build()
        except NoCompilerError as error:
            self.error = error


def policy_of(loop: Loop) -> NfqPolicy:
    """The policy that steers a loop; raises Refused for another controller."""
    controller = loop.blocks["controller"]
    policy = controller.block if isinstance(controller, ExceptionGuard) else controller
    if not isinstance(policy, NfqPolicy) or not policy.nets:
        raise Refused(f"a {type(policy).__name__} steers, and no NfqPolicy with nets")
    return policy


def _makers(layout: Layout) -> list[Callable[[Sequence[float]], Any]]:
    """For each block, what makes its outputs of all slots."""
    makers: list[Callable[[Sequence[float]], Any]] = []
    for name, block, old in zip(layout.loop.names, layout.loop.blocks.values(), layout.template.y):
        places = [layout.signals[f"{name}.{out.name}"] for out in block.outputs]
        makers.append(_maker(type(old)._make if hasattr(old, "_make") else tuple, places))
    return makers


def _maker(make: Callable[[Any], Any], places: list[tuple[int, int | None]]) -> Callable[[Sequence[float]], Any]:
    start = places[0][0] if places else 0
    if all(size is None for _, size in places):
        end = start + len(places)
        return lambda row: make(row[start:end])
    return lambda row: make([row[i] if n is None else tuple(row[i : i + n]) for i, n in places])
