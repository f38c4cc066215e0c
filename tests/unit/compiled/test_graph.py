"""The graph of instructions simplifies only what is exact."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit.compiled.c_code import function_source
from steerkit.compiled.graph import FUNCTIONS, Graph
from steerkit.compiled.python_code import statements
from steerkit.compiled.trace import traced
from steerkit.diagram import maths as m


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
    assert (g.boolean(negative), g.nodes[g.boolean(x)]) == (negative, ("ne", x, zero))
    assert g.const(0.0) != g.const(-0.0)
    assert g.const(math.nan) == g.const(math.nan)


def equations(x: Any, y: Any) -> list[Any]:
    z = m.where(m.both(x > 0.0, m.either(y < 1.0, x == y)), m.sin(x) + m.atan2(y, x), m.clip(x, -1.0, y))
    more = [1.0 - x, 2.0 / y, np.float64(0.5) * x, x / np.float64(4.0), x**2, -y, m.where(x <= 1.0, 2.0, 3.0)]
    return [z, m.wrap(z), m.absolute(z), m.sqrt(z * z), m.tan(z), m.exp(-z), m.sign(z), m.tanh(z), *more]


def test_symbols_write_down_what_is_computed_with_them() -> None:
    """A negative zero stays one, as in the interpreted loop."""
    tick = traced("equations", lambda new: [*equations(new(), new()), -0.0 * new()], [])
    texts = function_source("f(void)", tick, [f"y{i}" for i in range(16)], "x{}".format, [])
    code, roots = statements(tick.graph, tick.roots, 3, [])
    assert "(-0.0)" in texts
    scope = {**{f"{name}_": getattr(math, name) for name in FUNCTIONS}, "k": 1.3, "s0": 0.7, "s1": 1.0}
    for x, y in ((1.3, 0.7), (-0.4, 2.0), (0.5, 0.5)):
        now = scope | {"k": x, "s0": y}
        exec("\n".join(code), now)
        assert [eval(root, now) for root in roots[:-1]] == [float(value) for value in equations(x, y)]


def test_what_is_no_equation_is_refused() -> None:
    x, other = Graph().input(0), Graph().input(0)
    for attempt, what in (
        (lambda: 1.0 if x > 0.0 else 2.0, "asks if a signal is true"),
        (lambda: x + other, "kept from another trace"),
        (lambda: x**3, "power of 3"),
        (lambda: x + "one", "computes with 'one', a str, expected a number"),
        (lambda: np.sin(x), "ufunc"),
        (lambda: math.sin(x), "plain number of a signal"),
        (lambda: {x: 1}, "for a key of a dictionary"),
    ):
        with pytest.raises((TypeError, ValueError), match=what):
            attempt()
    assert m.is_symbol(x)
    assert len(x.graph.refused) == 4  # known though they were caught
