"""Many cars of one loop kept in compiled C: set inputs, go some ticks, look at the outputs, put single cars back."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit.compiled.native_program import NativeProgram
from steerkit.compiled.trace import Trace, trace
from steerkit.diagram.loop import Loop

Array = NDArray[np.float64]
_LL = ctypes.c_longlong


class Fleet:
    """N cars of a loop, advanced in place by whole periods of it; one thread, no records.

    Where `Compiled.run` runs long and returns a log, a fleet is for a caller that decides between samples (an external
    learner): `set` writes a number into every car's state, `advance` runs one period, `look` computes the outputs of
    the tick that comes next without taking it, `put` starts single cars anew. The loop's time stands still at t = 0,
    as cars that start anew at different moments share no clock.

    Raises ValueError for a loop in which something depends on t, NoCompilerError without a C compiler, TraceError as
    `compile` does.
    """

    def __init__(self, loop: Loop, cars: int):
        self.loop, self.cars = loop, cars
        self.trace: Trace = trace(loop)
        self.trace.require_timeless("Fleet")
        program = NativeProgram(self.trace, (), 1)
        self._library, self._last = program.many, program.finish(0, many=True)
        self.lanes: int = self._library.lanes()
        self._groups = -(-cars // self.lanes)
        self._persistent = np.array(self.trace.persistent)
        self._state = np.zeros((self._groups, len(self._persistent), self.lanes))
        self._all = np.empty((self._groups, len(self.trace.layout), self.lanes))
        none = np.zeros((self._groups, 1, self.lanes))
        self._arrays = self._state, none, self._all  # kept, as C is given their addresses
        at = [ctypes.c_void_p(array.ctypes.data) for array in self._arrays]
        span = _LL(0), _LL(self._groups)
        self._run = _LL(0), _LL(loop.period), _LL(1), *span, _LL(self._groups * self.lanes), *at
        self._finish = _LL(0), *span, *at

    def state_slot(self, block: str, entry: int = 0) -> int:
        """The slot of a block's state entry, for `set`."""
        before = self.trace.layout.template.x[: self.loop.names.index(block)]
        return sum(len(x) for x in before) + entry

    def signal_slot(self, name: str) -> int:
        """The slot of a scalar signal, a row of what `look` gives."""
        return self.trace.layout.slots_of(name)[0]

    def put(self, cars: NDArray[np.intp], x: Sequence[Any], y: Sequence[Any]) -> None:
        """Start the cars of these numbers from states and outputs whose entries are numbers or (len(cars),) arrays."""
        packed = self.trace.layout.pack(x, y)
        rows = np.array(
            [np.broadcast_to(np.asarray(packed[slot], dtype=float), cars.shape) for slot in self._persistent]
        )
        if cars[-1] == self.cars - 1:  # the lanes that no car has follow the last one
            spare = np.arange(self.cars, self._groups * self.lanes)
            cars, rows = np.append(cars, spare), np.append(rows, np.repeat(rows[:, -1:], len(spare), axis=1), axis=1)
        self._state[cars // self.lanes, :, cars % self.lanes] = rows.T

    def set(self, slot: int, values: Array) -> None:
        """Write `values` (N,) into a slot of the state."""
        row = np.full(self._groups * self.lanes, values[-1])
        row[: self.cars] = values
        self._state[:, np.searchsorted(self._persistent, slot)] = row.reshape(self._groups, self.lanes)

    def advance(self) -> None:
        """Run one period of the loop."""
        self._library.run(*self._run)

    def look(self) -> Array:
        """All slots (S, N) after the first tick of the next period, which is not taken: its outputs are as of now."""
        self._last(*self._finish)
        return self._all.transpose(1, 0, 2).reshape(len(self.trace.layout), -1)[:, : self.cars]
