"""The graph of instructions simplifies only what is exact."""

from __future__ import annotations

import math

import pytest

from steerkit.compiled.graph import Graph, collapsed


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


def test_choices_that_are_added_are_one_only_if_they_exclude_each_other() -> None:
    g = Graph()
    x, y, zero = g.add("in", 1), g.add("in", 2), g.const(0.0)
    first, second = g.add("lt", x, zero), g.add("lt", y, zero)
    apart = g.add("add", g.add("select", first, x, zero), g.add("select", second, y, zero))
    assert g.nodes[apart][0] == "add"
    whole = g.add("add", g.add("select", first, x, zero), g.add("select", g.add("not", first), y, zero))
    assert g.nodes[whole] == ("select", first, x, y)


@pytest.mark.parametrize("after", ["floor", "le", "row"])
def test_what_a_last_digit_decides_is_not_multiplied_out(after: str) -> None:
    """(0.1 x) 3 is not 0.3 x to the last digit: before a floor, a comparison or a table it stays as it was written."""
    g = Graph()
    x = g.add("in", 1)
    product = g.add("mul", g.add("mul", g.const(0.1), x), g.const(3.0))
    node = {
        "floor": lambda: g.add("floor", product),
        "le": lambda: g.add("select", g.add("le", product, g.const(0.9)), x, g.const(0.0)),
        "row": lambda: g.add("row", 0, product, 0),
    }[after]()
    plain, (root,) = collapsed(g, [product], {})
    assert sum(plain.nodes[i][0] == "mul" for i in plain.order([root])) == 1
    exact, (root,) = collapsed(g, [node], {})
    assert sum(exact.nodes[i][0] == "mul" for i in exact.order([root])) == 2
