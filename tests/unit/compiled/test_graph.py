"""The graph of instructions simplifies only what is exact."""

from __future__ import annotations

import math

from steerkit.compiled.graph import Graph


def test_the_graph_simplifies_only_what_is_exact() -> None:
    g = Graph()
    x, one, zero = g.add("in", 1), g.const(1.0), g.const(0.0)
    assert g.add("mul", one, x) == x
    assert g.nodes[g.add("mul", zero, x)][0] == "mul"  # NaN*0 is NaN
    assert g.value(g.add("add", one, one)) == 2.0
    assert g.nodes[g.add("div", one, zero)][0] == "div"
    negative = g.add("lt", x, zero)
    assert g.add("select", negative, x, x) == x
    assert g.add("not", g.add("not", negative)) == negative
    assert g.const(0.0) != g.const(-0.0)
    assert g.const(math.nan) == g.const(math.nan)
