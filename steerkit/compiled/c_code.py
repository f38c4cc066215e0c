"""The traced loop as C: for one car in doubles, or for several cars at once in SIMD vectors of doubles."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

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
MANY, _RUN = (Path(__file__).with_name(name).read_text(encoding="utf-8") for name in ("lanes.c", "run.c"))
ONE = f"#define ONE_CAR\n{_SCALAR}{MANY}"


def scheduled(graph: Graph, roots: Sequence[int]) -> list[int]:
    """The nodes that `roots` need, each after its operands, those with chains of operands of one length side by side.

    A processor looks some hundred instructions ahead. A loop's blocks are chains of dependent instructions much longer
    than that, a car's substeps and the tracker's search, say; written one after the other they also run so.
    """
    length: dict[int, int] = {}
    for i in graph.order(roots):
        length[i] = 1 + max([length[j] for j in graph.operands(i)], default=0)
    return sorted(length, key=length.__getitem__)


def run_source(trace: Trace, recorded: Sequence[int], *, many: bool) -> str:
    """A C file with `run`: ticks k to stop, every so many recorded, of cars in groups of `lanes()`.

    many: several cars a group. `routines` has of each routine the addresses of a function and of its first argument.
    """
    persistent = trace.persistent
    names = [f"s[{i}]" for i in range(len(persistent))] + [f"y[{i}]" for i in range(len(recorded))]
    slots, ticks = len(trace.layout), []

    def source(slot: int) -> str:
        if slot == 0:
            return "NUMBER(k)"
        return f"s[{persistent.index(slot - 1)}]" if slot <= slots else f"p[{slot - slots - 1}]"

    for number, (tick, _) in enumerate(trace.kinds):
        wanted = Tick(tick.graph, tuple([tick.roots[slot] for slot in (*persistent, *recorded)]))
        head = f"tick{number}(double k, real *s, const real *p, real *y, void **routines)"
        ticks.append(function_source(head, wanted, names, source, trace.tables))
    cases = [f"{label} tick{i}((double)k, s, p, y, routines); break;" for i, label in enumerate(phase_labels(trace))]
    carried, given, kept = len(persistent), len(trace.parameters), len(recorded)
    sizes = dict(PERSISTENT=max(1, carried), PARAMETERS=max(1, given), RECORDED=max(1, kept))
    sizes |= dict(CARRIED=carried, GIVEN=given, KEPT=kept, PERIOD=len(trace.ticks))
    numbers = f"enum {{ {', '.join([f'{name} = {size}' for name, size in sizes.items()])} }};"
    return "\n".join([head_source(trace.tables, many=many), *ticks, numbers, f"#define CASES {' '.join(cases)}", _RUN])


def phase_labels(trace: Trace, suffix: str = "") -> list[str]:
    """Of each of `trace.kinds` its labels in a `switch` over the phase. suffix: of the numbers."""
    own = [" ".join([f"case {phase}{suffix}:" for phase in phases]) for _, phases in trace.kinds[:-1]]
    return [*own, "default:"]


def head_source(tables: Sequence[Table], *, many: bool = True) -> str:
    """The head of a C file: types, functions and these tables. many: its `real` is a vector of LANES cars' numbers."""
    return "\n".join(["#include <math.h>\n", MANY if many else ONE, table_source(tables, lanes=many)])


def function_source(
    head: str, tick: Tick, names: Sequence[str], source: Callable[[int], str], tables: Sequence[Table]
) -> str:
    """A C function that writes a graph's roots to `names`: all are read before any is written. source: an input's C."""
    lines = statements(tick.graph, tick.roots, source, tables)
    lines += [f"  const real w{n} = v{i};" for n, i in enumerate(tick.roots)]
    lines += [f"  {name} = w{n};" for n, name in enumerate(names)]
    return "\n".join([f"static inline void {head}\n{{", *lines, "}\n"])


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


def statements(graph: Graph, roots: Sequence[int], source: Callable[[int], str], tables: Sequence[Table]) -> list[str]:
    """One `const real v<node> = ...;` a node, `scheduled`. source: the C text of an input slot."""
    lines: list[str] = []
    rows: set[tuple[int, int]] = set()
    for i in scheduled(graph, roots):
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
