"""A closed loop of steerkit under other engines, for the study `throughput`: numba, Drake, jaxonomy (extra `peers`).

Each maker takes the loop and a state, and gives a function of the number of steps that returns the cross-track errors
after them. Numba and jaxonomy get the loop's equations as one straight-line function without wires (the best that they
can be given); Drake, which has a diagram of its own, gets a system for each block and runs the blocks' own functions.
"""

from __future__ import annotations

import functools
import importlib.util
import logging
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from steerkit.compiled.graph import FUNCTIONS, Graph
from steerkit.compiled.trace import Trace, trace
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop, LoopState

Run = Callable[[int], np.ndarray]
"""Steps to cross-track errors (steps,) [m]."""

SIGNAL = "path.e"
_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "eq": "==", "ne": "!="}
_LOGIC = {"and": "&", "or": "|"}


def numba_function(loop: Loop, start: LoopState) -> Run:
    """The loop's equations in one function, compiled by numba to machine code with a loop around it."""
    import numba  # type: ignore[import-untyped, import-not-found, unused-ignore]

    told, state = _equations(loop, start)
    names: dict[str, Any] = {name: getattr(math, name) for name in FUNCTIONS}
    tick = numba.njit(_made(told, names | {"select": numba.njit(lambda c, a, b: a if c else b), "whole": int}))

    @numba.njit  # type: ignore[untyped-decorator, unused-ignore]
    def run(steps: int, s: Any, tables: Any, errors: Any) -> None:
        for k in range(steps):
            s, errors[k] = tick(float(k), s, tables)

    tables = tuple(np.array(table.rows) for table in told.tables)

    def errors(steps: int) -> np.ndarray:
        found = np.empty(steps)
        run(steps, tuple(state), tables, found)
        return found

    return errors


def jaxonomy_function(loop: Loop, start: LoopState) -> Run:
    """The loop's equations as one discrete system of jaxonomy, which compiles its simulation with XLA."""
    import jax  # type: ignore[import-untyped, import-not-found, unused-ignore]
    import jaxonomy  # type: ignore[import-untyped, import-not-found, unused-ignore]
    from jax import numpy as jnp  # type: ignore[import-untyped, import-not-found, unused-ignore]

    jax.config.update("jax_enable_x64", True)
    logging.getLogger("jaxonomy").setLevel(logging.WARNING)
    told, state = _equations(loop, start)
    other = {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2"}
    names = {name: getattr(jnp, other.get(name, name)) for name in FUNCTIONS}
    tick = _made(told, names | {"select": jnp.where, "whole": lambda i: i.astype(int)})
    tables = tuple(jnp.array(table.rows) for table in told.tables)

    class Whole(jaxonomy.LeafSystem):  # type: ignore[misc, unused-ignore]
        def __init__(self) -> None:
            super().__init__(name="loop")
            self.declare_discrete_state(default_value=jnp.array([*state, 0.0]))
            self.declare_periodic_update(self.update, period=loop.dt, offset=0.0)
            self.declare_output_port(lambda t, x, *u, **p: x.discrete_state[-1], period=loop.dt, offset=0.0)

        def update(self, t: Any, x: Any, *u: Any, **p: Any) -> Any:
            after, e = tick(jnp.round(t / loop.dt), tuple(x.discrete_state[:-1]), tables)
            return jnp.stack([*after, e])

    system = Whole()
    context = system.create_context()

    def errors(steps: int) -> np.ndarray:
        options = jaxonomy.SimulatorOptions(
            math_backend="jax", max_major_steps=steps + 2, max_major_step_length=loop.dt, save_time_series=True
        )
        done = jaxonomy.simulate(
            system, context, (0.0, steps * loop.dt), options=options, recorded_signals={"e": system.output_ports[0]}
        )
        return np.asarray(done.outputs["e"])[1 : steps + 1]  # the first is from before any step

    return errors


def drake_diagram(loop: Loop, start: LoopState) -> Run:
    """A system of Drake for each block, written in Python, and a connection for each wire."""
    from pydrake.systems.analysis import Simulator  # type: ignore[import-untyped, import-not-found, unused-ignore]
    from pydrake.systems.framework import DiagramBuilder, LeafSystem  # type: ignore[import-untyped, import-not-found, unused-ignore]
    from pydrake.systems.primitives import VectorLogSink  # type: ignore[import-untyped, import-not-found, unused-ignore]

    class System(LeafSystem):  # type: ignore[misc, unused-ignore]
        def __init__(self, block: Block, x0: Any) -> None:
            super().__init__()
            self.block, self.like = block, x0
            self.ports = [self.DeclareVectorInputPort(port.name, 1) for port in block.inputs]
            if len(x0):
                self.DeclareDiscreteState(np.array(x0, dtype=float))
                self.DeclarePeriodicDiscreteUpdateEvent(loop.dt, 0.0, self.update)
            needs = {port.ticket() for port, spec in zip(self.ports, block.inputs) if spec.name in block.D._fields}
            needs.add(self.xd_ticket() if len(x0) else self.nothing_ticket())
            for i, spec in enumerate(block.outputs):
                if getattr(block, spec.name).size is None:
                    show = functools.partial(self.show, i)
                    self.DeclareVectorOutputPort(spec.name, 1, show, needs)

        def state(self, context: Any) -> Any:
            if not len(self.like):
                return self.like
            numbers = context.get_discrete_state_vector().value().tolist()
            return self.like._make(numbers) if hasattr(self.like, "_make") else tuple(numbers)

        def given(self, context: Any, names: Any) -> list[float]:
            return [float(p.Eval(context)[0]) for p, spec in zip(self.ports, self.block.inputs) if spec.name in names]

        def show(self, i: int, context: Any, out: Any) -> None:
            block = self.block
            u = block.D(*self.given(context, block.D._fields))
            out.SetAtIndex(0, block.output(context.get_time(), self.state(context), u)[i])

        def update(self, context: Any, after: Any) -> None:
            block, t, x = self.block, context.get_time(), self.state(context)
            u = block.U(*self.given(context, block.U._fields))
            y = block.output(t, x, block.D(*[getattr(u, name) for name in block.D._fields]))
            after.get_mutable_vector().SetFromVector(np.array(block.update(t, x, u, y), dtype=float))

    builder = DiagramBuilder()
    systems = {name: builder.AddNamedSystem(name, System(b, x)) for (name, b), x in zip(loop.blocks.items(), start.x)}
    for out, to in loop.wires:
        a, b = (loop.port_name(port).split(".") for port in (out, to))
        builder.Connect(systems[a[0]].GetOutputPort(a[1]), systems[b[0]].GetInputPort(b[1]))
    name, port = SIGNAL.split(".")
    log = builder.AddSystem(VectorLogSink(1, loop.dt))
    builder.Connect(systems[name].GetOutputPort(port), log.get_input_port())
    diagram = builder.Build()

    def errors(steps: int) -> np.ndarray:
        simulator = Simulator(diagram)
        simulator.AdvanceTo((steps - 1) * loop.dt)
        simulator.AdvancePendingEvents()
        return np.asarray(log.FindLog(simulator.get_context()).data()[0, :steps])

    return errors


ENGINES: dict[str, tuple[str, Callable[[Loop, LoopState], Run], int]] = {
    "numba, one function": ("numba", numba_function, 40000),
    "Drake, same diagram": ("pydrake", drake_diagram, 100),
    "jaxonomy, one function": ("jaxonomy", jaxonomy_function, 2000),
}
"""By name: the package, the maker, and how many steps take some ten milliseconds."""


def installed(package: str) -> bool:
    """Is it there? Asked without importing it."""
    return importlib.util.find_spec(package) is not None


def _equations(loop: Loop, start: LoopState) -> tuple[Trace, list[float]]:
    told = trace(loop)
    slots = told.layout.pack(start.x, start.y)
    return told, [float(slots[slot]) for slot in told.persistent]


def _made(told: Trace, names: dict[str, Any]) -> Callable[..., Any]:
    """tick(k, s, tables) -> (s after, error), in straight lines, with these functions."""
    (tick,) = told.ticks
    roots = [tick.roots[slot] for slot in (*told.persistent, *told.layout.slots_of(SIGNAL))]
    place = {slot + 1: f"s[{i}]" for i, slot in enumerate(told.persistent)} | {0: "k"}
    lines = [f"    v{i} = {_text(tick.graph, i, place)}" for i in tick.graph.order(roots)]
    after = "".join(f"v{i}, " for i in roots[:-1])
    scope = dict(names)
    exec("\n".join(["def tick(k, s, tables):", *lines, f"    return ({after}), v{roots[-1]}"]), scope)
    made: Callable[..., Any] = scope["tick"]
    return made


def _text(graph: Graph, i: int, place: dict[int, str]) -> str:
    op, *operands = graph.nodes[i]
    if op == "const":
        return repr(float.fromhex(operands[0]))
    if op == "in":
        return place[operands[0]]
    if op == "row":
        table, index, column = operands
        return f"tables[{table}][whole(v{index}), {column}]"
    parts = [f"v{j}" for j in operands]
    if op in _INFIX:
        return f"{parts[0]} {_INFIX[op]} {parts[1]}"
    if op in _LOGIC:
        return f"{parts[0]} {_LOGIC[op]} {parts[1]}"
    if op in ("neg", "not", "abs"):
        return {"neg": f"-{parts[0]}", "not": f"({parts[0]}) == False", "abs": f"abs({parts[0]})"}[op]
    return f"{op}({', '.join(parts)})"
