"""The symbols that loops are traced with: CasADi's, and seven times as quick to compute with.

CasADi's operators look for the one that is meant among those of its three types, each time, which takes 12 us. A
`Symbol` is one number of the type SX and goes to SX's own at once, 1.7 us; the expressions are the same. The functions
below are called as CasADi's are, for `steerkit.diagram.maths`, which finds them as `Symbol.functions`. With
anything but symbols and plain numbers all of them leave it to CasADi.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np


class Symbol(casadi.SX):
    """One number, as an expression."""

    functions = sys.modules[__name__]
    made_of: tuple[Any, ...] = ()
    """Operation and operands, to be read without asking CasADi; nothing for a new symbol, or a number."""
    __hash__ = casadi.SX.__hash__


_QUICK = frozenset({Symbol, float, int, bool, np.float64})
CHOICE = "select"
"""In place of an operation of CasADi's, in `Symbol.made_of`: condition, yes and no follow."""
_unary, _binary = casadi.SX.unary, casadi.SX.binary


def symbol(name: str) -> Symbol:
    """A new symbol."""
    return _marked(casadi.SX.sym(name))


def constant(value: float) -> Symbol:
    """A number as an expression."""
    return _marked(casadi.SX(value))


def numbers(vector: Any) -> list[Symbol]:
    """The entries of a column of SX, each a symbol."""
    return [_marked(entry) for entry in casadi.vertsplit(vector)]


def _marked(expression: Any) -> Symbol:
    expression.__class__ = Symbol  # as SX, without a copy
    return expression


def _of(op: int, *operands: Any) -> Symbol:
    made: Any = _binary(op, *operands) if len(operands) == 2 else _unary(op, *operands)
    made.__class__ = Symbol
    made.made_of = (op, *operands)
    return made


def _operator(name: str, op: int, *, swapped: bool = False) -> Callable[[Symbol, Any], Any]:
    otherwise = getattr(casadi.SX, name)

    def operator(self: Symbol, other: Any) -> Any:
        if type(other) not in _QUICK:
            return otherwise(self, other)
        return _of(op, other, self) if swapped else _of(op, self, other)

    return operator


for _name, _op in (("add", casadi.OP_ADD), ("sub", casadi.OP_SUB), ("mul", casadi.OP_MUL), ("truediv", casadi.OP_DIV)):
    setattr(Symbol, f"__{_name}__", _operator(f"__{_name}__", _op))
    setattr(Symbol, f"__r{_name}__", _operator(f"__r{_name}__", _op, swapped=True))
for _name, _op in (("lt", casadi.OP_LT), ("le", casadi.OP_LE), ("eq", casadi.OP_EQ), ("ne", casadi.OP_NE)):
    setattr(Symbol, f"__{_name}__", _operator(f"__{_name}__", _op))
for _name, _op in (("gt", casadi.OP_LT), ("ge", casadi.OP_LE)):
    setattr(Symbol, f"__{_name}__", _operator(f"__{_name}__", _op, swapped=True))


def _function(op: int) -> Callable[[Symbol], Symbol]:
    def function(x: Symbol) -> Symbol:
        return _of(op, x)

    return function


def _of_two(op: int, otherwise: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def function(a: Any, b: Any) -> Any:
        return _of(op, a, b) if type(a) in _QUICK and type(b) in _QUICK else otherwise(a, b)

    return function


sin, cos, tan = _function(casadi.OP_SIN), _function(casadi.OP_COS), _function(casadi.OP_TAN)
asin, acos, logic_not = _function(casadi.OP_ASIN), _function(casadi.OP_ACOS), _function(casadi.OP_NOT)
atan, tanh, exp = _function(casadi.OP_ATAN), _function(casadi.OP_TANH), _function(casadi.OP_EXP)
log, sqrt, floor = _function(casadi.OP_LOG), _function(casadi.OP_SQRT), _function(casadi.OP_FLOOR)
fabs = _function(casadi.OP_FABS)
for _name, _op in (("abs", casadi.OP_FABS), ("neg", casadi.OP_NEG)):
    setattr(Symbol, f"__{_name}__", _function(_op))
atan2 = _of_two(casadi.OP_ATAN2, casadi.atan2)
logic_and = _of_two(casadi.OP_AND, casadi.logic_and)
logic_or = _of_two(casadi.OP_OR, casadi.logic_or)


def if_else(condition: Any, yes: Any, no: Any) -> Any:
    """As CasADi writes it, (condition ? yes : 0) + (not condition ? no : 0); read as what it is, a choice."""
    if type(condition) is not Symbol or type(yes) not in _QUICK or type(no) not in _QUICK:
        return casadi.if_else(condition, yes, no)
    first, otherwise = _binary(casadi.OP_IF_ELSE_ZERO, condition, yes), _unary(casadi.OP_NOT, condition)
    made = _marked(_binary(casadi.OP_ADD, first, _binary(casadi.OP_IF_ELSE_ZERO, otherwise, no)))
    made.made_of = (CHOICE, condition, yes, no)
    return made
