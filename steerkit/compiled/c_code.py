"""The traced loop as C: for one car in doubles, or for several cars at once in SIMD vectors of doubles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from steerkit.compiled.graph import BOOLEAN, FUNCTIONS, Graph
from steerkit.compiled.trace import Tick, Trace
from steerkit.maths import Table

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

_ONE = SCALAR_TYPES + "#define LANES 1\n"

_MANY = """\
#include <string.h>
#define INLINE static inline __attribute__((always_inline))
#if defined(__AVX512F__)
#define LANES 8
#define VECTOR(f, args) _ZGVeN8##args##_##f
#elif defined(__AVX2__)
#define LANES 4
#define VECTOR(f, args) _ZGVdN4##args##_##f
#else
#define LANES 2
#define VECTOR(f, args) _ZGVbN2##args##_##f
#endif
typedef double real __attribute__((vector_size(8 * LANES)));
typedef long long mask __attribute__((vector_size(8 * LANES)));
INLINE real number(double x) { real r; for (int i = 0; i < LANES; i++) r[i] = x; return r; }
INLINE real select(mask c, real a, real b) { return (real)((c & (mask)a) | (~c & (mask)b)); }
#define NUMBER(x) number(x)
#define NOT(a) (~(a))
#define SELECT(c, a, b) select(c, a, b)
#define CALL1(f, a) lanes_##f(a)
#define CALL2(f, a, b) lanes_##f(a, b)
#define ABS(a) ((real)((mask)(a) & 0x7fffffffffffffffLL))
#define ROW(name, table, i) const double *name[LANES]; for (int l = 0; l < LANES; l++) name[l] = row##table((i)[l])
#define AT(name, column) gathered(name, column)
INLINE real gathered(const double *const *row, int column)
{ real r; for (int l = 0; l < LANES; l++) r[l] = row[l][column]; return r; }
#define BY_LANE(f) INLINE real lanes_##f(real a) \\
  { real r; for (int i = 0; i < LANES; i++) r[i] = f(a[i]); return r; }
BY_LANE(floor)
BY_LANE(sqrt)
/* sin and cos inline, so that the pair shares its work and no call empties the registers: a = k pi/2 + r by Cody and
   Waite's method, exact for |a| < 1e6 and within the rounding of a itself beyond; then fdlibm's polynomials in r */
INLINE real reduced(real a, mask *quarter)
{
  const real t = a * 0.63661977236758134308 + 6755399441055744.0, k = t - 6755399441055744.0;
  *quarter = (mask)t;
  return ((a - k * 1.57079632673412561417e+00) - k * 6.07710050630396597660e-11) - k * 2.02226624879595063154e-21;
}
INLINE real sine(real r)
{
  const real z = r * r;
  return r + z * r * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
    + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
}
INLINE real cosine(real r)
{
  const real z = r * r, h = 0.5 * z, w = 1.0 - h;
  return w + (((1.0 - w) - h) + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
    + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09
    + z * -1.13596475577881948265e-11))))));
}
INLINE real signed_by(real a, mask sign) { return (real)((mask)a ^ ((sign & 2) << 62)); }
INLINE real lanes_sin(real a)
{
  mask q;
  const real r = reduced(a, &q), s = sine(r), c = cosine(r);
  return signed_by(select((q & 1) != 0, c, s), q);
}
INLINE real lanes_cos(real a)
{
  mask q;
  const real r = reduced(a, &q), s = sine(r), c = cosine(r);
  return signed_by(select((q & 1) != 0, s, c), q + 1);
}
#ifdef VECTOR_MATHS /* glibc's libmvec: within 4 units in the last place */
#define BY_VECTOR(f) extern real VECTOR(f, v)(real); INLINE real lanes_##f(real a) { return VECTOR(f, v)(a); }
BY_VECTOR(tan) BY_VECTOR(asin) BY_VECTOR(acos) BY_VECTOR(atan)
BY_VECTOR(tanh) BY_VECTOR(exp) BY_VECTOR(log)
extern real VECTOR(atan2, vv)(real, real);
INLINE real lanes_atan2(real a, real b) { return VECTOR(atan2, vv)(a, b); }
#else
BY_LANE(tan) BY_LANE(asin) BY_LANE(acos) BY_LANE(atan)
BY_LANE(tanh) BY_LANE(exp) BY_LANE(log)
INLINE real lanes_atan2(real a, real b)
{ real r; for (int i = 0; i < LANES; i++) r[i] = atan2(a[i], b[i]); return r; }
#endif
"""

_RUN_ONE = """\
void run(long long k, long long stop, long long every, double *slots, const double *p, double *out)
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
void finish(long long k, const double *slots, const double *p, double *out)
{{
  switch (k % {period}) {{ {finals} }}
}}
"""

_RUN_MANY = """\
int lanes(void) {{ return LANES; }}
static real load(const double *a) {{ real r; memcpy(&r, a, sizeof r); return r; }}
static void store(double *a, real r) {{ memcpy(a, &r, sizeof r); }}
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
void finish(long long k, long long first, long long last, const double *slots, const double *parameters, double *all)
{{
  for (long long group = first; group < last; group++) {{
    real s[{carried}], p[{parameters}], out[{slots}];
    for (int i = 0; i < {n}; i++) s[i] = load(slots + (group * {n} + i) * LANES);
    for (int i = 0; i < {np}; i++) p[i] = load(parameters + (group * {np} + i) * LANES);
    switch (k % {period}) {{ {finals} }}
    for (int i = 0; i < {slots}; i++) store(all + (group * {slots} + i) * LANES, out[i]);
  }}
}}
"""


def run_source(trace: Trace, recorded: Sequence[int], *, many: bool) -> str:
    """A C file with `run` (ticks k to stop, every so many recorded) and `finish` (one tick, all slots)."""
    carried, period = trace.carried, len(trace.ticks)
    ticks, cases, finals = [], [], []
    for phase, tick in enumerate(trace.ticks):
        lean = [tick.roots[slot] for slot in (*carried, *recorded)]
        names = [f"s[{i}]" for i in range(len(carried))] + [f"y[{i}]" for i in range(len(recorded))]
        body = _body(trace, tick.graph, lean, names)
        ticks.append(f"static inline void tick{phase}(double k, real *s, const real *p, real *y)\n{{\n{body}}}\n")
        body = _body(trace, tick.graph, tick.roots, [f"out[{i}]" for i in range(len(tick.roots))])
        ticks.append(f"static void last{phase}(double k, const real *s, const real *p, real *out)\n{{\n{body}}}\n")
        label = "default" if phase == period - 1 else f"case {phase}"
        cases.append(f"{label}: tick{phase}((double)k, s, p, y); break;")
        finals.append(
            f"{label}: last{phase}((double)k, s, p, out); break;"
            if many
            else f"{label}: last{phase}((double)k, slots, p, out); break;"
        )
    n, m, size = len(carried), len(recorded), len(trace.parameters)
    run = (_RUN_MANY if many else _RUN_ONE).format(
        carried=max(1, n),
        recorded=max(1, m),
        parameters=max(1, size),
        n=n,
        m=m,
        np=size,
        period=period,
        slots=len(trace.layout),
        cases=" ".join(cases),
        finals=" ".join(finals),
    )
    parts = ["#include <math.h>\n", _MANY if many else _ONE, table_source(trace.tables), *ticks, run]
    return "\n".join(parts)


def lanes_source(tables: Sequence[Table]) -> str:
    """The head of a C file whose `real` is a vector of LANES cars' numbers: types, functions and these tables."""
    return "\n".join(["#include <math.h>\n", _MANY, table_source(tables)])


def function_source(
    head: str, tick: Tick, names: Sequence[str], source: Callable[[int], str], tables: Sequence[Table]
) -> str:
    """A C function that writes the roots of a graph to `names`. source: the C text of an input."""
    lines = statements(tick.graph, tick.roots, source, tables)
    values = [f"  const real w{n} = v{i};" for n, i in enumerate(tick.roots)]  # all read before any is written
    stores = [f"  {name} = w{n};" for n, name in enumerate(names)]
    return "\n".join([f"static inline void {head}\n{{", *lines, *values, *stores, "}\n"])


def table_source(tables: Sequence[Table]) -> str:
    """Tables as static arrays, with one more row of NaN for an index that is in none of them."""
    text = []
    for number, table in enumerate(tables):
        rows = np.vstack((table.rows, np.full(table.rows.shape[1], math.nan)))
        numbers = ",\n  ".join(", ".join(c_number(v) for v in row) for row in rows.tolist())
        text.append(f"static const double table{number}[{rows.size}] = {{\n  {numbers}\n}};\n")
        text.append(
            f"static inline const double *row{number}(double i)\n"
            f"{{\n  return table{number} + (i >= 0.0 && i < {len(table)}.0 ? (int)i : {len(table)})"
            f" * {rows.shape[1]};\n}}\n"
        )
    return "".join(text)


def _body(trace: Trace, graph: Graph, roots: Sequence[int], names: Sequence[str]) -> str:
    carried = {slot: i for i, slot in enumerate(trace.carried)}
    slots = len(trace.layout)

    def source(slot: int) -> str:
        if slot == 0:
            return "NUMBER(k)"
        return f"s[{carried[slot - 1]}]" if slot <= slots else f"p[{slot - slots - 1}]"

    unused = "  (void)k; (void)s; (void)p;" + (" (void)y;\n" if "y[" in "".join(names[-1:]) or not names else "\n")
    lines = statements(graph, roots, source, trace.tables)
    values = [f"  const real w{n} = v{i};" for n, i in enumerate(roots)]
    return "\n".join([unused, *lines, *values, *[f"  {name} = w{n};" for n, name in enumerate(names)], ""])


def statements(graph: Graph, roots: Sequence[int], source: object, tables: Sequence[Table]) -> list[str]:
    """One `const real v<node> = ...;` a node. source: the C text of an input slot."""
    lines: list[str] = []
    rows: set[tuple[int, int]] = set()
    assert callable(source)
    for i in graph.order(roots):
        op, *operands = graph.nodes[i]
        kind = "mask" if op in BOOLEAN else "real"
        if op == "row":
            table, index, column = operands
            name = f"r{table}_{index}"
            if (table, index) not in rows:
                rows.add((table, index))
                lines.append(f"  ROW({name}, {table}, v{index});")
            text = f"AT({name}, {column})"
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
