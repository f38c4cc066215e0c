"""Symbols that are quick to compute with: what they make is what CasADi's own operators and functions make."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.compiled import symbols
from steerkit.compiled.graph import Graph, from_symbols
from steerkit.compiled.symbols import Symbol, constant, numbers, symbol
from steerkit.compiled.trace import exact_arithmetic
from steerkit.diagram import maths as m

OPERATORS = [getattr(operator, name) for name in ("add", "sub", "mul", "truediv", "lt", "le", "gt", "ge", "eq", "ne")]
OF_ONE = ("sin", "cos", "tan", "asin", "acos", "atan", "tanh", "exp", "log", "sqrt", "floor", "fabs", "logic_not")
OF_TWO = ("atan2", "logic_and", "logic_or")
A, B, C = (casadi.SX.sym(name) for name in "abc")
NUMBERS = (2.0, 3, np.float64(0.5), 0.0, 1.0)


@pytest.fixture(params=[True, False], ids=["simplified", "exact"], autouse=True)
def simplified(request: pytest.FixtureRequest) -> Iterator[None]:
    """As CasADi does it by itself, and as loops are traced."""
    before = casadi.GlobalOptions.getSimplificationOnTheFly()
    casadi.GlobalOptions.setSimplificationOnTheFly(request.param)
    yield
    casadi.GlobalOptions.setSimplificationOnTheFly(before)


def quick(*plain: Any) -> list[Any]:
    """The same with symbols in place of CasADi's."""
    return [numbers(x)[0] if isinstance(x, casadi.SX) else x for x in plain]


def require_same(function: Callable[..., Any], theirs: Callable[..., Any], *plain: Any) -> None:
    made, expected = function(*quick(*plain)), theirs(*plain)
    assert type(made) is Symbol
    assert casadi.is_equal(made, expected, 20), f"{made} is not {expected}"


@pytest.mark.parametrize("act", OPERATORS, ids=lambda act: act.__name__)
def test_operators_make_what_casadi_makes(act: Callable[..., Any]) -> None:
    for pair in [(A, B), (A, A), *product([A], NUMBERS)]:
        require_same(act, act, *pair)
    for number in (2.0, 3):  # a NumPy number on the left asks in a way of its own
        require_same(act, act, number, A)
    with_numpy = act(np.float64(0.5), quick(A)[0])
    assert casadi.is_equal(casadi.SX(with_numpy), casadi.SX(act(np.float64(0.5), A)), 20)


def test_of_one() -> None:
    for act in (operator.neg, abs):
        require_same(act, act, A)
    for name in OF_ONE:
        require_same(getattr(symbols, name), getattr(casadi, name), A)


@pytest.mark.parametrize("name", OF_TWO)
def test_of_two(name: str) -> None:
    for pair in [(A, B), (A, 2.0), (3, A)]:
        require_same(getattr(symbols, name), getattr(casadi, name), *pair)


def test_a_choice_is_written_as_casadi_does() -> None:
    for parts in [(A < B, A, C), (A, 1.0, B), (A, B, 0), (A, 2.0, 3.0)]:
        require_same(symbols.if_else, casadi.if_else, *parts)


def equations(x: Any, y: Any) -> list[Any]:
    z = m.where(m.both(x > 0.0, m.either(y < 1.0, x == y)), m.sin(x) + m.atan2(y, x), m.clip(x, -1.0, y))
    return [z, m.wrap(z), m.absolute(z), m.sqrt(z * z), m.tan(z), m.exp(-z), m.maximum(z, y), m.sign(z), m.tanh(z)]


def test_maths_finds_them() -> None:
    (a, b), plain = quick(A, B), (A, B)
    for made, expected in zip(equations(a, b), equations(*plain), strict=True):
        assert type(made) is Symbol
        assert casadi.is_equal(made, expected, 50)
    function = casadi.Function("f", [a, b], equations(a, b))
    for x, y in ((1.3, 0.7), (-0.4, 2.0), (0.5, 0.5)):
        np.testing.assert_allclose([float(v) for v in function(x, y)], equations(x, y), rtol=1e-14, atol=1e-14)
    assert m.is_symbol(a)
    assert m.is_symbol(A)
    assert not m.is_symbol(1.0)


def test_with_anything_else_it_is_left_to_casadi() -> None:
    (a,) = quick(A)
    row = casadi.SX.sym("v", 1, 3)
    for act in (operator.add, operator.sub, operator.mul, operator.truediv, operator.lt):
        assert casadi.is_equal(act(a, row), act(A, row), 20)
        assert type(act(a, row)) is type(act(row, a)) is casadi.SX, "several numbers are no symbol"
        assert casadi.is_equal(act(row, a), act(row, A), 20)
        assert casadi.is_equal(act(a, B), act(A, B), 20)
        assert casadi.is_equal(act(B, a), act(B, A), 20)
        assert casadi.is_equal(casadi.SX(act(a, np.array([1.0, 2.0]))), casadi.SX(act(A, np.array([1.0, 2.0]))), 20)
    assert casadi.is_equal(symbols.if_else(True, a, row), casadi.if_else(True, A, row), 20)
    assert casadi.is_equal(symbols.atan2(row, a), casadi.atan2(row, A), 20)
    assert casadi.is_equal(a**2, A**2, 20)
    assert casadi.is_equal(a // 2.0, A // 2.0, 20)
    with pytest.raises(TypeError):
        a + "one"


def test_they_are_numbers_of_an_expression_and_keys_of_a_dictionary() -> None:
    x, y = symbol("x"), constant(2.5)
    function = casadi.Function("f", [x], [x * y])
    assert float(function(2.0)) == 5.0
    assert [type(entry) for entry in numbers(casadi.SX.sym("v", 3))] == [Symbol] * 3
    assert {x: 1}[x] == 1
    assert float(y) == 2.5


def test_a_graph_of_them_is_that_of_casadi_s_expressions() -> None:
    """But for choices of zero, which CasADi writes with one addition more."""
    a, b = quick(A, B)
    with exact_arithmetic():
        graphs = [from_symbols(equations(x, y), [x, y], []) for x, y in ((a, b), (A, B))]

    def written(graph: Graph, i: int) -> str:
        inner = {j: written(graph, j) for j in graph.operands(i)}
        return f"({' '.join(str(inner.get(part, part)) for part in graph.nodes[i])})"

    ours, theirs = ([written(graph, root) for root in roots] for graph, roots in graphs)
    of_sign = 7
    assert len(ours.pop(of_sign)) < len(theirs.pop(of_sign))
    assert ours == theirs


def test_a_negative_zero_stays_one() -> None:
    """CasADi's own number would be a positive one; the interpreted loop has the negative."""
    (a,) = quick(A)
    with exact_arithmetic():
        graph, (root,) = from_symbols([m.where(a > 0.0, a, -0.0)], [a], [])
    op, _, yes, no = graph.nodes[root]
    assert (op, graph.nodes[yes]) == ("select", ("in", 0))
    assert graph.nodes[no] == ("const", (-0.0).hex())
