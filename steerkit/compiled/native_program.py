"""The traced loop as a C library, called through ctypes: one car, or many in SIMD lanes and threads."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from steerkit import native
from steerkit.compiled.c_code import finish_source, run_source
from steerkit.compiled.trace import Trace, TraceError
from steerkit.maths import Routine

_LL = ctypes.c_longlong


class NativeProgram:
    """C of a loop: a library for one car or many, and one for each kind of tick to end with, made when first used."""

    def __init__(self, trace: Trace, recorded: Sequence[int], every: int):
        self.trace, self.recorded, self.every = trace, tuple(recorded), every
        addresses = [address for routine in trace.routines for address in _native(routine)]
        self._routines = (ctypes.c_void_p * max(1, len(addresses)))(*addresses)

    @functools.cached_property
    def one(self) -> ctypes.CDLL:
        """The library that runs one car."""
        return _load(run_source(self.trace, self.recorded, many=False), many=False)

    @functools.cached_property
    def many(self) -> ctypes.CDLL:
        """The library that runs cars in groups of `many.lanes()`."""
        return _load(run_source(self.trace, self.recorded, many=True), many=True)

    @functools.cached_property
    def _effort(self) -> float:
        """Instructions of a tick."""
        return self.trace.instructions / len(self.trace.ticks)

    def finish(self, k: int, *, many: bool = False) -> Any:
        """The C function that takes the tick k and gives all slots."""
        return self._finish(self.trace.kind(k), many).finish

    @functools.cache  # noqa: B019 (lives as long as the program)
    def _finish(self, number: int, many: bool) -> ctypes.CDLL:
        return _load(finish_source(self.trace, number, many=many), many=many)

    def run(self, k: int, stop: int, slots: np.ndarray, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ticks k to stop - 1 of one car from all its slots: (rows recorded, all slots after the last tick)."""
        rows = np.empty((_kept(k, stop, self.every), len(self.recorded)))
        carried, end = slots[self.trace.carried], np.empty(len(slots))
        with contextlib.ExitStack() as held:
            for routine in self.trace.routines:
                held.enter_context(routine.lock)
            span = _LL(k), _LL(stop - 1), _LL(self.every)
            self.one.run(*span, _at(carried), _at(parameters), _at(rows), self._routines)
            self.finish(stop - 1)(_LL(stop - 1), _at(carried), _at(parameters), _at(end), self._routines)
        self._record_last(stop - 1, rows, end)
        return rows, end

    def run_many(self, k: int, stop: int, slots: np.ndarray, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same for N cars: slots (S, N), parameters (P, N) to rows (T, R, N) and slots (S, N).

        With a routine in the loop one after the other.
        """
        if self.trace.routines:
            alone = [self.run(k, stop, np.array(s), np.array(p)) for s, p in zip(slots.T, parameters.T, strict=True)]
            return np.stack([rows for rows, _ in alone], axis=-1), np.stack([end for _, end in alone], axis=-1)
        library, finish = self.many, self.finish(stop - 1, many=True)
        carried, every = self.trace.carried, self.every
        lanes, cars = library.lanes(), slots.shape[1]
        groups = -(-cars // lanes)
        padded = groups * lanes
        state, fixed = _grouped(slots[carried], lanes, groups), _grouped(parameters, lanes, groups)
        rows = np.empty((_kept(k, stop, every), len(self.recorded), padded))
        end = np.empty((groups, len(slots), lanes))

        def work(first: int, last: int) -> None:
            span = _LL(first), _LL(last)
            library.run(_LL(k), _LL(stop - 1), _LL(every), *span, _LL(padded), _at(state), _at(fixed), _at(rows))
            finish(_LL(stop - 1), *span, _at(state), _at(fixed), _at(end))

        _share(work, groups, (stop - k) * groups * self._effort)
        all_slots = end.transpose(1, 0, 2).reshape(len(slots), padded)[:, :cars]
        rows = rows[:, :, :cars]
        self._record_last(stop - 1, rows, all_slots)
        return rows, all_slots

    def _record_last(self, k: int, rows: np.ndarray, end: np.ndarray) -> None:
        if k % self.every == 0 and self.recorded:
            rows[-1] = end[list(self.recorded)]


def _load(source: str, *, many: bool) -> ctypes.CDLL:
    return native.load(source, fused=True, vector_maths=many)


_ENOUGH = 2e6
"""Vector instructions, about two milliseconds, from which on the start of threads is worth its time."""


def _native(routine: Routine) -> tuple[int, int]:
    try:
        return routine.native()
    except TypeError as error:
        raise TraceError(f"{routine.name} cannot be called from C: {error}; or backend='python'") from error


def _kept(k: int, stop: int, every: int) -> int:
    return -(-stop // every) - -(-k // every)


def _at(array: np.ndarray) -> Any:
    return ctypes.c_void_p(array.ctypes.data)


def _grouped(rows: np.ndarray, lanes: int, groups: int) -> np.ndarray:
    """(n, N) as (groups, n, lanes), the last car repeated to fill the last group."""
    padded = np.pad(rows, ((0, 0), (0, groups * lanes - rows.shape[1])), mode="edge")
    return np.ascontiguousarray(padded.reshape(len(rows), groups, lanes).transpose(1, 0, 2))


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
