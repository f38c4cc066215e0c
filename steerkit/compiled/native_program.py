"""The traced loop as a C library, called through ctypes: one car, or many in SIMD lanes and threads."""

import contextlib
import ctypes
import functools
import itertools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from steerkit._support import native
from steerkit.compiled.c_code import run_source
from steerkit.compiled.trace import Trace
from steerkit.diagram.maths import Routine

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
            _share(work, groups, (stop - k) * groups * self.trace.instructions / len(self.trace.ticks))
        slots = slots.copy()
        slots[self.trace.persistent] = _apart(before)[:, :cars]
        return rows[..., :cars], slots, _apart(state)[:, :cars]


_ENOUGH = 2e6
"""Vector instructions, about two milliseconds, from which on the start of threads is worth its time."""


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


def _share(work: Callable[[int, int], None], groups: int, instructions: float) -> None:
    """Call work(first, last) on parts of the groups, one thread a core where there is enough to do.

    ctypes lets go of the interpreter lock.
    """
    cores = min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, groups)
    if cores == 1 or instructions < _ENOUGH:
        work(0, groups)
        return
    parts = np.linspace(0, groups, 4 * cores + 1 if groups >= 8 * cores else cores + 1).astype(int).tolist()
    with ThreadPoolExecutor(cores) as pool:
        for job in [pool.submit(work, a, b) for a, b in itertools.pairwise(parts)]:
            job.result()
