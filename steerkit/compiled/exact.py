"""A loop in C that gives the numbers of the interpreted loop to the last bit, with all of its state in every sample."""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from steerkit._support import native
from steerkit.compiled.c_code import SCALAR_TYPES, phase_labels, statements
from steerkit.compiled.graph import Graph
from steerkit.compiled.trace import Tick, Trace, trace
from steerkit.diagram.loop import Loop

Array = NDArray[np.float64]
_LL = ctypes.c_longlong

_HEAD = """\
#include <fenv.h>
#include <math.h>
#include <string.h>
typedef void (*routine)(void *, const double *, double *);
typedef struct { const double *rows; double count; long long width; } table; /* and one more row, of NaN */
static const double *row_of(const table *t, double i)
{
  if (i >= 0.0 && i < t->count) return t->rows + (long long)i * t->width;
  feraiseexcept(FE_INVALID);
  return t->rows + (long long)t->count * t->width;
}
"""
_OWN = """\
#undef ROW
#define ROW(name, n, i) const double *const name = row_of(tables + n, i)
#define floor(a) (fabs(a) <= 1.7976931348623157e308 ? floor(a) : NAN)  /* a // 1.0 of Python */
"""

_SAMPLES = """\
/* n samples of {ticks} ticks from tick k and the slots s on; all slots after each one's first tick and after its last;
   how many of them raised nothing at which Python might have raised an exception */
long long samples(long long k, long long n, double *s, const double *p, double *first, double *last,
                  const table *tables, void **routines)
{{
  for (long long i = 0; i < n; i++) {{
    feclearexcept(FE_ALL_EXCEPT);
    for (int j = 0; j < {ticks}; j++, k++) {{
      switch (k % {period}) {{ {cases} }}
      if (j == 0) memcpy(first + i * {slots}, s, {slots} * sizeof *s);
    }}
    memcpy(last + i * {slots}, s, {slots} * sizeof *s);
    if (fetestexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW)) return i;
  }}
  return n;
}}
"""


class _Table(ctypes.Structure):
    """The struct `table` of the C above."""

    _fields_ = [("rows", ctypes.c_void_p), ("count", ctypes.c_double), ("width", _LL)]


class ExactProgram:
    """C of a loop for who decides between any two of its samples, and may not get other numbers for its being fast.

    Every operation is one of Python's: no fused ones, sines and the like from the same library. Where one of them
    divides by zero, overflows or meets a NaN, for which Python may have an exception, the run stops before that
    sample, which is to be interpreted.

    ticks: base steps that make a sample. parameters: block fields left open, as for `compile`. Routines are not in the
    program: `run` is handed their addresses, in the order of `trace.routines`. Nor are the tables, so that loops that
    differ only in their course are the same C. Raises TraceError as `compile` does.
    """

    def __init__(self, loop: Loop, *, ticks: int, parameters: Sequence[str] = ()):
        self.trace: Trace = trace(loop, parameters=parameters, routines=True)
        self.ticks = ticks
        self.source = _source(self.trace, ticks)
        self._rows = [np.vstack((t.rows, np.full(t.rows.shape[1], math.nan))) for t in self.trace.tables]
        shapes = [_Table(rows.ctypes.data, len(rows) - 1, rows.shape[1]) for rows in self._rows]
        self._tables = (_Table * max(1, len(shapes)))(*shapes)

    @functools.cached_property
    def library(self) -> ctypes.CDLL:
        """The compiled library, made at its first use; raises NoCompilerError without a C compiler."""
        library = native.load(self.source, as_python=True)
        library.samples.restype = _LL
        return library

    def run(
        self, k: int, samples: int, slots: Array, parameters: Array, routines: Sequence[tuple[int, int]] = ()
    ) -> tuple[Array, Array]:
        """All slots (n, S) after the first tick of each sample and after its last; from tick k and `slots` (S,) on.

        n is `samples`, or less where one of them has to be interpreted.
        """
        now = np.array(slots)
        first, last = np.empty((2, samples, len(now)))
        addresses = (ctypes.c_void_p * max(1, 2 * len(routines)))(*[a for routine in routines for a in routine])
        arrays = map(_at, (now, parameters, first, last))
        done = self.library.samples(_LL(k), _LL(samples), *arrays, self._tables, addresses)
        return first[:done], last[:done]


def _source(trace: Trace, ticks: int) -> str:
    told = "const double *p, const table *tables, void **routines"
    functions = [
        f"static void tick{number}(double k, double *s, {told})\n{{\n{_body(trace, tick)}\n}}\n"
        for number, (tick, _) in enumerate(trace.kinds)
    ]
    cases = [
        f"{label} tick{number}((double)k, s, p, tables, routines); break;"
        for number, label in enumerate(phase_labels(trace))
    ]
    run = _SAMPLES.format(ticks=ticks, period=len(trace.ticks), slots=len(trace.layout), cases=" ".join(cases))
    return "\n".join([_HEAD, SCALAR_TYPES, _OWN, *functions, run])


def _body(trace: Trace, tick: Tick) -> str:
    """One tick in place: what changes is written after all has been read."""
    slots = len(trace.layout)

    def source(slot: int) -> str:
        return "k" if slot == 0 else f"s[{slot - 1}]" if slot <= slots else f"p[{slot - slots - 1}]"

    changed = [i for i, root in enumerate(tick.roots) if tick.graph.nodes[root] != ("in", i + 1)]
    lines = statements(tick.graph, [tick.roots[i] for i in changed], source, trace.tables, Graph.order)
    return "\n".join([*lines, *(f"  s[{i}] = v{tick.roots[i]};" for i in changed)])


def _at(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
