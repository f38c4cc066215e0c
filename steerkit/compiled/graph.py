"""The traced equations of one tick as a list of instructions that every backend is generated from."""

import contextlib
import functools
import math
import operator
from collections.abc import Callable, Iterable, Sequence
from types import SimpleNamespace
from typing import Any, NoReturn

from steerkit.diagram.maths import Routine, Table

Node = tuple[Any, ...]
"""`(op, *operands)`: operands are numbers of earlier nodes, except of const (its hex), in (slot), row (table number,
index, column), call (routine number, how many numbers it gives, its arguments) and result (a call, column)."""

_COMPARE = frozenset({"lt", "le", "eq", "ne"})
_LOGIC = frozenset({"and", "or"})
BOOLEAN = _COMPARE | _LOGIC | {"not"}
INFIX = {
    "add": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "lt": "<",
    "le": "<=",
    "eq": "==",
    "ne": "!=",
    "and": "&",
    "or": "|",
}
"""How C writes what stands between two operands."""
FUNCTIONS = frozenset({"sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "exp", "log", "floor", "atan2"})

_FOLD: dict[str, Callable[..., Any]] = {
    **{name: getattr(math, name) for name in FUNCTIONS},
    **{name: getattr(operator, name) for name in ("add", "sub", "mul", "neg", "abs", *_COMPARE)},
    "div": operator.truediv,
    "floor": lambda a: a // 1.0,
}


class Graph:
    """Instructions in an order in which they can be run; equal ones are stored once.

    tables: those that are asked by number; routines: may one be called? Operations: const, in (an input slot), row (of
    a table), call and result (of a routine), the arithmetic add sub mul div neg, the functions of
    `steerkit.diagram.maths`, comparisons and logic (which give booleans) and select(condition, yes, no).
    """

    def __init__(self, tables: list[Table] | None = None, *, routines: bool = True) -> None:
        self.nodes: list[Node] = []
        self.tables: list[Table] = [] if tables is None else tables
        self.routines: list[Routine] | None = [] if routines else None
        self._known: dict[Node, int] = {}
        self.refused: list[TypeError] = []
        """What was asked of symbols that they cannot answer, though a block may have caught the error."""

    def input(self, slot: int) -> "Symbol":
        """The symbol of an input slot."""
        return Symbol(self, self.add("in", slot))

    def node(self, value: Any) -> int:
        """The node of a symbol of this graph, or of a number; raises TypeError for anything else."""
        if type(value) is not Symbol:
            return self.const(value)
        if value.graph is not self:
            raise TypeError("a symbol that is no input of the loop; was it kept from another trace?")
        return value.node

    def const(self, value: Any) -> int:
        """The node of a number; raises TypeError for anything else."""
        try:
            return self._put(("const", float(value).hex()))
        except (TypeError, ValueError):
            shape = f" of shape {value.shape}" if getattr(value, "shape", ()) else ""
            what = f"computes with {value!r:.40}, a {type(value).__name__}{shape}, expected a number or a signal"
            raise TypeError(f"{what}; for a number a car name the field in compile(parameters=...)") from None

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
            condition, yes, no = self.boolean(operands[0]), self.number(operands[1]), self.number(operands[2])
            fixed = self.value(condition)
            if yes == no or (fixed is not None and fixed != 0.0):
                return yes
            return no if fixed is not None else self._put((op, condition, yes, no))
        if op in _LOGIC or op == "not":
            return self._logic(op, [self.boolean(i) for i in operands])
        numbers = [self.number(i) for i in operands]
        values = [self.value(i) for i in numbers]
        if None not in values:
            with contextlib.suppress(ArithmeticError, ValueError):  # 1/0 and the like: left to the run
                return self.const(_FOLD[op](*values))
        if (op == "mul" and values[0] == 1.0) or (op == "neg" and self.nodes[numbers[0]][0] == "neg"):
            return numbers[1] if op == "mul" else self.nodes[numbers[0]][1]
        if op in ("mul", "div") and values[1] == 1.0:
            return numbers[0]
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


class Symbol:
    """A number that is not known yet: what equations are run on, so that what they compute is kept as a graph."""

    __slots__ = ("graph", "node")
    __array_ufunc__ = None  # NumPy's numbers leave arithmetic with it to it
    functions: SimpleNamespace
    """What `steerkit.diagram.maths` computes with, by CasADi's names."""

    def __init__(self, graph: Graph, node: int):
        self.graph, self.node = graph, node

    def __repr__(self) -> str:
        return "<signal>"

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function.__name__ in ("ndim", "shape"):
            return 0 if function.__name__ == "ndim" else ()
        return self._refuse(f"gives a signal to np.{function.__name__}", FUNCTIONS_OF_MATHS)

    def __pow__(self, exponent: Any) -> Any:
        if exponent != 2:
            self._refuse(f"takes a signal to the power of {exponent!r}", "valid: 2; others by products, m.sqrt, m.exp")
        return _of("mul", self, self)

    def _refuse(self, what: str, cure: str) -> NoReturn:
        self.graph.refused.append(TypeError(f"{what}; {cure}"))
        raise self.graph.refused[-1]


FUNCTIONS_OF_MATHS = "take m.sin, m.atan, m.sqrt, m.clip, m.floor, m.wrap, ... (steerkit.diagram.maths as m)"
_CHOICES = (
    "write m.where(condition, a, b), m.both, m.either, m.minimum, m.maximum, m.clip (steerkit.diagram.maths as m)"
)
_REFUSED = {
    "asks if a signal is true (if, while, and, or, not, in, min, max, a < b < c)": ("bool", _CHOICES),
    "makes a plain number of a signal (math.*, float, int, round, %f)": (
        "float int complex trunc round floor ceil",
        FUNCTIONS_OF_MATHS,
    ),
    "takes a signal for an index or a count": ("index", "look it up in a steerkit.diagram.maths.Table, or m.where"),
    "takes a signal for a key of a dictionary or a set": ("hash", "m.where, or a steerkit.diagram.maths.Table"),
    "uses %, // or divmod": ("mod rmod floordiv rfloordiv divmod", "write m.floor(a / b), m.wrap(angle)"),
    "uses &, |, ^ or ~": ("and rand or ror xor rxor invert", _CHOICES),
    "prints or formats a signal, which has no number yet": ("str format", "make it an output and look at the log"),
}
for _what, (_names, _cure) in _REFUSED.items():
    for _name in _names.split():
        setattr(Symbol, f"__{_name}__", lambda self, *_, what=_what, cure=_cure: self._refuse(what, cure))


def _of(op: str, *operands: Any) -> Symbol:
    graph = _graph_of(operands)
    return Symbol(graph, graph.add(op, *map(graph.node, operands)))


def _graph_of(operands: Iterable[Any]) -> Graph:
    return next(operand.graph for operand in operands if type(operand) is Symbol)


def _row(table: Table, index: Symbol) -> list[Symbol]:
    graph = index.graph
    if table not in graph.tables:
        graph.tables.append(table)
    row = graph.tables.index(table), graph.number(index.node)
    return [Symbol(graph, graph.add("row", *row, column)) for column in range(table.rows.shape[1])]


def _call(routine: Routine, values: Sequence[Any]) -> list[Symbol]:
    graph = _graph_of(values)
    if graph.routines is None:
        raise routine.refusal()
    if routine not in graph.routines:
        graph.routines.append(routine)
    given = [graph.number(graph.node(value)) for value in values]
    called = graph.add("call", graph.routines.index(routine), routine.size, *given)
    return [Symbol(graph, graph.add("result", called, column)) for column in range(routine.size)]


for _name, _op in {"add": "add", "sub": "sub", "mul": "mul", "truediv": "div", **dict(zip(_COMPARE, _COMPARE))}.items():
    setattr(Symbol, f"__{_name}__", lambda a, b, op=_op: _of(op, a, b))
for _name, _op in {"radd": "add", "rsub": "sub", "rmul": "mul", "rtruediv": "div", "gt": "lt", "ge": "le"}.items():
    setattr(Symbol, f"__{_name}__", lambda a, b, op=_op: _of(op, b, a))
for _name in ("neg", "abs"):
    setattr(Symbol, f"__{_name}__", lambda a, op=_name: _of(op, a))
_NAMES = {"fabs": "abs", "if_else": "select", "logic_and": "and", "logic_or": "or", **dict(zip(FUNCTIONS, FUNCTIONS))}
Symbol.functions = SimpleNamespace(
    row=_row, call=_call, **{name: functools.partial(_of, op) for name, op in _NAMES.items()}
)
