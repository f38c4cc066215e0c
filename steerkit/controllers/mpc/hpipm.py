"""HPIPM called on arrays in place, without an interface's work around each solution."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from numpy.typing import NDArray

from steerkit._support import native

if TYPE_CHECKING:
    from steerkit.controllers.mpc.qp import StageQp

Array = NDArray[np.float64]
SOURCE = Path(__file__).with_name("programme.c")
_SPEED = 1  # HPIPM's mode
_OPTIONS = {"iter_max": 40, "mu0": 1e-4, **dict.fromkeys(("tol_stat", "tol_eq", "tol_ineq", "tol_comp"), 1e-7)}
_P, _LL = ctypes.c_void_p, ctypes.c_longlong


class Part(ctypes.Structure):
    """A block of a stage that HPIPM is told or asked for, and where its numbers are."""

    _fields_ = [("call", _P), ("stage", _LL), ("first", _LL), ("size", _LL)]


class Stages(ctypes.Structure):
    """As in programme.c."""

    _fields_ = [
        *[(name, _P) for name in ("set", "get")],
        *[(name, _LL) for name in ("sets", "gets", "answers")],
        *[(name, _P) for name in ("from_", "plus", "minus", "sign", "data", "now", "before", "told", "answer")],
        *[(name, _P) for name in ("qp", "sol", "options", "work", "solve", "status", "iterations")],
    ]


@functools.cache
def library() -> ctypes.CDLL | None:
    """HPIPM as the casadi wheel brings it; None where CasADi was built in another way."""
    found = Path(casadi.__path__[0]) / "libhpipm.so"
    return ctypes.CDLL(str(found)) if found.exists() else None


@functools.cache
def kernel() -> ctypes.CDLL:
    """The compiled programme.c; raises NoCompilerError without a working C compiler."""
    return native.load(SOURCE.read_text(encoding="utf-8"))


def there() -> bool:
    """Can it be called from C on this machine?"""
    return native.compiler() is not None and library() is not None


class Hpipm:
    """HPIPM for stages of the given sizes, on numbers at given places of an array.

    nx, nu, ng: states, inputs, and rows that limit them, of each stage; bounds: which inputs and states have bounds.
    parts: (name of HPIPM's setter, stage, places in `data`, sign): a number told is sign * data[place]. sizes: of
    what each stage is asked for, by name of HPIPM's getter. answers: for each number of `answer` its two terms, the
    second to be subtracted, as (getter, stage, entry) or None.
    """

    def __init__(
        self,
        *,
        nx: Sequence[int],
        nu: Sequence[int],
        ng: Sequence[int],
        bounds: Sequence[tuple[list[int], list[int]]],
        parts: Sequence[tuple[str, int, Any, float]],
        answers: Sequence[tuple[Any, Any]],
        sizes: dict[str, Sequence[int]],
        data: Array,
        answer: Array,
        options: dict[str, float],
    ):
        hpipm = library()
        assert hpipm is not None, "ask `there` first"
        self._kept: list[Any] = [data, answer]

        def call(name: str, *arguments: Any, kind: Any = None) -> Any:
            function = getattr(hpipm, f"d_ocp_qp_{name}")
            function.restype = kind
            return function(*arguments)

        def made(name: str, size: Sequence[Any], create: Callable[[Any, Any], Any]) -> Any:
            memory = [
                self._memory(call(f"{name}strsize", kind=ctypes.c_size_t)),
                self._memory(call(f"{name}memsize", *size, kind=ctypes.c_size_t)),
            ]
            create(*memory)
            return memory[0]

        n = len(nx) - 1
        dim = made("dim_", [ctypes.c_int(n)], lambda a, b: call("dim_create", n, a, b))
        for k in range(n + 1):
            counts = {"nx": nx[k], "nu": nu[k], "ng": ng[k], "nbu": len(bounds[k][0]), "nbx": len(bounds[k][1])}
            for name, count in counts.items():
                call(f"dim_set_{name}", k, count, dim)
        qp = made("", [dim], lambda a, b: call("create", dim, a, b))
        call("set_all_zero", qp)
        for k, both in enumerate(bounds):
            for name, entries in zip(("idxbu", "idxbx"), both):
                if entries:
                    call(f"set_{name}", k, self._at(np.array(entries, dtype=np.int32)), qp)
        sol = made("sol_", [dim], lambda a, b: call("sol_create", dim, a, b))
        arg = made("ipm_arg_", [dim], lambda a, b: call("ipm_arg_create", dim, a, b))
        call("ipm_arg_set_default", _SPEED, arg)
        for name, value in options.items():
            number = ctypes.c_int(value) if isinstance(value, int) else ctypes.c_double(value)
            call(f"ipm_arg_set_{name}", ctypes.byref(number), arg)
        work = made("ipm_ws_", [dim, arg], lambda a, b: call("ipm_ws_create", dim, arg, a, b))

        def address(name: str) -> Any:
            return ctypes.cast(getattr(hpipm, f"d_ocp_qp_{name}"), _P)

        places, told, count = list[NDArray[np.int64]](), list[Part](), 0
        for name, stage, at, _ in parts:
            places.append(np.ravel(at).astype(np.int64))
            told.append(Part(address(f"set_{name}"), stage, count, len(places[-1])))
            count += len(places[-1])
        signs = np.repeat([sign for *_, sign in parts], [len(at) for at in places])
        first: dict[tuple[str, int], int] = {}
        asked, end = [], 0
        for name, each in sizes.items():
            for stage, size in enumerate(each):
                if size:
                    asked.append(Part(address(f"sol_get_{name}"), stage, end, size))
                    first[name, stage] = end
                    end += size
        terms = [[end if t is None else first[t[0], t[1]] + t[2] for t in both] for both in answers]
        plus, minus = (np.array(column, dtype=np.int64) for column in zip(*terms))
        now = np.zeros(count)
        self.stages = Stages(
            set=self._parts(told),
            get=self._parts(asked),
            sets=len(told),
            gets=len(asked),
            answers=len(answers),
            from_=self._at(np.concatenate(places)),
            plus=self._at(plus),
            minus=self._at(minus),
            sign=self._at(signs),
            data=self._at(data),
            now=self._at(now),
            before=self._at(np.full_like(now, np.nan)),
            told=self._at(np.zeros(end + 1)),
            answer=self._at(answer),
            qp=qp,
            sol=sol,
            options=arg,
            work=work,
            solve=address("ipm_solve"),
            status=address("ipm_get_status"),
            iterations=address("ipm_get_iter"),
        )
        self.said = np.zeros(2)
        self._run = kernel().solve
        self._arguments = ctypes.byref(self.stages), self._at(self.said)

    def solve(self) -> tuple[float, bool]:
        """Solve for the numbers now in `data`, into `answer`: iterations, and did it succeed?"""
        self._run(*self._arguments)
        return float(self.said[1]), bool(self.said[0])

    def _memory(self, size: int) -> Any:
        block = np.zeros(size + 64, dtype=np.uint8)
        self._kept.append(block)
        return _P(block.ctypes.data + -block.ctypes.data % 64)

    def _at(self, array: NDArray[Any]) -> Any:
        self._kept.append(array)
        return _P(array.ctypes.data)

    def _parts(self, parts: list[Part]) -> Any:
        block = (Part * len(parts))(*parts)
        self._kept.append(block)
        return ctypes.cast(block, _P)


def of(qp: StageQp) -> Hpipm:
    """HPIPM for this programme, on its `numbers` and `answer`; only rate and command have bounds."""
    n, nx, at = qp.horizon, qp.nx, qp.place
    first = qp.first
    soft = {k: i for i, k in enumerate(qp.soft)}
    zero = len(qp.numbers) - 1
    states, inputs = [0, *[nx] * n], [*qp.inputs, 0]
    parts: list[tuple[str, int, Any, float]] = []
    for k in range(n + 1):
        x, u = first["g"] + qp.at_x[k - 1] + np.arange(states[k]), np.arange(inputs[k])
        if k < n:
            b = np.full((inputs[k], nx), zero)  # column by column, as all matrices
            b[0] = first["a"] + at["b"][k]
            r = np.full((inputs[k], inputs[k]), zero)
            r[u, u] = first["h"] + np.append(at["r"][k], at["r_slack"][soft[k]] if k in soft else [])
            parts += [("B", k, b, 1.0), ("b", k, first["lba"] + at["gap"][k], -1.0), ("R", k, r, 1.0)]
            parts += [("r", k, first["g"] + qp.at_u[k] + u, 1.0)]
            parts += [(f"{s}bu", k, first[f"{s}bx"] + qp.at_u[k], 1.0) for s in "lu"]
        if k:
            q = np.full((nx, nx), zero)
            if k < n:
                parts += [("A", k, first["a"] + at["a"][k - 1].T, 1.0)]
                q[np.arange(nx), np.arange(nx)] = first["h"] + at["q"][k - 1]
            else:
                q = first["h"] + at["p"]
            parts += [("Q", k, q, 1.0), ("q", k, x, 1.0)]
            parts += [(f"{s}bx", k, first[f"{s}bx"] + at["x"][k - 1, -1], 1.0) for s in "lu"]
        if k in soft:
            d = np.full((inputs[k], 2), zero)
            d[[1, 2], [0, 1]] = first["a"] + at["slack"][soft[k]]
            parts += [("C", k, first["a"] + at["rows"][soft[k]].T, 1.0), ("D", k, d, 1.0)]
            parts += [(f"{s}g", k, first[f"{s}ba"] + at["limit"][soft[k]], 1.0) for s in "lu"]
    limits = [2 if k in soft else 0 for k in range(n + 1)]
    z, rows = qp.size
    terms: list[tuple[Any, Any]] = [(None, None)] * (2 * z + rows)
    for k in range(n):
        for i in range(inputs[k]):
            j = qp.at_u[k] + i
            terms[j] = ("u", k, i), None
        terms[z + qp.at_u[k]] = ("lam_ubu", k, 0), ("lam_lbu", k, 0)
        terms[z + qp.at_x[k] + nx - 1] = ("lam_ubx", k + 1, 0), ("lam_lbx", k + 1, 0)
        for i in range(nx):
            j = qp.at_x[k] + i
            terms[j] = ("x", k + 1, i), None
            terms[2 * z + at["gap"][k][i]] = ("pi", k, i), None
        for i in range(limits[k]):
            terms[2 * z + at["limit"][soft[k]][i]] = ("lam_ug", k, i), ("lam_lg", k, i)
    return Hpipm(
        nx=states,
        nu=inputs,
        ng=limits,
        bounds=[([0] if k < n else [], [nx - 1] if k else []) for k in range(n + 1)],
        parts=parts,
        answers=terms,
        sizes={
            "u": inputs,
            "x": states,
            "lam_lbu": [1] * n,
            "lam_ubu": [1] * n,
            "lam_lbx": [0, *[1] * n],
            "lam_ubx": [0, *[1] * n],
            "lam_lg": limits,
            "lam_ug": limits,
            "pi": [nx] * n,
        },
        data=qp.numbers,
        answer=qp.answer,
        options=_OPTIONS,
    )
