"""A sample's programme, from the state now to the rates that solve it: by parts in Python, or in one call of C."""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit.controllers.mpc import hpipm
from steerkit.controllers.mpc.bound import Bound
from steerkit.controllers.mpc.preparation import Preparation
from steerkit.controllers.mpc.qp import Answer

_P, _LL = ctypes.c_void_p, ctypes.c_longlong
NOTHING, PREDICTION, SOLUTION = 0.0, 1.0, 2.0
"""What is asked of a programme."""
_AHEAD = 7


class _Programme(ctypes.Structure):
    """As in programme.c."""

    _fields_ = [
        *[(name, _P) for name in ("stages", "prepare", "check", "by_speed", "cornering")],
        *[(name, _LL) for name in ("row", "corners", "row_arg", "corners_arg")],
        *[(name, _LL) for name in ("given", "fresh", "gaps", "ahead", "rates")],
        *[(name, _P) for name in ("where", "from_", "gap", "rate", "inputs", "data")],
        *[(name, _P) for name in ("prepared", "found", "answer", "residual")],
    ]


class Found(NamedTuple):
    """What a programme tells."""

    success: Any
    iterations: Any
    residual: Any
    """The largest violation of the optimality conditions; infinite if anything is not finite."""
    ahead: tuple[Any, ...]
    """The six states when the commands on their way have acted, and the curvature of the path there [1/m]."""
    rates: tuple[Any, ...]


class Programme:
    """What is asked, the piece of the model's tables, and the inputs of `prepare` in; the fields of `Found` out.

    NOTHING gives zeros; PREDICTION leaves out the solution. Rates with an infinite residual are zeros. A programme with
    a gap that is not finite (whatever broke in the motion shows there) is not solved.
    """

    def __init__(self, preparation: Preparation, settings: Sequence[float]):
        self.preparation, self.qp, model = preparation, preparation.qp, preparation.model
        sizes = preparation.sizes
        self.given = sum(n for name, n in sizes.items() if name not in ("spline", "steady", "settings"))
        self.inputs, self.ahead = np.zeros(self.given), np.zeros(_AHEAD)
        self.then = np.zeros((len(preparation.times), 7))
        self.fresh = np.zeros(preparation.prepare.size1_out(2))
        self.rates = self.qp.at_u.astype(np.int64)
        self.gaps = (self.qp.first["lba"] + self.qp.place["gap"]).ravel().astype(np.int64)
        self._tables = {"spline": model.by_speed, "steady": model.cornering}
        self._settings = np.array(settings, dtype=float)
        arrays, at = [], 0
        for name, n in sizes.items():
            if name == "settings":
                arrays.append(self._settings)
            elif name in self._tables:
                arrays.append(self._tables[name].reshape(-1)[:n])
            else:
                arrays.append(self.inputs[at : at + n])
                at += n
        self._spline, self._steady = list(sizes).index("spline"), list(sizes).index("steady")
        self._prepare = Bound(preparation.prepare, arrays, [self.ahead, self.then.reshape(-1), self.fresh])

    def __call__(self, *values: float) -> Sequence[float]:
        """On floats: in one call of C where that can be."""
        if not self.qp.in_c:
            return self.by_parts(*values)
        return self._call(*values)

    @cached_property
    def _call(self) -> Callable[..., Sequence[float]]:
        function, itself = self.native
        run = ctypes.CFUNCTYPE(None, _P, _P, _P)(function)
        given, told = np.zeros(2 + self.given), np.zeros(self.size)
        write = struct.Struct(f"{len(given)}d").pack_into
        arguments = _P(itself), _P(given.ctypes.data), _P(told.ctypes.data)

        def call(*values: float) -> Sequence[float]:
            write(given, 0, *values)  # type: ignore[arg-type]
            run(*arguments)
            return told.tolist()

        return call

    def by_parts(self, *values: float) -> Sequence[float]:
        """The same step by step, for any solver."""
        asked, piece = values[:2]
        if not asked > 0.0:
            return (0.0,) * (3 + _AHEAD + len(self.rates))
        self.look(int(piece), values[2:])
        if asked < SOLUTION:
            return (0.0, 0.0, 0.0, *self.ahead.tolist(), *[0.0] * len(self.rates))
        answer = self.solved()
        rates = answer.x[self.rates].tolist() if math.isfinite(answer.residual) else [0.0] * len(self.rates)
        return (float(answer.success), answer.iterations, answer.residual, *self.ahead.tolist(), *rates)

    def look(self, piece: int, values: Sequence[float]) -> None:
        """Compute `ahead`, `then` and `fresh`."""
        self._prepare.point(self._spline, self._tables["spline"][piece])
        self._prepare.point(self._steady, self._tables["steady"][piece : piece + 2].reshape(-1))
        self.inputs[:] = values
        self._prepare()

    def solved(self) -> Answer:
        """Fill the programme with what `look` found, and solve it."""
        where, place = self.preparation.where
        self.qp.numbers[where] = self.fresh[place]
        return self.qp.solve()

    @property
    def size(self) -> int:
        """How many numbers it tells."""
        return 3 + _AHEAD + len(self.rates)

    @cached_property
    def native(self) -> tuple[int, int]:
        """Addresses of a C function `void (void *self, const double *in, double *out)` and of its first argument.

        Raises TypeError for a solver that C does not call.
        """
        qp = self.qp
        if not qp.in_c:
            raise TypeError(f"solver {qp.solver!r} is not called from C here; valid: hpipm, of the casadi wheel")
        prepare, check = self._prepare.c, qp.check.c
        assert prepare is not None, "without a compiler the solver is not called from C either"
        assert check is not None
        where, place = self.preparation.where
        self._struct = _Programme(
            stages=ctypes.addressof(qp.direct.stages),
            prepare=ctypes.addressof(prepare),
            check=ctypes.addressof(check),
            by_speed=_at(self._tables["spline"]),
            cornering=_at(self._tables["steady"]),
            row=self._tables["spline"].shape[1],
            corners=self._tables["steady"].shape[1],
            row_arg=self._spline,
            corners_arg=self._steady,
            given=self.given,
            fresh=len(where),
            gaps=len(self.gaps),
            ahead=_AHEAD,
            rates=len(self.rates),
            where=_at(where),
            from_=_at(place),
            gap=_at(self.gaps),
            rate=_at(self.rates),
            inputs=_at(self.inputs),
            data=_at(qp.numbers),
            prepared=_at(self.ahead),
            found=_at(self.fresh),
            answer=_at(qp.answer),
            residual=_at(qp.residual),
        )
        function = ctypes.cast(hpipm.kernel().programme, _P).value
        assert function is not None
        return function, ctypes.addressof(self._struct)


def _at(array: NDArray[Any]) -> int:
    return array.ctypes.data


def found(values: Sequence[Any]) -> Found:
    """The numbers that a programme tells, by name."""
    success, iterations, residual, *rest = values
    return Found(success, iterations, residual, tuple(rest[:_AHEAD]), tuple(rest[_AHEAD:]))
