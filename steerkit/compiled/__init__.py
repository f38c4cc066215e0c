"""Loops at the speed of C: `compile` turns a loop into straight-line Python or C.

A loop is run once on symbols (`trace`), which leaves a list of instructions a tick (`graph`); from that list the
backends are generated: `python_code` (floats) and `c_code`. Both give the trajectory of `simulate` to rounding: the
Python code bit for bit, C to about 1e-13. A block with a `steerkit.diagram.maths.Routine` (a solver, for example) runs
in C, which calls its Python function, and in Python.
"""

import contextlib
import ctypes
import functools
import itertools
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np

from steerkit._support import native
from steerkit._support.errors import require
from steerkit._support.native import NoCompilerError, compiler
from steerkit.compiled.c_code import run_source
from steerkit.compiled.python_code import PythonProgram
from steerkit.compiled.trace import Trace, TraceError, parameter, trace, with_parameters
from steerkit.diagram.loop import Loop, LoopState, require_batch
from steerkit.diagram.maths import Routine
from steerkit.diagram.simulation import Log, Signal, check_finite

_LL = ctypes.c_longlong
_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.POINTER(ctypes.c_double), ctypes.c_void_p)


class NativeProgram:
    """C of a loop: a library for one car and one for many, made when first used."""

    def __init__(self, trace: Trace, recorded: Sequence[int], every: int):
        self.trace, self.recorded, self.every = trace, tuple(recorded), every
        calls = [node for tick, _ in trace.kinds for node in tick.graph.nodes if node[0] == "call"]
        inputs = {number: len(arguments) for _, number, _, *arguments in calls}
        self._errors: list[BaseException] = []
        self._callbacks = [self._callback(routine, inputs[i]) for i, routine in enumerate(trace.routines)]
        addresses = [
            address for each in self._callbacks for address in (ctypes.cast(each, ctypes.c_void_p).value, None)
        ]
        self._routines = (ctypes.c_void_p * max(1, len(addresses)))(*addresses)

    def _callback(self, routine: Routine, inputs: int) -> Any:
        """The routine as a C function `void (void *unused, const double *given, double *result)`.

        An error in it cannot pass through C: the run ends with NaN, and `_held` raises it then.
        """
        size = routine.size

        def call(_: Any, given: Any, result: int) -> None:
            values: list[Any] = [math.nan] * size
            try:
                if not self._errors:
                    values = list(routine.call(*given[:inputs]))
            except BaseException as error:
                self._errors.append(error)
            (ctypes.c_double * size).from_address(result)[:] = values

        return _CALLBACK(call)

    @functools.cache  # noqa: B019 (lives as long as the program)
    def _run(self, many: bool) -> Any:
        """The C function that runs cars: one at a time, or in groups of several."""
        return native.load(run_source(self.trace, self.recorded, many=many), fused=True, vector_maths=many)

    @contextlib.contextmanager
    def _held(self) -> Iterator[None]:
        """With the locks of all routines; raises the first error of one of them."""
        with contextlib.ExitStack() as held:
            for routine in self.trace.routines:
                held.enter_context(routine.lock)
            self._errors.clear()
            yield
            if self._errors:
                raise self._errors[0]

    def run(
        self, k: int, stop: int, slots: np.ndarray, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ticks k to stop - 1 of N cars from all slots (S, N), with parameters (P, N): rows recorded (T, R, N), the
        slots before the last tick (S, N), as far as it reads them, and those that go on (C, N)."""
        every, last, cars, alone = self.every, stop - 1, slots.shape[1], bool(self.trace.routines)
        library = self._run(cars > 1 and not alone)
        lanes = library.lanes()
        groups = -(-cars // lanes)
        state, fixed = _grouped(slots[self.trace.persistent], lanes, groups), _grouped(parameters, lanes, groups)
        rows, before = np.empty((_kept(k, stop, every), len(self.recorded), groups * lanes)), np.empty_like(state)

        def work(first: int, past: int) -> None:
            def go(k: int, stop: int, rows: np.ndarray) -> None:
                span = map(_LL, (k, stop, every, first, past, groups * lanes))
                library.run(*span, _at(state), _at(fixed), _at(rows), self._routines)

            go(k, last, rows)
            before[first:past] = state[first:past]
            go(last, stop, rows[_kept(k, last, every) :])

        if alone:
            with self._held():
                work(0, groups)
        else:
            _share(work, groups, stop - k)
        slots = slots.copy()
        slots[self.trace.persistent] = _apart(before)[:, :cars]
        return rows[..., :cars], slots, _apart(state)[:, :cars]


_ENOUGH = 2000.0
"""Ticks of groups, about two milliseconds of usual loops, from which on the start of threads is worth its time."""


def _kept(k: int, stop: int, every: int) -> int:
    return -(-stop // every) - -(-k // every)


def _at(array: np.ndarray) -> Any:
    return ctypes.c_void_p(array.ctypes.data)


def _grouped(rows: np.ndarray, lanes: int, groups: int) -> np.ndarray:
    """(n, N) as (groups, n, lanes), the last car repeated to fill the last group."""
    padded = np.pad(rows, ((0, 0), (0, groups * lanes - rows.shape[1])), mode="edge")
    return np.ascontiguousarray(padded.reshape(len(rows), groups, lanes).transpose(1, 0, 2))


def _apart(groups: np.ndarray) -> np.ndarray:
    """(groups, n, lanes) as (n, cars), the inverse of `_grouped` with its padding."""
    return groups.transpose(1, 0, 2).reshape(groups.shape[1], -1)


def _share(work: Callable[[int, int], None], groups: int, ticks: int) -> None:
    """Call work(first, last) on parts of the groups, one thread a core where there is enough to do.

    ctypes lets go of the interpreter lock.
    """
    cores = min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, groups)
    if cores == 1 or ticks * groups < _ENOUGH:
        work(0, groups)
        return
    parts = np.linspace(0, groups, 4 * cores + 1 if groups >= 8 * cores else cores + 1).astype(int).tolist()
    with ThreadPoolExecutor(cores) as pool:
        for job in [pool.submit(work, a, b) for a, b in itertools.pairwise(parts)]:
            job.result()


__all__ = ["Compiled", "NoCompilerError", "TraceError", "compile"]

Backend = Literal["auto", "python", "c"]


def compile(
    loop: Loop,
    *,
    backend: Backend = "auto",
    record: Sequence[Signal] | None = None,
    every: int = 1,
    parameters: Sequence[str] = (),
) -> "Compiled":
    """A loop as fast as the machine allows; runs give the same `Log` as `simulate`.

    backend: "c" (through gcc, kept in a cache on disk; for one car and for many), "python" (generated floats, quickest
    to make) or "auto": C where there is a compiler, else Python and a warning.
    record: signals to keep (default: all); every: keep one tick in `every`. parameters: block fields to leave open,
    such as "controller.k" or "car.vehicle.m"; `run` takes a value for each, or one a car.

    Raises TraceError naming a block that cannot be compiled, with what to do; NoCompilerError for backend "c" without
    a compiler; KeyError for an unknown signal; ValueError for a bad argument.
    """
    require(every >= 1, "compile", f"every = {every}, expected a whole number >= 1")
    require(backend in ("auto", "python", "c"), "compile", f"backend {backend!r}; valid: auto, python, c")
    if backend != "python" and not compiler():
        if backend == "c":
            raise NoCompilerError("compile: backend 'c' needs a C compiler: install gcc or set CC; or 'python'")
        warnings.warn("no C compiler found: the loop runs in generated Python; install gcc or set CC", stacklevel=2)
        backend = "python"
    traced = trace(loop, parameters=parameters, routines=True)
    names = list(loop.units) if record is None else [r if isinstance(r, str) else loop.port_name(r) for r in record]
    for name in names:
        loop.locate(name)
    return Compiled(loop, "python" if backend == "python" else "c", tuple(names), every, tuple(parameters), traced)


@dataclass(frozen=True)
class Compiled:
    """A compiled loop; made by `compile`, whose arguments it has. `backend` is the one in use."""

    loop: Loop
    backend: Literal["python", "c"]
    record: tuple[str, ...]
    every: int
    parameters: tuple[str, ...]
    trace: Trace

    @cached_property
    def _slots(self) -> list[int]:
        return [slot for name in self.record for slot in self.trace.layout.slots_of(name)]

    def run(
        self,
        duration: float,
        *,
        state: LoopState | None = None,
        batch: int | None = None,
        parameters: Mapping[str, Any] | None = None,
        allow_nonfinite: bool = False,
    ) -> Log:
        """Run for `duration` seconds and return the recorded signals, as `simulate` does.

        state: where to start (default: `loop.init()`); `log.state` goes on with it. batch: number of cars.
        parameters: a value, or (N,) values, for each field named in `compile(parameters=...)`; by default the
        blocks' own. Raises ValueError for a bad argument, NonFiniteError as `simulate` does.
        """
        if not (math.isfinite(duration) and duration > 0.0):
            raise ValueError(f"run: duration = {duration} s, expected a finite number > 0")
        require_batch("run", batch)
        given, open_ones = dict(parameters or {}), ", ".join(self.parameters) or "none"
        for name in given:
            left_open = f"parameter '{name}' was not left open, compile(parameters=[...]); open: {open_ones}"
            require(name in self.parameters, "run", left_open)
        values = {n: given[n] if n in given else parameter(self.loop, n) for n in self.trace.parameters}
        cars = _cars(values, batch)
        if state is None:
            state = with_parameters(self.loop, given).init(batch=cars)
        slots = self.trace.layout.pack(state.x, state.y)
        if len(slots) != len(self.trace.layout):
            what = f"a state of {len(slots)} numbers, the compiled loop has {len(self.trace.layout)}"
            raise ValueError(f"run: {what}; a parameter that decides how many there are cannot be left open")
        cars = _cars({"state": next((v for v in slots if np.ndim(v)), 0.0)} | values, cars)
        stop = state.k + max(1, round(duration / self.loop.dt))
        n = 1 if cars is None else cars
        wide, fixed = (
            np.array([np.broadcast_to(np.asarray(v, dtype=float), (n,)) for v in numbers]).reshape(-1, n)
            for numbers in (slots, values.values())
        )
        runs = self._program.run if self.backend == "c" else self._floats
        rows, before, carried = runs(state.k, stop, wide, fixed)
        kept = rows[-1:].copy() if (stop - 1) % self.every == 0 else rows[:0]  # the caller may write into the rows
        end = partial(self._state, stop, before, fixed, carried, kept, one=cars is None)
        log = self._log(state.k, stop, rows[..., 0] if cars is None else rows, end)
        if not allow_nonfinite:
            check_finite(log)
        return log

    def _floats(
        self, k: int, stop: int, slots: np.ndarray, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `NativeProgram.run`, car by car."""
        run, persistent, rows, carried = self._program.run, self.trace.persistent, list[Any](), list[Any]()
        before = slots.copy()
        for car, (start, fixed) in enumerate(zip(slots.T.tolist(), parameters.T.tolist(), strict=True)):
            kept: list[tuple[float, ...]] = []
            before[persistent, car] = run(k, stop - 1, start, fixed, kept)
            carried.append(run(stop - 1, stop, before[:, car].tolist(), fixed, kept))
            rows.append(np.array(kept, dtype=float).reshape(len(kept), len(self._slots)))
        return np.stack(rows, axis=-1), before, np.array(carried, dtype=float).reshape(len(carried), -1).T

    @cached_property
    def _program(self) -> Any:
        kind = NativeProgram if self.backend == "c" else PythonProgram
        return kind(self.trace, self._slots, self.every)

    def _state(self, stop: int, slots: Any, fixed: Any, carried: Any, kept: Any, *, one: bool) -> LoopState:
        """The state after a run, by the loop itself from the slots (S, N) before the last tick; what goes on, and what
        was kept of that tick, is as the run has rounded it: going on from there is going on."""
        cars = zip(slots.T.tolist(), fixed.T.tolist()) if self.backend == "python" else [(slots, fixed)]
        slots[:] = np.column_stack([self._ticked(stop - 1, *car) for car in cars])
        slots[self.trace.persistent] = carried
        for row in kept:
            slots[self._slots] = row
        x, y = self.trace.layout.unpack(slots[:, 0].tolist() if one else list(slots))
        return LoopState(stop, tuple(x), tuple(y))

    def _ticked(self, k: int, slots: Any, fixed: Any) -> np.ndarray:
        """The slots after tick k: (S,) of one car's floats, or (S, N)."""
        loop = with_parameters(self.loop, dict(zip(self.trace.parameters, fixed)))
        x, y = self.trace.layout.unpack(slots)
        with np.errstate(all="ignore"):
            loop.advance(k, x, y)
        return np.stack(np.broadcast_arrays(*self.trace.layout.pack(x, y)))

    def _log(self, k: int, stop: int, rows: np.ndarray, end: Callable[[], LoopState]) -> Log:
        signals, column = {}, 0
        for name in self.record:
            _, size = self.trace.layout.signals[name]
            width = 1 if size is None else size
            part = rows[:, column : column + width]
            signals[name] = part[:, 0] if size is None else part if size else np.empty((len(rows), 0))
            column += width
        ticks = np.arange(k + -k % self.every, stop, self.every, dtype=float)
        units = {name: self.loop.units[name] for name in self.record}
        return Log(ticks * self.loop.dt, signals, units, loop=self.loop, state=end)


def _cars(values: Mapping[str, Any], batch: int | None) -> int | None:
    """The number of cars that values and `batch` agree on; None for one car without a batch."""
    sizes = {name: np.shape(value)[0] for name, value in values.items() if np.ndim(value)}
    if batch is not None:
        sizes["batch"] = batch
    if len(set(sizes.values())) > 1:
        raise ValueError(f"run: different numbers of cars: {', '.join(f'{n} {c}' for n, c in sizes.items())}")
    return next(iter(sizes.values()), None)
