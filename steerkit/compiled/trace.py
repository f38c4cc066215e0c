"""From a loop to graphs: every tick is run once on symbols, and what it computed is kept."""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from steerkit.compiled.graph import FUNCTIONS_OF_MATHS, Graph, Symbol
from steerkit.diagram.block import Wrapper
from steerkit.diagram.diagnostics import check_outputs, mistake, place_of
from steerkit.diagram.loop import Layout, Loop, LoopState
from steerkit.diagram.maths import Routine, Table


class TraceError(TypeError):
    """A loop that cannot be compiled; the message names the block and says what to do."""


@dataclasses.dataclass(frozen=True)
class Tick:
    """One tick: `roots[slot]` is the node of each slot's new value; inputs are the tick, the slots, the parameters."""

    graph: Graph
    roots: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Trace:
    """A loop as one graph a phase; phase = tick modulo the period."""

    loop: Loop
    layout: Layout
    parameters: tuple[str, ...]
    ticks: tuple[Tick, ...]
    tables: tuple[Table, ...]
    routines: tuple[Routine, ...] = ()

    @functools.cached_property
    def kinds(self) -> list[tuple[Tick, list[int]]]:
        """The ticks that differ, each with its phases: the same blocks are due in all of them."""
        phases: dict[int, list[int]] = {}
        for phase, tick in enumerate(self.ticks):
            phases.setdefault(id(tick), []).append(phase)
        return [(self.ticks[own[0]], own) for own in phases.values()]

    @functools.cached_property
    def read(self) -> set[int]:
        """The inputs that any tick reads: 0 is the tick, then come the slots, then the parameters."""
        nodes = [tick.graph.nodes[i] for tick, _ in self.kinds for i in tick.graph.order(tick.roots)]
        return {operands[0] for op, *operands in nodes if op == "in"}

    @functools.cached_property
    def persistent(self) -> list[int]:
        """The slots whose old values any tick reads, so that they go from tick to tick."""
        return sorted(slot - 1 for slot in self.read if 0 < slot <= len(self.layout))

    @property
    def unread(self) -> list[str]:
        """The parameters that no tick reads: they can only change the start."""
        return [name for i, name in enumerate(self.parameters, 1 + len(self.layout)) if i not in self.read]

    def require_timeless(self, where: str) -> None:
        """Raise ValueError if a block depends on the time t, which cars that start anew one by one do not share."""
        if 0 in self.read:
            what = "depends on the time t, which cars that start anew one by one do not share; valid: backend python"
            raise ValueError(f"{where}: a block of {self.loop!r} {what}")


def trace(loop: Loop, *, parameters: Sequence[str] = (), routines: bool = False) -> Trace:
    """The graphs of a loop. parameters: block fields (`"controller.k"`) to leave open, as inputs. routines: may blocks
    call a `Routine`?

    Raises TraceError naming the block that is not pure or cannot be run on symbols.
    """
    for name, block in loop.blocks.items():
        if not block.pure:
            cure = f"compile the loop with a model in its place (loop.with_block('{name}', model))"
            what = f"{name} ({type(block).__name__}) is not pure, so it cannot be compiled"
            raise TraceError(f"{what}; {cure}, or run this one with simulate")
    layout = Layout(loop, start_of(loop).x)
    graph = Graph(routines=routines)
    k, *slots = [graph.input(slot) for slot in range(1 + len(layout))]
    numbers = {name: graph.input(1 + len(layout) + i) for i, name in enumerate(parameters)}
    open_loop = with_parameters(loop, numbers)
    graph.refused.clear()  # by the checks of the parameters
    made: dict[tuple[bool, ...], Tick] = {}
    for phase in range(loop.period):
        if (due := loop.due(phase)) not in made:
            made[due] = _tick(open_loop, phase, layout, k, slots)
    ticks = tuple(made[loop.due(phase)] for phase in range(loop.period))
    return Trace(loop, layout, tuple(numbers), ticks, tuple(graph.tables), tuple(graph.routines or ()))


def start_of(loop: Loop) -> LoopState:
    """A state of the loop, of as many cars as its blocks hold arrays for. Raises TraceError naming the failing one."""
    try:
        return loop.init()
    except (TypeError, LookupError, AttributeError, ArithmeticError, NameError) as error:
        raise _blamed(loop, error) from error
    except ValueError:
        values = [getattr(b, f.name) for b in loop.blocks.values() for f in dataclasses.fields(b)]
        cars = {len(value) for value in values if isinstance(value, np.ndarray) and value.ndim == 1}
        if len(cars) != 1:
            raise
        return loop.init(batch=cars.pop())


def _tick(loop: Loop, phase: int, layout: Layout, k: Any, slots: list[Symbol]) -> Tick:
    x, y = layout.unpack(slots)
    before = tuple(x)
    try:
        loop.run_phase(phase, k * loop.dt, x, y)
        if k.graph.refused:  # a block may have caught it, and gone on without a number
            raise k.graph.refused[0]
    except Exception as error:
        raise _blamed(loop, error) from error
    loop.check(before, x)
    for (name, block), values in zip(loop.blocks.items(), y):
        check_outputs(name, block, values)
    roots = [_root(k.graph, name, value) for name, value in zip(layout.names, layout.pack(x, y))]
    return Tick(k.graph, tuple(roots))


def traced(what: str, function: Callable[[Callable[[], Any]], Sequence[Any]], tables: list[Table]) -> Tick:
    """The graph of a function that is no loop: its values are the roots, and its inputs what `new()` gave it.

    function: is called once with `new`, which makes the next input, and gives its values. tables: those that it looks
    into are added. Raises TraceError, beginning with `what`, if it cannot be run on symbols.
    """
    graph, slots = Graph(tables, routines=False), itertools.count()
    try:
        roots = [_root(graph, what, value) for value in function(lambda: graph.input(next(slots)))]
        if graph.refused:
            raise graph.refused[0]
    except Exception as error:
        raise TraceError(f"{what} cannot be run on symbols: {type(error).__name__}: {error}") from error
    return Tick(graph, tuple(roots))


def _root(graph: Graph, name: str, value: Any) -> int:
    try:
        return graph.number(graph.node(value))
    except (TypeError, ValueError) as error:
        what = f"{value!r} when computed on symbols, expected one number; see steerkit.diagram.maths"
        raise TraceError(f"{name} is {what}") from error


def _blamed(loop: Loop, error: Exception) -> TraceError:
    """What is said of the block in which a traced tick, or its start, failed."""
    place = place_of(error, loop.blocks)
    what = place and mistake(error, place)
    if not what:
        what = " ".join(str(error).split())[:300].replace("'Symbol'", "a signal")
        what = what if isinstance(error, TypeError) else f"{type(error).__name__}: {what}"
        if "ufuncs" in what:
            what = f"gives a signal to a function of NumPy or SciPy; {FUNCTIONS_OF_MATHS}"
        if ";" not in what:
            what = f"{what}; write it with steerkit.diagram.maths and arithmetic, or run the loop with simulate"
    where = f"{place.text} cannot be run on symbols, {place.line}" if place else "a block cannot be run on symbols"
    return TraceError(f"{where}: {what}")


def with_parameters(loop: Loop, values: dict[str, Any]) -> Loop:
    """The loop with block fields replaced by numbers, `(N,)` arrays or symbols: `{"controller.k": 2.0}`.

    Names may go into nested dataclasses: `"car.vehicle.m"`. Raises TraceError for an unknown field, or one that its
    block has already worked into other numbers when it was built; what the block raises for a number out of range.
    """
    changed = dict[str, dict[str, Any]]()
    for name, value in values.items():
        block, _, field = name.partition(".")
        if block not in loop.blocks or not field:
            raise TraceError(f"parameter '{name}': expected 'block.field'; blocks: {', '.join(loop.names)}")
        changed.setdefault(block, {})[field] = value
    for block, fields in changed.items():
        loop = loop.with_block(block, replaced(loop.blocks[block], fields, block))
    return loop


def parameter(loop: Loop, name: str) -> Any:
    """The present value of a block field, by name; raises TraceError for an unknown one."""
    block, *fields = name.split(".")
    try:
        return functools.reduce(getattr, fields, loop.blocks[block])
    except (AttributeError, KeyError):
        with_parameters(loop, {name: 0.0})  # which says what is wrong with the name
        raise


def replaced(owner: Any, values: Mapping[str, Any], name: str) -> Any:
    """`owner`, a block or what is in one, called `name` in errors, with other values in fields, such as `vehicle.m`.

    All at once, as fields may bound each other.
    """
    known = [f.name for f in dataclasses.fields(owner)] if dataclasses.is_dataclass(owner) else []
    new, inside = dict[str, Any](), dict[str, dict[str, Any]]()
    for path, value in values.items():
        field, _, inner = path.partition(".")
        if field not in known:
            fields = f"{type(owner).__name__} has no field '{field}'; fields: {', '.join(known) or 'none'}"
            raise TraceError(f"parameter '{name}.{path}': {fields}")
        if inner:
            inside.setdefault(field, {})[inner] = value
        else:
            new[field] = value
    new |= {field: replaced(getattr(owner, field), those, f"{name}.{field}") for field, those in inside.items()}
    try:
        return dataclasses.replace(owner, **new)
    except Exception:  # its checks cannot judge a symbol or an array: copy the fields as they are
        if all(isinstance(value, float) for value in values.values()):
            raise
        owner = dataclasses.replace(owner, **{field: value for field, value in new.items() if isinstance(value, float)})
        members = [item for base in type(owner).__mro__ for item in vars(base).items()]
        cached = {n for n, v in members if isinstance(v, functools.cached_property)}
        made = {f.name for f in dataclasses.fields(owner) if not f.init} | vars(owner).keys() - {*known, *cached}
        if isinstance(owner, Wrapper):  # the ports of the block inside, which no number decides
            made -= {"D", "U", "Y", "inputs", "outputs", "pure", *(p.name for p in (*owner.inputs, *owner.outputs))}
        if made:
            first = next(path for path, value in values.items() if not isinstance(value, float))
            what = f"{type(owner).__name__} computes {', '.join(sorted(made))} when it is built and refuses a symbol"
            cure = "make these properties, or choose another parameter"
            raise TraceError(f"parameter '{name}.{first}': {what}; {cure}") from None
        copy = object.__new__(type(owner))
        vars(copy).update({n: v for n, v in vars(owner).items() if n not in cached} | new)
        return copy
