"""The order of instructions in generated C: complete, operands first, chains side by side, the longest way first."""

from __future__ import annotations

import numpy as np

from steerkit.compiled.graph import Graph
from steerkit.compiled.schedule import scheduled
from steerkit.compiled.trace import trace
from tests.support.traced_blocks import mixed_loop


def chain(graph: Graph, slot: int, length: int, op: str = "mul") -> int:
    node = first = graph.add("in", slot)
    for _ in range(length):
        node = graph.add(op, node, first)
    return node


def test_a_loops_instructions_come_once_each_after_its_operands() -> None:
    for tick in trace(mixed_loop(0.05)).ticks:
        order = scheduled(tick.graph, tick.roots)
        assert sorted(order) == sorted(tick.graph.order(tick.roots))
        place = {i: n for n, i in enumerate(order)}
        assert all(place[j] < place[i] for i in order for j in tick.graph.operands(i))


def test_chains_that_do_not_wait_for_each_other_stand_side_by_side() -> None:
    graph = Graph()
    roots = [chain(graph, slot, 50) for slot in range(3)]
    order = [i for i in scheduled(graph, roots) if graph.nodes[i][0] == "mul"]
    first = [min(n for n, i in enumerate(order) if graph.nodes[i][2] == start) for start in (0, 51, 102)]
    last = [max(n for n, i in enumerate(order) if graph.nodes[i][2] == start) for start in (0, 51, 102)]
    assert max(first) <= 3
    assert min(last) >= len(order) - 3
    one_by_one = graph.order(roots)
    assert np.ptp([one_by_one.index(root) for root in roots]) > 90  # what it is better than


def test_the_longest_way_to_the_end_begins() -> None:
    """A division takes longer than three products."""
    graph = Graph()
    products, quotients = chain(graph, 0, 3), chain(graph, 1, 3, op="div")
    order = [graph.nodes[i][0] for i in scheduled(graph, [products, quotients])]
    assert next(op for op in order if op != "in") == "div"
    assert order[-1] == "div"
    assert order.index("mul") < len(order) - 1


def test_nothing_wanted_is_nothing_written() -> None:
    assert scheduled(Graph(), []) == []
