"""CasADi functions on arrays in place: as C where there is a compiler, else by CasADi's virtual machine."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from steerkit._support import native

Array = NDArray[np.float64]
_P = ctypes.c_void_p


class InC(ctypes.Structure):
    """A generated function with its arguments, as programme.c calls it."""

    _fields_ = [(name, _P) for name in ("run", "arg", "res", "iw", "w")]


class Bound:
    """A CasADi function that reads and writes these arrays whenever it is called: no copies, no conversions.

    in_c: as generated C where there is a compiler (not for one with a solver in it). `c` is then that function with
    its arguments, else None.
    """

    def __init__(
        self, function: casadi.Function, inputs: Sequence[Array], outputs: Sequence[Array], *, in_c: bool = True
    ):
        self._kept: list[Any] = [function, *inputs, *outputs]
        self.c: InC | None = None
        self._call: Callable[[], None]
        if in_c and native.compiler() is not None:
            self._call = self._generated(function, inputs, outputs)
            return
        self._buffer: Any
        self._buffer, self._call = function.buffer()
        for i, array in enumerate(inputs):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore[arg-type]
        for i, array in enumerate(outputs):
            self._buffer.set_res(i, memoryview(array))  # type: ignore[arg-type]

    def _generated(
        self, function: casadi.Function, inputs: Sequence[Array], outputs: Sequence[Array]
    ) -> Callable[[], None]:
        generator = casadi.CodeGenerator("generated", {"with_header": False})
        generator.add(function)
        library = native.load(generator.dump(), fused=True)
        arg, res = (_P * function.sz_arg())(), (_P * function.sz_res())()
        arg[: len(inputs)] = [array.ctypes.data for array in inputs]
        res[: len(outputs)] = [array.ctypes.data for array in outputs]
        work = np.zeros(function.sz_iw() + 1, dtype=np.int64), np.zeros(function.sz_w() + 1)
        run = getattr(library, function.name())
        self._arg = arg
        self._kept += [library, res, *work]
        places = [ctypes.addressof(arg), ctypes.addressof(res), *[array.ctypes.data for array in work]]
        self.c = InC(ctypes.cast(run, _P), *places)
        arguments = (*map(_P, places), ctypes.c_int(0))

        def call() -> None:
            if run(*arguments):
                raise RuntimeError(f"{function.name()} failed")

        return call

    def __call__(self) -> None:
        self._call()

    def point(self, i: int, array: Array) -> None:
        """Input i is read from this array from now on."""
        self._kept[1 + i] = array
        if self.c is None:
            self._buffer.set_arg(i, memoryview(array))  # type: ignore[arg-type]
        else:
            self._arg[i] = array.ctypes.data
