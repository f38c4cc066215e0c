"""The traced loop as a C library, called through ctypes: one car, or many in SIMD lanes and threads."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
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
Slots = Callable[[], Any]
"""All slots after a run, (S, N), computed when they are asked for."""


class NativeProgram:
    """C of a loop: a library for one car or many, and one for each kind of tick to end with, made when first used."""

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

    @functools.cache  # noqa: B019 (lives as long as the program)
    def _last(self, phase: int, many: bool, optimise: bool | None) -> tuple[Any, list[int]]:
        """The C function that takes one tick and records all slots, and the persistent slots that it starts from, by
        their place among the run's; optimise: False where it runs once."""
        alone = dataclasses.replace(self.trace, ticks=(self.trace.ticks[phase],))
        source = run_source(alone, range(len(alone.layout)), many=many)
        library = native.load(source, fused=True, vector_maths=many, optimise=optimise)
        return library.run, [self.trace.persistent.index(slot) for slot in alone.persistent]

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

    def run(self, k: int, stop: int, slots: np.ndarray, parameters: np.ndarray) -> tuple[np.ndarray, Slots]:
        """Ticks k to stop - 1 of N cars from all slots (S, N), with parameters (P, N): rows recorded (T, R, N), and how
        to get all slots (S, N) after the last.

        Those are computed when they are asked for: the code for them is as long again as the run's. A solver must not
        be asked twice, so with a routine in the loop, which runs car by car, they are the last tick.
        """
        every, last, cars, alone = self.every, stop - 1, slots.shape[1], bool(self.trace.routines)
        many = cars > 1 and not alone
        library = self._run(many)
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
            if not alone:
                go(last, stop, rows[_kept(k, last, every) :])

        def finished(*, optimise: bool | None = None) -> np.ndarray:
            ticks, slots = self.trace.ticks, np.empty((len(self.trace.layout), groups * lanes))
            tick, carried = self._last(ticks.index(ticks[last % len(ticks)]), many, optimise)
            start, span = np.take(before, carried, axis=1), map(_LL, (last, stop, 1, 0, groups, groups * lanes))
            tick(*span, _at(start), _at(fixed), _at(slots), self._routines)
            return slots[:, :cars]

        kept_last = last % every == 0 and bool(self.recorded)
        if alone:
            with self._held():
                work(0, groups)
                after = finished()
            if kept_last:
                rows[-1] = after[list(self.recorded)]
            return rows, lambda: after
        _share(work, groups, (stop - k) * groups * self.trace.instructions / len(self.trace.ticks))
        rows = rows[..., :cars]
        row = rows[-1:].copy()  # the caller may write into the rows

        def end() -> np.ndarray:
            """As the run has rounded them, where it kept them: going on from there is going on."""
            after = finished(optimise=None if many else False)
            after[self.trace.persistent] = _apart(state)[:, :cars]
            if kept_last:
                after[list(self.recorded)] = row[0]
            return after

        return rows, end


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
