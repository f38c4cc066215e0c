"""The traced loop as CasADi functions: run by CasADi's virtual machine, differentiated by CasADi."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import casadi
import numpy as np

from steerkit.compiled import symbols
from steerkit.compiled.graph import FUNCTIONS, Graph
from steerkit.compiled.trace import Trace, exact_arithmetic
from steerkit.diagram.maths import Table

_LONGEST = 10  # runs are made of mapaccums of 2^0 .. 2^10 periods, so that memory is bounded


class VmProgram:
    """CasADi functions of a loop. `phase(i)`, `period()` map (z,) to (z', recorded), z = [k, persistent, parameters].

    Table rows depend on indices that depend on earlier rows, so a tick is a chain of stages of plain instructions
    (SX functions), with look-ups between them (MX).
    """

    def __init__(self, trace: Trace, recorded: Sequence[int]):
        self.trace, self.recorded = trace, tuple(recorded)
        self.tables = [_row_function(i, table) for i, table in enumerate(trace.tables)]

    @functools.cached_property
    def phases(self) -> list[Any]:
        """One function (z) -> (z', recorded) a phase."""
        kinds = range(len(self.trace.kinds))
        made = [self._tick(kind, [*self.trace.persistent, *self.recorded], split=True) for kind in kinds]
        return [made[self.trace.kind(phase)] for phase in range(len(self.trace.ticks))]

    def finish(self, phase: int) -> Any:
        """The function (z) -> (all slots) of one phase."""
        return self._finish(self.trace.kind(phase))

    @functools.cache  # noqa: B019 (lives as long as the program)
    def _finish(self, kind: int) -> Any:
        return self._tick(kind, range(len(self.trace.layout)), split=False)

    @functools.cached_property
    def period(self) -> Any:
        """One whole period as one function."""
        if len(self.phases) == 1:
            return self.phases[0]
        z = start = casadi.MX.sym("z", self.phases[0].size1_in(0))
        rows = []
        for phase in self.phases:
            z, y = phase(z)
            rows.append(y)
        return casadi.Function("period", [start], [z, casadi.vertcat(*rows)])

    @functools.cache  # noqa: B019 (lives as long as the program)
    def block(self, size: int) -> Any:
        """2**size periods as one function: z -> (z at the end, recorded of each)."""
        return self.period.mapaccum(f"run{size}", 2**size) if size else self.period

    def run(self, k: int, stop: int, z: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Run ticks k to stop from z (changed in place); yields (first tick, recorded rows) of every part."""
        m, period = len(self.recorded), len(self.phases)
        while k < stop:
            if k % period or stop - k < period:
                function, ticks = self.phases[k % period], 1
            else:
                size = min(_LONGEST, ((stop - k) // period).bit_length() - 1)
                function, ticks = self.block(size), period * 2**size
            end, rows = function(z)
            z[:] = np.asarray(end)[:, -1]
            yield k, np.asarray(rows).reshape(-1, order="F").reshape(ticks, m) if m else np.empty((ticks, 0))
            k += ticks

    def _tick(self, kind: int, wanted: Sequence[int], *, split: bool) -> Any:
        trace, (tick, _) = self.trace, self.trace.kinds[kind]
        slots, persistent = len(trace.layout), trace.persistent
        entry_of = {0: 0} | {slot + 1: i + 1 for i, slot in enumerate(persistent)}
        entry_of |= {slots + 1 + i: len(persistent) + 1 + i for i in range(len(trace.parameters))}
        roots = [tick.roots[slot] for slot in wanted]
        z = casadi.MX.sym("z", len(entry_of))
        with exact_arithmetic():
            values = self._staged(tick.graph, roots, z, entry_of)
        if not split:
            return casadi.Function(f"finish{kind}", [z], [values])
        n = len(persistent)
        end = casadi.vertcat(z[0] + 1.0, values[:n], z[n + 1 :])
        return casadi.Function(f"tick{kind}", [z], [end, values[n:]])

    def _staged(self, graph: Graph, roots: Sequence[int], z: Any, entry_of: dict[int, int]) -> Any:
        """MX of the roots' values."""
        order = graph.order(roots)
        stage: dict[int, int] = {}
        for i in order:
            stage[i] = max((stage[j] for j in graph.operands(i)), default=0) + (graph.nodes[i][0] == "row")
        last = max(stage[i] for i in roots)
        found: dict[int, Any] = {}
        inputs = [casadi.SX.sym("z", len(entry_of))]  # of the stage functions, which take all that came before
        entries = symbols.numbers(inputs[0])
        arguments = [z]
        indices: dict[tuple[int, int], Any] = {}
        for now in range(last + 1):
            looked_up: dict[tuple[int, int], list[Any]] = {}
            for i in (i for i in order if stage[i] == now):
                op, *operands = graph.nodes[i]
                if op == "row":
                    table, index, column = operands
                    if (table, index) not in looked_up:
                        row = casadi.SX.sym("row", self.tables[table].size1_out(0))
                        looked_up[table, index] = symbols.numbers(row)
                        inputs.append(row)
                        arguments.append(self.tables[table](indices[table, index]))
                    found[i] = looked_up[table, index][column]
                elif op == "in":
                    found[i] = entries[entry_of[operands[0]]]
                elif op == "const":
                    found[i] = symbols.constant(float.fromhex(operands[0]))
                else:
                    found[i] = _CALLS[op](*[found[j] for j in operands])
            if now == last:
                break
            later = [i for i in order if stage[i] > now]
            next_rows = [graph.nodes[i] for i in later if graph.nodes[i][0] == "row" and stage[i] == now + 1]
            lookups = list(dict.fromkeys((table, index) for _, table, index, _ in next_rows))
            used = {j for i in later for j in graph.operands(i)} | set(roots)
            crossing = [
                i for i in order if stage[i] == now and i in used and graph.nodes[i][0] not in ("const", "in", "row")
            ]
            outputs = [casadi.vertcat(*[found[i] for i in crossing]), *[found[i] for _, i in lookups]]
            function = casadi.Function(f"stage{now}", inputs, outputs)
            results = function.call(arguments)
            indices = dict(zip(lookups, results[1:]))
            if crossing:
                known = casadi.SX.sym("c", len(crossing))
                inputs.append(known)
                arguments.append(results[0])
                found |= dict(zip(crossing, symbols.numbers(known)))
        function = casadi.Function("stage", inputs, [casadi.vertcat(*[found[i] for i in roots])])
        return function.call(arguments)[0]


def _row_function(number: int, table: Table) -> Any:
    """index -> row. Linear interpolation at whole numbers is the row itself, at the cost of one step of search."""
    rows = table.rows if len(table) > 1 else np.repeat(table.rows, 2, axis=0)
    grid = np.arange(len(rows), dtype=float)
    return casadi.interpolant(f"table{number}", "linear", [grid], rows.ravel(), {"lookup_mode": ["exact"]})


_CALLS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "and": symbols.logic_and,
    "or": symbols.logic_or,
    "not": symbols.logic_not,
    "select": symbols.if_else,
    "abs": symbols.fabs,
    **{name: getattr(symbols, name) for name in FUNCTIONS},
}
