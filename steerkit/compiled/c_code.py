"""The traced loop as C: for one car in doubles, or for several cars at once in SIMD vectors of doubles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from steerkit.compiled.c_maths import MANY, ONE
from steerkit.compiled.graph import BOOLEAN, FUNCTIONS, Graph
from steerkit.compiled.schedule import scheduled
from steerkit.compiled.trace import Tick, Trace
from steerkit.diagram.maths import Table

_INFIX = {
    "add": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "lt": "<",
    "le": "<=",
    "eq": "==",
    "ne": "!=",
    "and": "&",
    "or": "|",
}

SCALAR_TYPES = """\
typedef double real;
typedef int mask;
#define NUMBER(x) (x)
#define NOT(a) (!(a))
#define SELECT(c, a, b) ((c) ? (a) : (b))
#define CALL1(f, a) f(a)
#define CALL2(f, a, b) f(a, b)
#define ABS(a) fabs(a)
#define ROW(name, table, i) const double *const name = row##table(i)
#define AT(name, column) name[column]
"""

_ROUTINE = "typedef void (*routine)(void *, const double *, double *);"

_RUN_ONE = """\
void run(long long k, long long stop, long long every, double *slots, const double *p, double *out, void **routines)
{{
  real s[{carried}];
  long long wait = (every - k % every) % every;
  for (int i = 0; i < {n}; i++) s[i] = slots[i];
  for (; k < stop; k++) {{
    real y[{recorded}];
    switch (k % {period}) {{ {cases} }}
    if (wait == 0) {{ for (int i = 0; i < {m}; i++) *out++ = y[i]; wait = every; }}
    wait--;
  }}
  for (int i = 0; i < {n}; i++) slots[i] = s[i];
}}
"""

_FINISH_ONE = """\
void finish(long long k, const double *slots, const double *p, double *out, void **routines)
{{
  last((double)k, slots, p, out, routines);
}}
"""

_LOAD_AND_STORE = """\
static real load(const double *a) { real r; memcpy(&r, a, sizeof r); return r; }
static void store(double *a, real r) { memcpy(a, &r, sizeof r); }
"""

_RUN_MANY = """\
int lanes(void) {{ return LANES; }}
/* slots, parameters, all: one block of [count][LANES] a group; out: [rows][recorded][cars] */
void run(long long k0, long long stop, long long every, long long first, long long last, long long cars,
         double *slots, const double *parameters, double *out)
{{
  for (long long group = first; group < last; group++) {{
    real s[{carried}], p[{parameters}];
    long long wait = (every - k0 % every) % every;
    double *to = out + group * LANES;
    for (int i = 0; i < {n}; i++) s[i] = load(slots + (group * {n} + i) * LANES);
    for (int i = 0; i < {np}; i++) p[i] = load(parameters + (group * {np} + i) * LANES);
    for (long long k = k0; k < stop; k++) {{
      real y[{recorded}];
      switch (k % {period}) {{ {cases} }}
      if (wait == 0) {{ for (int i = 0; i < {m}; i++, to += cars) store(to, y[i]); wait = every; }}
      wait--;
    }}
    for (int i = 0; i < {n}; i++) store(slots + (group * {n} + i) * LANES, s[i]);
  }}
}}
"""

_FINISH_MANY = """\
void finish(long long k, long long first, long long end, const double *slots, const double *parameters, double *all)
{{
  for (long long group = first; group < end; group++) {{
    real s[{carried}], p[{parameters}], out[{slots}];
    for (int i = 0; i < {n}; i++) s[i] = load(slots + (group * {n} + i) * LANES);
    for (int i = 0; i < {np}; i++) p[i] = load(parameters + (group * {np} + i) * LANES);
    last((double)k, s, p, out);
    for (int i = 0; i < {slots}; i++) store(all + (group * {slots} + i) * LANES, out[i]);
  }}
}}
"""


def run_source(trace: Trace, recorded: Sequence[int], *, many: bool) -> str:
    """A C file with `run`: ticks k to stop, every so many recorded.

    That of one car is handed its `routines`: of each the addresses of a function and of its first argument.
    """
    carried = trace.carried
    last, handed = ("", "") if many else (", void **routines", ", routines")
    names = [f"s[{i}]" for i in range(len(carried))] + [f"y[{i}]" for i in range(len(recorded))]
    ticks = []
    for number, (tick, _) in enumerate(trace.kinds):
        body = _body(trace, tick.graph, [tick.roots[slot] for slot in (*carried, *recorded)], names)
        ticks.append(
            f"static inline void tick{number}(double k, real *s, const real *p, real *y{last})\n{{\n{body}}}\n"
        )
    cases = [f"{label} tick{i}((double)k, s, p, y{handed}); break;" for i, label in enumerate(phase_labels(trace))]
    sizes = _sizes(trace) | {"recorded": max(1, len(recorded)), "m": len(recorded)}
    run = (_RUN_MANY if many else _RUN_ONE).format(**sizes, period=len(trace.ticks), cases=" ".join(cases))
    return "\n".join([_head(trace.tables, many=many), _LOAD_AND_STORE if many else _ROUTINE, *ticks, run])


def finish_source(trace: Trace, number: int, *, many: bool) -> str:
    """A C file with `finish`: a tick of that of `trace.kinds`, which gives all slots.

    A run ends with one. It stands alone as a tick that computes everything takes as long to compile as one that runs.
    """
    tick, _ = trace.kinds[number]
    body = _body(trace, tick.graph, tick.roots, [f"out[{i}]" for i in range(len(tick.roots))])
    given = "double k, const real *s, const real *p, real *out" + ("" if many else ", void **routines")
    last = f"static inline void last({given})\n{{\n{body}}}\n"
    finish = (_FINISH_MANY if many else _FINISH_ONE).format(**_sizes(trace))
    return "\n".join([_head(trace.tables, many=many), _LOAD_AND_STORE if many else _ROUTINE, last, finish])


def phase_labels(trace: Trace, suffix: str = "") -> list[str]:
    """Of each of `trace.kinds` its labels in a `switch` over the phase. suffix: of the numbers."""
    own = [" ".join([f"case {phase}{suffix}:" for phase in phases]) for _, phases in trace.kinds[:-1]]
    return [*own, "default:"]


def _sizes(trace: Trace) -> dict[str, int]:
    n, size = len(trace.carried), len(trace.parameters)
    return dict(carried=max(1, n), parameters=max(1, size), n=n, np=size, slots=len(trace.layout))


def lanes_source(tables: Sequence[Table]) -> str:
    """The head of a C file whose `real` is a vector of LANES cars' numbers: types, functions and these tables."""
    return _head(tables, many=True)


def _head(tables: Sequence[Table], *, many: bool) -> str:
    return "\n".join(["#include <math.h>\n", MANY if many else ONE, table_source(tables, lanes=many)])


def function_source(
    head: str, tick: Tick, names: Sequence[str], source: Callable[[int], str], tables: Sequence[Table]
) -> str:
    """A C function that writes the roots of a graph to `names`. source: the C text of an input."""
    return "\n".join(
        [f"static inline void {head}\n{{", *_written(tick.graph, tick.roots, names, source, tables), "}\n"]
    )


def table_source(tables: Sequence[Table], *, lanes: bool = False) -> str:
    """Tables as static arrays, with one more row of NaN for an index that is in none of them.

    lanes: rows are filled up to whole vectors, for cars side by side.
    """
    text = []
    for number, table in enumerate(tables):
        rows = np.vstack((table.rows, np.full(table.rows.shape[1], math.nan)))
        if lanes:
            rows = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 8)))
        text.append(f"static const double table{number}[{rows.size}] = {{\n  {_numbers(rows)}\n}};\n")
        text.append(
            f"enum {{ count{number} = {len(table)}, width{number} = {rows.shape[1]} }};\n"
            if lanes
            else f"static inline const double *row{number}(double i)\n"
            f"{{\n  return table{number} + (i >= 0.0 && i < {len(table)}.0 ? (int)i : {len(table)})"
            f" * {rows.shape[1]};\n}}\n"
        )
    return "".join(text)


def _numbers(rows: NDArray[np.float64]) -> str:
    """All the digits, a line a row; Python writes them as C reads them, but for two names."""
    text = ",\n  ".join([repr(row)[1:-1] for row in rows.tolist()])
    return text.replace("nan", "NAN").replace("inf", "INFINITY")


def _body(trace: Trace, graph: Graph, roots: Sequence[int], names: Sequence[str]) -> str:
    carried = {slot: i for i, slot in enumerate(trace.carried)}
    slots = len(trace.layout)

    def source(slot: int) -> str:
        if slot == 0:
            return "NUMBER(k)"
        return f"s[{carried[slot - 1]}]" if slot <= slots else f"p[{slot - slots - 1}]"

    unused = "  (void)k; (void)s; (void)p;" + (" (void)y;\n" if "y[" in "".join(names[-1:]) or not names else "\n")
    return "\n".join([unused, *_written(graph, roots, names, source, trace.tables), ""])


def _written(
    graph: Graph, roots: Sequence[int], names: Sequence[str], source: Callable[[int], str], tables: Sequence[Table]
) -> list[str]:
    """The statements, and those that write the roots to `names`: all are read before any is written."""
    values = [f"  const real w{n} = v{i};" for n, i in enumerate(roots)]
    stores = [f"  {name} = w{n};" for n, name in enumerate(names)]
    return [*statements(graph, roots, source, tables), *values, *stores]


def statements(
    graph: Graph,
    roots: Sequence[int],
    source: Callable[[int], str],
    tables: Sequence[Table],
    order: Callable[[Graph, Sequence[int]], Sequence[int]] = scheduled,
) -> list[str]:
    """One `const real v<node> = ...;` a node, in that order. source: the C text of an input slot."""
    lines: list[str] = []
    rows: set[tuple[int, int]] = set()
    for i in order(graph, roots):
        op, *operands = graph.nodes[i]
        if op == "call":
            number, size, *arguments = operands
            lines.append(f"  const double given{i}[] = {{{', '.join(f'v{j}' for j in arguments)}}};")
            lines.append(f"  double told{i}[{size}];")
            lines.append(f"  ((routine)routines[{2 * number}])(routines[{2 * number + 1}], given{i}, told{i});")
            continue
        kind = "mask" if op in BOOLEAN else "real"
        if op == "row":
            table, index, column = operands
            name = f"r{table}_{index}"
            if (table, index) not in rows:
                rows.add((table, index))
                lines.append(f"  ROW({name}, {table}, v{index});")
            text = f"AT({name}, {column})"
        elif op == "result":
            text = f"told{operands[0]}[{operands[1]}]"
        elif op == "const":
            text = f"NUMBER({c_number(float.fromhex(operands[0]))})"
        elif op == "in":
            text = source(operands[0])
        else:
            text = _expression(op, [f"v{j}" for j in operands])
        lines.append(f"  const {kind} v{i} = {text};")
    return lines


def _expression(op: str, parts: Sequence[str]) -> str:
    if op in _INFIX:
        return f"{parts[0]} {_INFIX[op]} {parts[1]}"
    if op in FUNCTIONS:
        return f"CALL{len(parts)}({op}, {', '.join(parts)})"
    name = {"select": "SELECT", "abs": "ABS", "not": "NOT"}.get(op)
    return f"{name}({', '.join(parts)})" if name else f"-{parts[0]}"


def c_number(value: float) -> str:
    """A C99 constant expression with all the digits."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    text = repr(value)
    text = text if any(mark in text for mark in ".en") else f"{text}.0"
    return f"({text})" if value < 0.0 else text
