"""The traced loop as straight-line Python on floats: no calls but those of `math`, no tuples, no attributes."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from steerkit.compiled.graph import FUNCTIONS, INFIX, Graph
from steerkit.compiled.trace import Trace
from steerkit.diagram.maths import Table

_INFIX = INFIX | {"and": "and", "or": "or"}
_LONGEST = 150  # characters of what is written where it is used: Python nests 200 parentheses


class PythonProgram:
    """Generated Python, `run(k, stop, slots, parameters, rows)`: gives the slots that go on, in `trace.persistent`'s
    order, and adds a row of the slots `recorded`, every so many ticks."""

    def __init__(self, trace: Trace, recorded: Sequence[int], every: int):
        self.trace = trace
        self.source = "\n".join(_run(trace, recorded, every))
        scope: dict[str, Any] = {f"table{i}": table._tuples for i, table in enumerate(trace.tables)}
        scope |= {f"routine{i}": routine for i, routine in enumerate(trace.routines)}
        scope |= {name: getattr(math, name) for name in FUNCTIONS} | {"nan": math.nan, "inf": math.inf}
        exec(compile(self.source, "<steerkit compiled loop>", "exec"), scope)
        self.run: Callable[..., tuple[float, ...]] = scope["run"]


def _run(trace: Trace, recorded: Sequence[int], every: int) -> list[str]:
    persistent = trace.persistent
    state = "".join(f"s{slot}, " for slot in persistent)
    lines = ["def run(k, stop, slots, parameters, rows):"]
    lines += [f"    {name}_ = {name}" for name in sorted(FUNCTIONS - {"floor"})]  # local names are found quickly
    lines += [f"    s{slot} = slots[{slot}]" for slot in persistent]
    lines += [f"    p{i} = parameters[{i}]" for i in range(len(trace.parameters))]
    lines += ["    append = rows.append", "    try:", "        for k in range(k, stop):"]
    last = len(trace.kinds) - 1
    for number, (tick, own) in enumerate(trace.kinds):
        pad = " " * 12
        if last:
            phases = f"if k % {len(trace.ticks)} in {tuple(own)}"
            lines.append(f"{pad}{f'el{phases}' if number else phases}:" if number < last else f"{pad}else:")
            pad += "    "
        roots = [tick.roots[slot] for slot in (*persistent, *recorded)]
        code, names = statements(tick.graph, roots, len(trace.layout), trace.tables)
        lines += [pad + line for line in code]
        row = "".join(f"{name}, " for name in names[len(persistent) :])
        lines.append(f"{pad}{'' if every == 1 else f'if not k % {every}: '}append(({row}))")
        moved = [(f"s{slot}", name) for slot, name in zip(persistent, names) if name != f"s{slot}"]
        if moved:
            lines.append(f"{pad}{', '.join(a for a, _ in moved)} = {', '.join(b for _, b in moved)}")
    return [
        *lines,
        "    except Exception as error:",
        f"        error.add_note(f'in tick {{k}}, t = {{k * {trace.loop.dt!r}:g}} s, of a compiled loop')",
        "        raise",
        f"    return ({state})",
    ]


def statements(graph: Graph, roots: Sequence[int], slots: int, tables: Sequence[Table]) -> tuple[list[str], list[str]]:
    """Assignments, and the names of the roots. What is used once is written where it is used.

    Input 0 is called k, the `slots` after it s0, s1, ..., what follows p0, p1, ..."""
    order, root_nodes = graph.order(roots), set(roots)
    uses = Counter(j for i in order for j in graph.operands(i))
    text: dict[int, str] = {}
    rows: dict[tuple[int, int], str] = {}
    lines: list[str] = []
    for i in order:
        op, *operands = graph.nodes[i]
        if op == "const":
            text[i] = _number(float.fromhex(operands[0]))
        elif op == "in":
            slot = operands[0]
            text[i] = "k" if slot == 0 else f"s{slot - 1}" if slot <= slots else f"p{slot - slots - 1}"
        elif op == "row":
            table, index, column = operands
            if (table, index) not in rows:
                rows[table, index] = f"r{len(rows)}"
                width = tables[table].rows.shape[1]
                columns = "".join(f"{rows[table, index]}_{c}, " for c in range(width))
                lines.append(f"{columns}= table{table}[int({text[index]})]")
            text[i] = f"{rows[table, index]}_{column}"
        elif op == "call":
            lines.append(f"c{i} = routine{operands[0]}({', '.join([text[j] for j in operands[2:]])})")
        elif op == "result":
            text[i] = f"c{operands[0]}[{operands[1]}]"
        else:
            expression = _expression(op, [text[j] for j in operands])
            if uses[i] == 1 and i not in root_nodes and len(expression) < _LONGEST:
                text[i] = f"({expression})"
            else:
                text[i] = f"v{i}"
                lines.append(f"v{i} = {expression}")
    return lines, [text[i] for i in roots]


def _expression(op: str, parts: Sequence[str]) -> str:
    if op in _INFIX:
        return f"{parts[0]} {_INFIX[op]} {parts[1]}"
    if op == "select":
        return f"{parts[1]} if {parts[0]} else {parts[2]}"
    if op == "floor":
        return f"{parts[0]} // 1.0"
    if op in ("neg", "not"):
        return f"{'-' if op == 'neg' else 'not '}{parts[0]}"
    return f"{op}({parts[0]})" if op == "abs" else f"{op}_({', '.join(parts)})"


def _number(value: float) -> str:
    return f"({value!r})" if value < 0.0 or value != value else repr(value)
