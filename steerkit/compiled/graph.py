"""The traced equations of one tick as a list of instructions that every backend is generated from."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi

from steerkit.compiled.symbols import CHOICE, Symbol

Node = tuple[Any, ...]
"""`(op, *operands)`: operands are numbers of earlier nodes, except of const (its hex), in (slot), row (table number,
index, column), call (routine number, how many numbers it gives, its arguments) and result (a call, column)."""


class Question(NamedTuple):
    """What a table or a routine was asked while tracing."""

    kind: str
    """row or call."""
    number: int
    arguments: tuple[Any, ...]
    answers: list[Any]
    """New symbols."""


_UNARY = {
    casadi.OP_SQRT: "sqrt",
    casadi.OP_SIN: "sin",
    casadi.OP_COS: "cos",
    casadi.OP_TAN: "tan",
    casadi.OP_ASIN: "asin",
    casadi.OP_ACOS: "acos",
    casadi.OP_ATAN: "atan",
    casadi.OP_TANH: "tanh",
    casadi.OP_EXP: "exp",
    casadi.OP_LOG: "log",
    casadi.OP_FLOOR: "floor",
    casadi.OP_FABS: "abs",
    casadi.OP_NEG: "neg",
}
_BINARY = {
    casadi.OP_ADD: "add",
    casadi.OP_SUB: "sub",
    casadi.OP_MUL: "mul",
    casadi.OP_DIV: "div",
    casadi.OP_ATAN2: "atan2",
}
_COMPARE = {casadi.OP_LT: "lt", casadi.OP_LE: "le", casadi.OP_EQ: "eq", casadi.OP_NE: "ne"}
_LOGIC = {casadi.OP_AND: "and", casadi.OP_OR: "or"}
BOOLEAN = frozenset({*_COMPARE.values(), *_LOGIC.values(), "not"})
FUNCTIONS = frozenset({"sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "exp", "log", "floor", "atan2"})

_FOLD: dict[str, Callable[[float, float], Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "div": lambda a, b: a / b,
    "atan2": math.atan2,
}
_FOLD_ONE: dict[str, Callable[[float], Any]] = {
    **{name: getattr(math, name) for name in _UNARY.values() if hasattr(math, name)},
    "abs": abs,
    "neg": lambda a: -a,
    "floor": lambda a: a // 1.0,
}


class Graph:
    """Instructions in an order in which they can be run; equal ones are stored once.

    Operations: const, in (an input slot), row (of a table), call and result (of a routine), the arithmetic add sub mul
    div neg, the functions of `steerkit.diagram.maths`, comparisons and logic (which give booleans) and
    select(condition, yes, no).
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[Node, int] = {}

    def const(self, value: float) -> int:
        """The node of a number."""
        return self._put(("const", float(value).hex()))

    def value(self, i: int) -> float | None:
        """The number that node i is, None if it is not constant."""
        op, *operands = self.nodes[i]
        return float.fromhex(operands[0]) if op == "const" else None

    def operands(self, i: int) -> tuple[int, ...]:
        """The nodes that node i needs."""
        node = self.nodes[i]
        op = node[0]
        if op in ("const", "in"):
            return ()
        if op == "call":
            return node[3:]
        if op == "row":
            return node[2:3]
        return node[1:2] if op == "result" else node[1:]

    def add(self, op: str, *operands: Any) -> int:
        """The node of an operation; simplified only where IEEE arithmetic gives the same number."""
        if op in ("in", "row", "call", "result"):
            return self._put((op, *operands))
        if op == "select":
            return self._select(*operands)
        if op in _LOGIC.values() or op == "not":
            return self._logic(op, [self.boolean(i) for i in operands])
        numbers = [self.number(i) for i in operands]
        values = [self.value(i) for i in numbers]
        fold: Callable[..., Any] | None = _FOLD.get(op) or _FOLD_ONE.get(op)
        if fold is not None and None not in values:
            with contextlib.suppress(ArithmeticError, ValueError):  # 1/0 and the like: left to the run
                return self.const(fold(*values))
        if (op == "mul" and values[0] == 1.0) or (op == "neg" and self.nodes[numbers[0]][0] == "neg"):
            return numbers[1] if op == "mul" else self.nodes[numbers[0]][1]
        if op in ("mul", "div") and values[1] == 1.0:
            return numbers[0]
        if op == "add" and (choice := self._either(*numbers)) is not None:
            return choice
        return self._put((op, *numbers))

    def number(self, i: int) -> int:
        """Node i as a number: a boolean becomes 1 or 0."""
        return self._put(("select", i, self.const(1.0), self.const(0.0))) if self.nodes[i][0] in BOOLEAN else i

    def boolean(self, i: int) -> int:
        """Node i as a condition; constants stay constants."""
        op, *operands = self.nodes[i]
        if op in BOOLEAN or op == "const":
            return i
        if op == "select" and (self.value(operands[1]), self.value(operands[2])) == (1.0, 0.0):
            return operands[0]
        return self._put(("ne", i, self.const(0.0)))

    def order(self, roots: Iterable[int]) -> list[int]:
        """The nodes that `roots` need, each after its operands, close to where they are used."""
        done: dict[int, None] = {}
        for root in roots:
            stack = [root]
            while stack:
                i = stack[-1]
                waiting = [j for j in self.operands(i) if j not in done] if i not in done else None
                if waiting:
                    stack.extend(reversed(waiting))
                else:
                    done[stack.pop()] = None
        return list(done)

    def _put(self, node: Node) -> int:
        if node not in self._known:
            self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return self._known[node]

    def _select(self, condition: int, yes: int, no: int) -> int:
        condition, yes, no = self.boolean(condition), self.number(yes), self.number(no)
        fixed = self.value(condition)
        if yes == no or (fixed is not None and fixed != 0.0):
            return yes
        return no if fixed is not None else self._put(("select", condition, yes, no))

    def _logic(self, op: str, parts: list[int]) -> int:
        values = [self.value(i) for i in parts]
        if op == "not":
            if values[0] is not None:
                return self.const(not values[0])
            return self.nodes[parts[0]][1] if self.nodes[parts[0]][0] == "not" else self._put((op, *parts))
        for value, other in zip(values, reversed(parts)):
            if value is not None:  # with a constant, `and` and `or` are either the other part or decided
                return other if bool(value) == (op == "and") else self.const(op == "or")
        return self._put((op, *parts))

    def _either(self, a: int, b: int) -> int | None:
        """CasADi writes a choice as (c ? yes : 0) + (not c ? no : 0); as one node it is cheaper and exact."""
        first, second = self.nodes[a], self.nodes[b]
        if first[0] != "select" or second[0] != "select" or self.value(first[3]) != 0.0 or self.value(second[3]) != 0.0:
            return None
        if self.nodes[second[1]] == ("not", first[1]):
            return self._select(first[1], first[2], second[2])
        return None


def from_symbols(
    expressions: Sequence[Any], inputs: Sequence[Any], questions: Sequence[Question]
) -> tuple[Graph, list[int]]:
    """The graph of scalar SX `expressions` of SX symbols `inputs`, and the nodes of the expressions.

    questions: what was asked, each of inputs and earlier answers only.
    Raises NotImplementedError for an operation that `steerkit.diagram.maths` does not have.
    """
    graph = Graph()
    known: dict[Any, int] = {x.element_hash(): graph.add("in", i) for i, x in enumerate(inputs)}
    for kind, number, arguments, answers in questions:
        values = [_convert(graph, a, known) for a in arguments]
        if kind == "call":
            called = graph.add("call", number, len(answers), *map(graph.number, values))
        for column, symbol in enumerate(answers):
            node = ("result", called, column) if kind == "call" else ("row", number, values[0], column)
            known[symbol.element_hash()] = graph.add(*node)
    return graph, [graph.number(_convert(graph, e, known)) for e in expressions]


def _convert(graph: Graph, root: Any, known: dict[Any, int]) -> int:
    """The node of an expression; known: nodes by what `_key` has for their expressions, asked for once: it costs."""
    first = _key(root)
    stack: list[tuple[Any, Any, list[tuple[Any, Any]] | None]] = [(root, first, None)]
    while stack:
        e, key, parts = stack.pop()
        if key in known:
            continue
        if parts is None:
            parts = [(p, _key(p)) for p in _operands(e)]
            if not parts and not (isinstance(e, casadi.SX) and e.is_symbolic()):
                known[key] = graph.const(float(e))
                continue
            waiting = [(p, part, None) for p, part in parts if part not in known]
            if waiting:
                stack.append((e, key, parts))
                stack.extend(waiting)
                continue
        known[key] = _operation(graph, e, [known[part] for _, part in parts])
    return known[first]


def _key(e: Any) -> Any:
    """What an expression is known by: CasADi's hash; what knows its operands, itself; a number, its digits."""
    if _made_of(e):
        return "made", id(e)
    return e.element_hash() if isinstance(e, casadi.SX) else float(e).hex()


def _made_of(e: Any) -> tuple[Any, ...]:
    """Operation and operands, where the expression knows them itself."""
    return e.made_of if type(e) is Symbol else ()


def _operands(e: Any) -> Sequence[Any]:
    """What an expression is computed from; nothing for a symbol that is new, or a number."""
    if not isinstance(e, casadi.SX):
        return ()
    return _made_of(e)[1:] or [e.dep(i) for i in range(e.n_dep())]


def _operation(graph: Graph, e: Any, parts: list[int]) -> int:
    op = _made_of(e)[0] if _made_of(e) else e.op()
    if op == CHOICE:
        return graph.add(CHOICE, *parts)
    for names in (_UNARY, _BINARY, _COMPARE, _LOGIC):
        if op in names:
            return graph.add(names[op], *parts)
    if op == casadi.OP_NOT:
        return graph.add("not", *parts)
    if op == casadi.OP_IF_ELSE_ZERO:
        return graph.add("select", *parts, graph.const(0.0))
    if op == casadi.OP_SQ or (op in (casadi.OP_POW, casadi.OP_CONSTPOW) and graph.value(parts[1]) == 2.0):
        return graph.add("mul", parts[0], parts[0])
    if op == casadi.OP_TWICE:
        return graph.add("add", parts[0], parts[0])
    if op == casadi.OP_INV:
        return graph.add("div", graph.const(1.0), parts[0])
    if op in (casadi.OP_FMIN, casadi.OP_FMAX):
        a, b = parts if op == casadi.OP_FMIN else parts[::-1]
        return graph.add("select", graph.add("lt", *([b, a] if op == casadi.OP_FMIN else [a, b])), b, a)
    if op == casadi.OP_PARAMETER:
        raise NotImplementedError(f"the symbol {e.name()} is no input of the loop; was it kept from another trace?")
    raise NotImplementedError(f"an operation that steerkit.diagram.maths does not have, in {str(e)[:60]}")


def collapsed(graph: Graph, roots: Sequence[int], fixed: Mapping[int, float]) -> tuple[Graph, list[int]]:
    """The same equations with the inputs in `fixed` as numbers, and chains of linear operations multiplied out.

    A Runge-Kutta step of a linear plant at a constant speed is a polynomial of its matrix; multiplied out it is one
    row of the step matrix an output: x(k+1) = A x(k) + B u(k), exactly. That is done where it takes fewer operations.
    A term with the coefficient zero is left out: what it multiplied is taken to be finite. What feeds a floor, a
    comparison or a table index is left as it was written, since there a last digit may decide. Agrees with `graph` to
    rounding.
    """
    candidates = [_multiplied_out(graph, roots, longest, fixed) for longest in (0, 6, 32)]
    return min(candidates, key=lambda candidate: _count(*candidate))


def _count(graph: Graph, roots: Sequence[int]) -> int:
    return sum(graph.nodes[i][0] not in ("const", "in") for i in graph.order(roots))


_LINEAR = frozenset({"add", "sub", "mul", "div", "neg"})
_Form = dict[int, float]  # coefficient by node of the new graph; key -1 holds the constant


def _multiplied_out(
    graph: Graph, roots: Sequence[int], longest: int, fixed: Mapping[int, float]
) -> tuple[Graph, list[int]]:
    new = Graph()
    order = graph.order(roots)
    exact = _exact(graph, order)
    forms: dict[int, _Form] = {}
    made: dict[int, int] = {}

    def node(i: int) -> int:
        if i not in made:
            made[i] = _emit(new, forms[i])
        return made[i]

    for i in order:
        op, *operands = graph.nodes[i]
        if op == "in" and operands[0] in fixed:
            made[i] = new.const(fixed[operands[0]])
            forms[i] = {-1: fixed[operands[0]]}
            continue
        form = _form(op, [forms[j] for j in operands]) if op in _LINEAR and i not in exact else None
        if form is not None:
            form = {key: c for key, c in form.items() if c != 0.0} or {-1: 0.0}
        if form is not None and len(form) <= longest and all(map(math.isfinite, form.values())):
            forms[i] = form
            continue
        if op == "const":
            made[i] = new.const(float.fromhex(operands[0]))
        elif op == "in":
            made[i] = new.add(op, *operands)
        elif op == "row":
            made[i] = new.add(op, operands[0], node(operands[1]), operands[2])
        elif op == "call":
            made[i] = new.add(op, *operands[:2], *[node(j) for j in operands[2:]])
        elif op == "result":
            made[i] = new.add(op, node(operands[0]), operands[1])
        else:
            made[i] = new.add(op, *[node(j) for j in operands])
        value = new.value(made[i])
        forms[i] = {made[i]: 1.0} if value is None else {-1: value}
    return new, [node(i) for i in roots]


def _exact(graph: Graph, order: list[int]) -> set[int]:
    """Nodes that reach a floor, a comparison or a table index through linear operations alone."""
    exact: set[int] = set()
    for i in reversed(order):
        op, *_ = graph.nodes[i]
        if op in ("floor", "row") or op in BOOLEAN or (i in exact and op in (*_LINEAR, "select")):
            exact.update(graph.operands(i))
    return exact


def _form(op: str, forms: list[_Form]) -> _Form | None:
    def scaled(form: _Form, by: float) -> _Form:
        return {key: by * c for key, c in form.items()}

    if op == "neg":
        return scaled(forms[0], -1.0)
    a, b = forms
    if op in ("add", "sub"):
        total = dict(a)
        for key, c in b.items():
            total[key] = total.get(key, 0.0) + (c if op == "add" else -c)
        return total
    if op == "div":
        return scaled(a, 1.0 / b[-1]) if b.keys() == {-1} and b[-1] != 0.0 else None
    if a.keys() == {-1}:
        return scaled(b, a[-1])
    return scaled(a, b[-1]) if b.keys() == {-1} else None


def _emit(graph: Graph, form: _Form) -> int:
    """Terms with the same coefficient are added first, then scaled once."""
    groups: dict[float, int] = {}
    for key, c in form.items():
        if key != -1:
            groups[c] = graph.add("add", groups[c], key) if c in groups else key
    total = None if form.get(-1, 0.0) == 0.0 else graph.const(form[-1])
    for c, group in groups.items():
        term = graph.add("mul", graph.const(c), group)
        total = term if total is None else graph.add("add", total, term)
    return graph.const(0.0) if total is None else total
