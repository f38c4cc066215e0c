"""Errors in a user's block, stated in terms of blocks and ports; used by everything that runs blocks."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from steerkit._support.errors import WiringError, require
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block

_METHODS = ("init", "settle", "output", "update")


class Place(NamedTuple):
    """Where in a block an exception came up."""

    block: Block
    text: str
    """`controller.output (Mine)`."""
    line: str
    """`line 12 of my_file.py`: the innermost line of the file that defines the block."""
    method: str
    called: bool
    """Did the method itself raise, and not something that it called?"""


def place_of(error: BaseException, blocks: Mapping[str, Block]) -> Place | None:
    """The block of a loop, and its method, in which an exception came up; None if it was in none of them."""
    found: Place | None = None
    named = {id(block): name for name, block in blocks.items()}
    at: TracebackType | None = error.__traceback__
    outer = ""
    home = ""
    while at is not None:
        code, owner = at.tb_frame.f_code, at.tb_frame.f_locals.get("self")
        if isinstance(owner, Block) and code.co_name in _METHODS:
            outer = outer or named.get(id(owner), "")
            if outer:
                home, kind = code.co_filename, type(owner).__name__
                found = Place(owner, f"{outer}.{code.co_name} ({kind})", "", code.co_name, called=True)
        elif found is not None:
            found = found._replace(called=False)
        if found is not None and code.co_filename == home:
            found = found._replace(line=f"line {at.tb_lineno} of {FilePath(home).name}")
        at = at.tb_next
    return found


def explained(error: Exception, blocks: Mapping[str, Block]) -> WiringError | None:
    """The error of a block's code as one that says what a block does instead; None if it is none of the usual ones,
    which is then given a note that says where it came up.

    `if` of a batch's signal, functions of `math` on arrays, a set attribute, a missing input, wrong names for `self.Y`.
    """
    if isinstance(error, WiringError) or (place := place_of(error, blocks)) is None:
        return None
    if what := mistake(error, place):
        return WiringError(f"{place.text}, {place.line}: {what}")
    error.add_note(f"in {place.text}, {place.line}")
    return None


def mistake(error: Exception, place: Place) -> str:
    """What was done wrong, and what to do instead; "" for an error that is none of the usual ones."""
    text, block = str(error), place.block
    if isinstance(error, ValueError) and "truth value of an array" in text:
        return (
            "asks `if`, `and`, `or`, `not`, min or max of a signal, which is an array in a batch of cars; write "
            "m.where(condition, a, b), m.minimum, m.maximum of steerkit.diagram.maths"
        )
    if isinstance(error, TypeError) and "can be converted to Python scalars" in text:
        return "gives an array (a batch of cars) to `math` or to float(); take sin, sqrt, ... of steerkit.diagram.maths"
    if isinstance(error, dataclasses.FrozenInstanceError):
        return f"sets an attribute ({text}); a block keeps nothing: give it a state by `init`, changed by `update`"
    if "does not support item assignment" in text or "can't set attribute" in text:
        return f"changes a state or an input in place ({text}); return a new one: State(z + self.dt * u.e)"
    state = isinstance(error, IndexError) or "values to unpack" in text or "'tuple' object has no attribute" in text
    if state and place.called and type(block).init is Block.init and place.method in ("output", "update"):
        return "reads a state, but its `init` is missing; write one that returns the state at first, such as (0.0,)"
    if isinstance(error, AttributeError) and type(error.obj).__name__ in ("U", "D") and place.called:
        return _no_input(error, block, place.method)
    if isinstance(error, TypeError) and text.startswith("Y.__new__()"):
        return f"self.Y is not given the outputs that it has ({text[12:].strip()}); expected {_answer(block)}"
    return ""


def _no_input(error: AttributeError, block: Block, method: str) -> str:
    inputs = {port.name: port.direct for port in block.inputs}
    if error.name in inputs and method == "update":
        return ""
    if error.name in inputs:
        direct = ", ".join(name for name, sees in inputs.items() if sees)
        return (
            f"read '{error.name}', which is not one of its direct inputs ({direct or 'none'}); declare the port direct "
            "or move the use to update"
        )
    return f"read '{error.name}', which is not one of its inputs ({', '.join(inputs) or 'none'})"


def _answer(block: Block) -> str:
    return f"self.Y({', '.join(f'{name}=...' for name in block.Y._fields)})"


def check_outputs(name: str, block: Block, y: Any, shape: tuple[int, ...] | None = None) -> None:
    """Raise WiringError unless `y`, what the block of that name in a loop answered, is its outputs: as many numbers.

    shape: of a signal: () for one car, (N,) for a batch; None: either.
    """
    where = _Asked(name, block, "output")
    where.require_tuple(y, f"its outputs: return {_answer(block)}")
    if len(y) != len(block.outputs):
        raise where.wrong(f"{where} gave {len(y)} values, expected {len(block.outputs)}: return {_answer(block)}")
    for out, value in zip(block.outputs, y):
        size = getattr(block, out.name).size
        signal = f"{name}.{out.name} [{out.unit}]"
        if size is not None:
            entries = value if isinstance(value, tuple | list | np.ndarray) else ()
            if len(entries) != size:
                given = f"has {len(entries)} entries" if len(entries) else f"is {_shown(value)}"
                raise where.wrong(f"{signal} {given}, expected {size}")
        for number in (value,) if size is None else value:
            if not _is_number(number, shape):
                raise where.wrong(f"{signal} is {_shown(number)}, {_kind(number)}, expected {_expected(shape)}")


def check_state(
    name: str,
    block: Block,
    x: Any,
    method: str,
    shape: tuple[int, ...] | None = None,
    like: Sequence[Any] | None = None,
) -> None:
    """Raise WiringError unless `x`, given by a method of the block of that name in a loop, is a state: a flat tuple.

    shape: as for `check_outputs`. like: the state before, of as many numbers.
    """
    where = _Asked(name, block, method)
    where.require_tuple(x, "a tuple of numbers, such as (z,), or () for no state")
    if like is not None and len(x) != len(like):
        raise where.wrong(f"{where} gave {len(x)} numbers, expected {len(like)}, as the state before has")
    for number in x:
        if not _is_number(number, shape):
            what = f"{_shown(number)}, {_kind(number)}, in its state"
            raise where.wrong(f"{where} gave {what}, expected {_expected(shape)} in each place")


class _Asked(NamedTuple):
    """A method of a block of a loop, which answered."""

    name: str
    block: Block
    method: str

    def __str__(self) -> str:
        return f"{self.name}.{self.method} ({type(self.block).__name__})"

    def wrong(self, what: str) -> WiringError:
        """The error, with the line where the method begins."""
        code = getattr(type(self.block), self.method).__code__
        return WiringError(f"{what} ({self.method}: line {code.co_firstlineno} of {FilePath(code.co_filename).name})")

    def require_tuple(self, values: Any, expected: str) -> None:
        if not isinstance(values, tuple | list):
            given = "nothing (is a `return` missing?)" if values is None else f"{_shown(values)}, {_kind(values)}"
            raise self.wrong(f"{self} gave {given}, expected {expected}")


def require_block(block: Any, where: str, role: str, example: str) -> None:
    """Raise ValueError unless a part of a loop is a block; `example` is one that would do."""
    if isinstance(block, type) and issubclass(block, Block):
        what = f"{role} is the class {block.__name__}, expected an object of it: {block.__name__}(...)"
        raise ValueError(f"{where}: {what}")
    require(isinstance(block, Block), where, f"{role} = {_shown(block)}, {_kind(block)}, expected a Block: {example}")


def _is_number(value: Any, shape: tuple[int, ...] | None) -> bool:
    if isinstance(value, float | int) or m.is_symbol(value):
        return True
    if not isinstance(value, np.ndarray | np.generic) or value.dtype.kind not in "fiub":
        return False
    return value.ndim <= 1 if shape is None else value.shape in ((), (1,), shape)


def _expected(shape: tuple[int, ...] | None) -> str:
    return f"a number, or an array of {shape[0]} for {shape[0]} cars" if shape else "a number"


def _shown(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


def _kind(value: Any) -> str:
    kind = type(value).__name__
    return f"an {kind}" if kind[0] in "aeiou" else f"a {kind}"
