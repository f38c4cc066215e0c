"""The traced loop as C: for one car in doubles, or for several cars at once in SIMD vectors of doubles."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from steerkit.compiled.graph import BOOLEAN, FUNCTIONS, INFIX, Graph
from steerkit.compiled.trace import Tick, Trace
from steerkit.diagram.maths import Table

_SCALAR = """\
typedef double real;
typedef int mask;
#define NUMBER(x) (x)
#define NOT(a) (!(a))
#define SELECT(c, a, b) ((c) ? (a) : (b))
#define ABS(a) fabs(a)
#define ROW(name, table, i) const double *const name = row##table(i)
#define AT(name, column) name[column]
"""
SCALAR_TYPES = f"{_SCALAR}#define CALL1(f, a) f(a)\n#define CALL2(f, a, b) f(a, b)\n"

_LOAD_AND_STORE = """\
typedef void (*routine)(void *, const double *, double *);
static real load(const double *a) { real r; memcpy(&r, a, sizeof r); return r; }
static void store(double *a, real r) { memcpy(a, &r, sizeof r); }
"""

_RUN = """\
int lanes(void) {{ return LANES; }}
/* slots, parameters, all: one block of [count][LANES] a group; out: [rows][recorded][cars] */
void run(long long k0, long long stop, long long every, long long first, long long last, long long cars,
         double *slots, const double *parameters, double *out, void **routines)
{{
  for (long long group = first; group < last; group++) {{
    real s[{persistent}], p[{parameters}];
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

_FINISH = """\
void finish(long long k, long long first, long long end, const double *slots, const double *parameters, double *all,
            void **routines)
{{
  for (long long group = first; group < end; group++) {{
    real s[{persistent}], p[{parameters}], out[{slots}];
    for (int i = 0; i < {n}; i++) s[i] = load(slots + (group * {n} + i) * LANES);
    for (int i = 0; i < {np}; i++) p[i] = load(parameters + (group * {np} + i) * LANES);
    last((double)k, s, p, out, routines);
    for (int i = 0; i < {slots}; i++) store(all + (group * {slots} + i) * LANES, out[i]);
  }}
}}
"""

_CYCLES = {
    "const": (0, 0.0),
    "in": (0, 0.0),
    "row": (6, 0.3),
    "div": (13, 1.0),
    "sqrt": (20, 1.0),
    "floor": (8, 0.5),
    "sin": (45, 4.0),
    "cos": (45, 4.0),
    "tan": (60, 9.0),
    "atan": (60, 8.0),
    "atan2": (60, 8.0),
    "exp": (60, 12.0),
    "log": (60, 12.0),
    "tanh": (80, 15.0),
    "asin": (80, 15.0),
    "acos": (80, 15.0),
    "call": (30000, 30000.0),
    "result": (0, 0.0),
    "select": (2, 0.3),
}
_SIMPLE = 4, 0.3
"""Cycles until the result is there, and cycles of a processor's issue; roughly those of machines of the 2020s."""


def scheduled(graph: Graph, roots: Sequence[int]) -> list[int]:
    """The nodes that `roots` need, each after its operands, as a processor that sees all of them would start them.

    A processor looks some hundred instructions ahead. A loop's blocks are chains of dependent instructions much longer
    than that, a car's substeps and the tracker's search, say; written one after the other they also run so. List
    scheduling by critical path (Graham 1969): among the instructions whose operands are there, the one with the
    longest way to the end comes next.
    """
    order = graph.order(roots)
    needs = {i: set(graph.operands(i)) for i in order}
    users: dict[int, list[int]] = {i: [] for i in order}
    for i, operands in needs.items():
        for j in operands:
            users[j].append(i)
    cost = {i: _cost(graph, i) for i in order}
    way: dict[int, float] = {}
    for i in reversed(order):
        way[i] = cost[i][0] + max([way[j] for j in users[i]], default=0.0)
    waiting = {i: len(operands) for i, operands in needs.items()}
    there = dict.fromkeys(order, 0.0)
    ready = [(-way[i], i) for i in order if not waiting[i]]  # operands are there by now: by the way that is left
    heapq.heapify(ready)
    later: list[tuple[float, int]] = []  # by the moment at which the operands are there
    done: list[int] = []
    now = 0.0
    while ready or later:
        if not ready:
            now = max(now, later[0][0])
        while later and later[0][0] <= now:
            _, i = heapq.heappop(later)
            heapq.heappush(ready, (-way[i], i))
        _, i = heapq.heappop(ready)
        done.append(i)
        latency, issue = cost[i]
        for j in users[i]:
            there[j] = max(there[j], now + latency)
            waiting[j] -= 1
            if not waiting[j]:
                heapq.heappush(later, (there[j], j))
        now += issue
    return done


def _cost(graph: Graph, i: int) -> tuple[float, float]:
    op = graph.nodes[i][0]
    return (2, 0.3) if op in BOOLEAN else _CYCLES.get(op, _SIMPLE)


def run_source(trace: Trace, recorded: Sequence[int], *, many: bool) -> str:
    """A C file with `run`: ticks k to stop, every so many recorded, of cars in groups of `lanes()`.

    many: several cars a group. `routines` has of each routine the addresses of a function and of its first argument.
    """
    persistent = trace.persistent
    names = [f"s[{i}]" for i in range(len(persistent))] + [f"y[{i}]" for i in range(len(recorded))]
    ticks = []
    for number, (tick, _) in enumerate(trace.kinds):
        body = _body(trace, tick.graph, [tick.roots[slot] for slot in (*persistent, *recorded)], names)
        head = f"static inline void tick{number}(double k, real *s, const real *p, real *y, void **routines)"
        ticks.append(f"{head}\n{{\n{body}}}\n")
    cases = [f"{label} tick{i}((double)k, s, p, y, routines); break;" for i, label in enumerate(phase_labels(trace))]
    sizes = _sizes(trace) | {"recorded": max(1, len(recorded)), "m": len(recorded)}
    run = _RUN.format(**sizes, period=len(trace.ticks), cases=" ".join(cases))
    return "\n".join([_head(trace.tables, many=many), _LOAD_AND_STORE, *ticks, run])


def finish_source(trace: Trace, number: int, *, many: bool) -> str:
    """A C file with `finish`: a tick of that of `trace.kinds`, which gives all slots.

    A run ends with one. It stands alone as a tick that computes everything takes as long to compile as one that runs.
    """
    tick, _ = trace.kinds[number]
    body = _body(trace, tick.graph, tick.roots, [f"out[{i}]" for i in range(len(tick.roots))])
    last = (
        f"static inline void last(double k, const real *s, const real *p, real *out, void **routines)\n{{\n{body}}}\n"
    )
    finish = _FINISH.format(**_sizes(trace))
    return "\n".join([_head(trace.tables, many=many), _LOAD_AND_STORE, last, finish])


def phase_labels(trace: Trace, suffix: str = "") -> list[str]:
    """Of each of `trace.kinds` its labels in a `switch` over the phase. suffix: of the numbers."""
    own = [" ".join([f"case {phase}{suffix}:" for phase in phases]) for _, phases in trace.kinds[:-1]]
    return [*own, "default:"]


def _sizes(trace: Trace) -> dict[str, int]:
    n, size = len(trace.persistent), len(trace.parameters)
    return dict(persistent=max(1, n), parameters=max(1, size), n=n, np=size, slots=len(trace.layout))


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
    persistent = {slot: i for i, slot in enumerate(trace.persistent)}
    slots = len(trace.layout)

    def source(slot: int) -> str:
        if slot == 0:
            return "NUMBER(k)"
        return f"s[{persistent[slot - 1]}]" if slot <= slots else f"p[{slot - slots - 1}]"

    return "\n".join([*_written(graph, roots, names, source, trace.tables), ""])


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
            lines.append(f"  double answers{i}[{size}];")
            lines.append(f"  ((routine)routines[{2 * number}])(routines[{2 * number + 1}], given{i}, answers{i});")
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
            text = f"answers{operands[0]}[{operands[1]}]"
        elif op == "const":
            text = f"NUMBER({c_number(float.fromhex(operands[0]))})"
        elif op == "in":
            text = source(operands[0])
        else:
            text = _expression(op, [f"v{j}" for j in operands])
        lines.append(f"  const {kind} v{i} = {text};")
    return lines


def _expression(op: str, parts: Sequence[str]) -> str:
    if op in INFIX:
        return f"{parts[0]} {INFIX[op]} {parts[1]}"
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


_ONE = """\
#include <string.h>
#define INLINE static inline __attribute__((always_inline))
#define LANES 1
typedef long long bits;
INLINE bits bits_of(double a) { bits b; memcpy(&b, &a, 8); return b; }
INLINE double real_of(bits b) { double a; memcpy(&a, &b, 8); return a; }
#define lanes_floor floor
#define lanes_sqrt sqrt
#define lanes_asin asin
#define lanes_acos acos
#define lanes_tanh tanh
#define lanes_exp exp
#define lanes_log log
"""

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
typedef mask bits;
#define bits_of(a) ((bits)(a))
#define real_of(b) ((real)(b))
INLINE real number(double x) { real r; for (int i = 0; i < LANES; i++) r[i] = x; return r; }
INLINE real select(mask c, real a, real b) { return (real)((c & (mask)a) | (~c & (mask)b)); }
#define NUMBER(x) number(x)
#define NOT(a) (~(a))
#define SELECT(c, a, b) select(c, a, b)
#define ABS(a) ((real)((mask)(a) & 0x7fffffffffffffffLL))
#if defined(__clang__)
#define SHUFFLED(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define SHUFFLED(a, b, ...) __builtin_shuffle(a, b, (mask){__VA_ARGS__})
#endif
#define EXCHANGE(i, j, low, high) \\
  { const real a = m[i], b = m[j]; m[i] = SHUFFLED(a, b, low); m[j] = SHUFFLED(a, b, high); }
#if LANES == 8
#define LOW4 0, 1, 2, 3, 8, 9, 10, 11
#define HIGH4 4, 5, 6, 7, 12, 13, 14, 15
#define LOW2 0, 1, 8, 9, 4, 5, 12, 13
#define HIGH2 2, 3, 10, 11, 6, 7, 14, 15
#define LOW1 0, 8, 2, 10, 4, 12, 6, 14
#define HIGH1 1, 9, 3, 11, 5, 13, 7, 15
#elif LANES == 4
#define LOW2 0, 1, 4, 5
#define HIGH2 2, 3, 6, 7
#define LOW1 0, 4, 2, 6
#define HIGH1 1, 5, 3, 7
#else
#define LOW1 0, 2
#define HIGH1 1, 3
#endif
/* LANES numbers of a row for each car become LANES columns for all cars: blocks change places, then their parts */
INLINE void transpose(real *m)
{
#if LANES == 8
  for (int i = 0; i < 4; i++) EXCHANGE(i, i + 4, LOW4, HIGH4)
#endif
#if LANES >= 4
  for (int i = 0; i < LANES; i += 4) { EXCHANGE(i, i + 2, LOW2, HIGH2) EXCHANGE(i + 1, i + 3, LOW2, HIGH2) }
#endif
  for (int i = 0; i < LANES; i += 2) EXCHANGE(i, i + 1, LOW1, HIGH1)
}
INLINE void look_up(const double *table, double count, int width, real i, real *m)
{
  const bits at = __builtin_convertvector(select((i >= 0.0) & (i < count), i, number(count)), bits);
  for (int first = 0; first < width; first += LANES)
  {
    for (int l = 0; l < LANES; l++) memcpy(m + first + l, table + at[l] * width + first, sizeof(real));
    transpose(m + first);
  }
}
#define ROW(name, n, i) real name[width##n]; look_up(table##n, count##n, width##n, i, name)
#define AT(name, column) name[column]
#define BY_LANE(f) INLINE real lanes_##f(real a) \\
  { real r; for (int i = 0; i < LANES; i++) r[i] = f(a[i]); return r; }
BY_LANE(floor)
BY_LANE(sqrt)
#ifdef VECTOR_MATHS /* glibc's libmvec: within 4 units in the last place */
#define BY_VECTOR(f) extern real VECTOR(f, v)(real); INLINE real lanes_##f(real a) { return VECTOR(f, v)(a); }
BY_VECTOR(asin) BY_VECTOR(acos) BY_VECTOR(tanh) BY_VECTOR(exp) BY_VECTOR(log)
#else
BY_LANE(asin) BY_LANE(acos) BY_LANE(tanh) BY_LANE(exp) BY_LANE(log)
#endif
"""

_FUNCTIONS = """\
#define CALL1(f, a) lanes_##f(a)
#define CALL2(f, a, b) lanes_##f(a, b)
INLINE real signed_by(real a, bits sign) { return real_of(bits_of(a) ^ sign); }
/* a = k pi/2 + r by Cody and Waite's method, exact for |a| < 1e6 and within the rounding of a itself beyond; then
   fdlibm's polynomials in r */
INLINE real reduced(real a, bits *quarter)
{
  const real t = a * 0.63661977236758134308 + 6755399441055744.0, k = t - 6755399441055744.0;
  *quarter = bits_of(t);
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
INLINE real lanes_sin(real a)
{
  bits q;
  const real r = reduced(a, &q), s = sine(r), c = cosine(r);
  return signed_by(SELECT((q & 1) != 0, c, s), (q & 2) << 62);
}
INLINE real lanes_cos(real a)
{
  bits q;
  const real r = reduced(a, &q), s = sine(r), c = cosine(r);
  return signed_by(SELECT((q & 1) != 0, s, c), ((q + 1) & 2) << 62);
}
INLINE real lanes_tan(real a)
{
  bits q;
  const real r = reduced(a, &q), s = sine(r), c = cosine(r);
  const mask odd = (q & 1) != 0;
  return SELECT(odd, -c, s) / SELECT(odd, s, c);
}
/* the angle of (a, b), 0 <= a <= b: beyond pi/8 from pi/4 on; then fdlibm's polynomial, good to tan(pi/8) and more */
INLINE real octant(real a, real b)
{
  const mask steep = a > 0.41421356237309503 * b;
  const real below = SELECT(steep, a + b, b), r = SELECT(steep, a - b, a) / SELECT(below == 0.0, NUMBER(1.0), below);
  const real z = r * r, w = z * z;
  const real even = z * (3.33333333333329318027e-01 + w * (1.42857142725034663711e-01 + w * (9.09088713343650656196e-02
    + w * (6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)))));
  const real odd = w * (-1.99999999998764832476e-01 + w * (-1.11111104054623557880e-01
    + w * (-7.69187620504482999495e-02 + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))));
  const real less = r * (even + odd);
  return SELECT(steep, 7.85398163397448278999e-01 - ((less - 3.06161699786838301793e-17) - r), r - less);
}
INLINE real lanes_atan2(real y, real x)
{
  const real a = ABS(y), b = ABS(x);
  const mask upright = a > b;
  const real part = octant(SELECT(upright, b, a), SELECT(upright, a, b));
  const real right = SELECT(upright, 1.57079632679489655800 - (part - 6.12323399573676603587e-17), part);
  const real angle = SELECT(x < 0.0, 3.14159265358979311600 - (right - 1.22464679914735320717e-16), right);
  return signed_by(angle, bits_of(y) & (-0x7fffffffffffffffLL - 1));
}
INLINE real lanes_atan(real a)
{
  const real b = ABS(a);
  const mask upright = b > 1.0;
  const real part = octant(SELECT(upright, NUMBER(1.0), b), SELECT(upright, b, NUMBER(1.0)));
  const real angle = SELECT(upright, 1.57079632679489655800 - (part - 6.12323399573676603587e-17), part);
  return signed_by(angle, bits_of(a) & (-0x7fffffffffffffffLL - 1));
}
"""

ONE = _SCALAR + _ONE + _FUNCTIONS
MANY = _MANY + _FUNCTIONS
