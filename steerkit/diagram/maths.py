"""The functions that equations are written with: one formula for every backend.

Each function takes Python floats (fast, by `math`), NumPy arrays (a batch of cars) or symbols
(a trace's for C, CasADi's). Equations use these and plain arithmetic, `where` for `if`, nothing else.
Neither NumPy's dispatch nor CasADi is paid for when the arguments are floats.
"""

import functools
import math
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Scalar = Any
"""A float, an `(N,)` array (one entry a car) or a symbol, of a trace or of CasADi."""

pi = math.pi


_NUMBERS = (float, np.ndarray)
_FUNCTIONS: dict[type, Any] = {}
"""For each type met: what computes with it, None if it is no symbol."""


def _functions(x: Scalar) -> Any:
    """What has the functions for `x`: CasADi, or what another kind of symbol names as `functions`; None: a number."""
    kind = type(x)
    if kind not in _FUNCTIONS:
        of_casadi = any(base.__module__.startswith("casadi") for base in kind.__mro__)
        _FUNCTIONS[kind] = sys.modules["casadi"] if of_casadi else getattr(kind, "functions", None)
    return _FUNCTIONS[kind]


def is_symbol(x: Scalar) -> bool:
    """Is `x` a symbol or an expression, of a trace or of CasADi? Asked without importing CasADi."""
    return _functions(x) is not None


def _unary(name: str, of_float: Callable[[float], float]) -> Callable[[Scalar], Scalar]:
    of_array = getattr(np, {"atan": "arctan", "asin": "arcsin"}.get(name, name))

    def function(x: Scalar) -> Scalar:
        if x.__class__ is float:
            return of_float(x)
        if (functions := _functions(x)) is not None:
            return getattr(functions, name)(x)
        return of_array(x)

    function.__name__ = function.__qualname__ = name
    function.__doc__ = f"{name}(x), elementwise."
    return function


sin = _unary("sin", math.sin)
cos = _unary("cos", math.cos)
tan = _unary("tan", math.tan)
atan = _unary("atan", math.atan)
tanh = _unary("tanh", math.tanh)
exp = _unary("exp", math.exp)
log = _unary("log", math.log)
sqrt = _unary("sqrt", math.sqrt)
floor = _unary("floor", lambda x: x // 1.0)


def atan2(y: Scalar, x: Scalar) -> Scalar:
    """Angle of the vector (x, y) [rad], in [-pi, pi]."""
    if x.__class__ is float and y.__class__ is float:
        return math.atan2(y, x)
    if (functions := _functions(x) or _functions(y)) is not None:
        return functions.atan2(y, x)
    return np.arctan2(y, x)


def absolute(x: Scalar) -> Scalar:
    """|x|."""
    if x.__class__ is float:
        return abs(x)
    if (functions := _functions(x)) is not None:
        return functions.fabs(x)
    return abs(x)


def where(condition: Scalar, yes: Scalar, no: Scalar) -> Scalar:
    """`yes` where `condition` holds, else `no`; both are computed."""
    if condition is True or condition is False:
        return yes if condition else no
    if condition.__class__ is np.ndarray and yes.__class__ in _NUMBERS and no.__class__ in _NUMBERS and condition.ndim:
        return np.where(condition, yes, no)
    if (functions := _functions(condition) or _functions(yes) or _functions(no)) is not None:
        return functions.if_else(condition, yes, no)
    if np.ndim(condition) == 0 and np.ndim(yes) == 0 and np.ndim(no) == 0:
        return yes if condition else no
    return np.where(condition, yes, no)


def minimum(a: Scalar, b: Scalar) -> Scalar:
    """The smaller of `a` and `b`; a NaN in `a` stays NaN."""
    if a.__class__ is float and b.__class__ is float:
        return b if b < a else a
    return where(b < a, b, a)


def maximum(a: Scalar, b: Scalar) -> Scalar:
    """The larger of `a` and `b`; a NaN in `a` stays NaN."""
    if a.__class__ is float and b.__class__ is float:
        return b if b > a else a
    return where(b > a, b, a)


def clip(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """`x` limited to [low, high]; NaN stays NaN, so that a limiter never hides a broken signal."""
    if x.__class__ is float and low.__class__ is float and high.__class__ is float:
        x = low if low > x else x
        return high if high < x else x
    return minimum(maximum(x, low), high)


def filled(value: Scalar, batch: tuple[int, ...] = ()) -> Scalar:
    """`value` as a start state: a float, or an `(N,)` array for `batch=(N,)` (a scalar is repeated)."""
    if batch:
        return np.array(np.broadcast_to(np.asarray(value, dtype=float), batch))
    if np.ndim(value) != 0:
        raise ValueError(f"one car needs one number, got an array of shape {np.shape(value)}; use batch=N for N cars")
    return float(value)


def sign(x: Scalar) -> Scalar:
    """-1, 0 or 1."""
    return where(x > 0.0, 1.0, where(x < 0.0, -1.0, 0.0))


def both(a: Scalar, b: Scalar) -> Scalar:
    """Logical and."""
    if a.__class__ is bool and b.__class__ is bool:
        return a and b
    if (functions := _functions(a) or _functions(b)) is not None:
        return functions.logic_and(a, b)
    return a & b


def every(*conditions: Scalar) -> Scalar:
    """Logical and of two or more."""
    return functools.reduce(both, conditions)


def either(a: Scalar, b: Scalar) -> Scalar:
    """Logical or."""
    if a.__class__ is bool and b.__class__ is bool:
        return a or b
    if (functions := _functions(a) or _functions(b)) is not None:
        return functions.logic_or(a, b)
    return a | b


def is_finite(x: Scalar) -> Scalar:
    """True where `x` is neither NaN nor infinite (nor beyond 1e300), in every backend."""
    if x.__class__ is float:
        return -1e300 <= x <= 1e300
    return absolute(x) <= 1e300


def all_finite(values: Sequence[Scalar]) -> Scalar:
    """True where all of two or more values are finite, as `is_finite` says."""
    if {*map(type, values)} == {float}:
        total = sum(values)  # a largest and a smallest may pass over a NaN, a sum does not
        return total == total and min(values) >= -1e300 and max(values) <= 1e300
    return every(*[is_finite(value) for value in values])


def chosen(condition: Scalar, yes: Sequence[Scalar], no: Sequence[Scalar]) -> tuple[Scalar, ...]:
    """All of `yes` where `condition` holds, else all of `no`."""
    if condition is True or condition is False:
        return tuple(yes) if condition else tuple(no)
    return tuple([where(condition, a, b) for a, b in zip(yes, no, strict=True)])


def wrap(angle: Scalar) -> Scalar:
    """`angle` [rad] brought to [-pi, pi)."""
    return angle - 2.0 * pi * floor((angle + pi) / (2.0 * pi))


class Table:
    """Rows of numbers looked up by a whole-number index: the one operation that needs more than arithmetic.

    `table(i)` gives the row `i` (i is a float holding a whole number, an array of them, a symbol of a trace or a CasADi
    MX) as scalars. A path's spline coefficients and a recorded speed profile are tables.

    rows: (n, m) array. Raises ValueError when it is not two-dimensional or holds a non-finite number.
    """

    def __init__(self, rows: Any):
        array = np.array(rows, dtype=float)
        if array.ndim != 2 or 0 in array.shape:
            raise ValueError(f"Table: rows of shape {array.shape}, expected (n, m) with n, m >= 1")
        if not np.isfinite(array).all():
            raise ValueError("Table: rows hold a NaN or an infinity; every entry must be finite")
        array.flags.writeable = False
        self.rows = array
        self._columns = np.ascontiguousarray(array.T)
        self._tuples = list(zip(*self._columns.tolist()))

    def __len__(self) -> int:
        return len(self._tuples)

    def __repr__(self) -> str:
        return f"<Table {self.rows.shape}>"

    def __call__(self, index: Scalar) -> Sequence[Scalar]:
        if index.__class__ is float:
            return self._tuples[int(index)]
        if (functions := _functions(index)) is None:
            return tuple(self._columns[:, np.asarray(index, dtype=np.intp)])
        if hasattr(functions, "row"):
            return functions.row(self, index)
        return functions.vertsplit(self._interpolant(index))

    @functools.cached_property
    def _interpolant(self) -> Any:
        """CasADi's function of the index; linear interpolation at a whole number is the row itself."""
        rows = self.rows if len(self) > 1 else np.repeat(self.rows, 2, axis=0)
        grid, exact = np.arange(len(rows), dtype=float), {"lookup_mode": ["exact"]}
        return sys.modules["casadi"].interpolant("table", "linear", [grid], rows.ravel(), exact)


def rising(*columns: Any) -> Table:
    """A row from each sample to the next, of evenly sampled columns (n,): each one's value and its rise; `between`."""
    samples = [np.asarray(column, dtype=float) for column in columns]
    return Table(np.column_stack([part for column in samples for part in (column[:-1], np.diff(column))]))


def between(table: Table, z: Scalar, column: int = 0) -> Scalar:
    """A column of what `rising` tabled, linear between samples, at the place z >= 0; a NaN z gives NaN."""
    i = clip(where(is_finite(z), floor(z), 0.0), 0.0, float(len(table)) - 1.0)
    row = table(i)
    return row[2 * column] + (z - i) * row[2 * column + 1]


class Routine:
    """Numbers to numbers by code of its own: a solver, say, which is neither arithmetic nor a table.

    `routine(*values)` gives `size` numbers. call: on floats; compiled loops call it too, those in C as well.
    One call at a time: what computes a routine may keep its workspace.
    """

    def __init__(self, *, name: str, size: int, call: Callable[..., Sequence[float]]):
        self.name, self.size, self.call = name, size, call
        self.lock = threading.Lock()

    def __call__(self, *values: Scalar) -> Sequence[Scalar]:
        if {*map(type, values)} != {float}:
            for functions in filter(None, map(_functions, values)):
                if not hasattr(functions, "call"):
                    raise self.refusal()
                return functions.call(self, values)
        with self.lock:
            return self.call(*values)

    def refusal(self) -> TypeError:
        """The error where nothing but equations can be run."""
        return TypeError(f"{self.name} runs code of its own, which has no symbolic form: only compiled loops call it")


def rk4(rhs: Callable[[Sequence[Scalar]], Sequence[Scalar]], x: Sequence[Scalar], h: float) -> tuple[Scalar, ...]:
    """One step of the classical fourth-order Runge-Kutta method for x' = rhs(x) (Kutta 1901).

    x: n scalars; h: step [s]. Returns n scalars. The local error is of order h^5.
    """
    half = 0.5 * h
    k1 = rhs(x)
    k2 = rhs([a + half * b for a, b in zip(x, k1, strict=True)])
    k3 = rhs([a + half * b for a, b in zip(x, k2, strict=True)])
    k4 = rhs([a + h * b for a, b in zip(x, k3, strict=True)])
    sixth = h / 6.0
    return tuple(a + sixth * (b + 2.0 * (c + d) + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True))
