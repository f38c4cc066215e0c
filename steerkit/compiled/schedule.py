"""The order in which generated C writes its instructions down: long chains first, side by side."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

from steerkit.compiled.graph import BOOLEAN, Graph

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
