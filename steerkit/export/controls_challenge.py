"""A controller of lateral acceleration as the one Python file that comma's controls challenge takes."""

from collections.abc import Callable
from typing import Any

from steerkit._support.errors import known, require
from steerkit._support.version import version
from steerkit.compiled.graph import FUNCTIONS
from steerkit.compiled.python_code import statements
from steerkit.compiled.trace import traced
from steerkit.controllers.challenge import ChallengeController
from steerkit.controllers.lateral import PREVIEW
from steerkit.diagram.block import Block, state_like
from steerkit.diagram.maths import Table
from steerkit.export.c import from_template


def controls_challenge(block: Block) -> str:
    """The text of such a file: the same commands as the block's, to rounding; it needs nothing but Python.

    Raises ValueError for a block with an input that `ChallengeController` has not, without the output a_y_cmd [m/s^2],
    or that asks for the time; TraceError for one that is more than its equations.
    """
    where = f"controls_challenge: {type(block).__name__}"
    for port in block.inputs:
        known(port.name, ChallengeController.U._fields, f"{where}: input")
    known("a_y_cmd", block.Y._fields, f"{where}: output")
    start, tables = block.init(), list[Table]()
    sizes = {port.name: getattr(block, port.name).size for port in block.inputs}
    slots = len(start) + sum(size or 1 for size in sizes.values())

    def once(new: Callable[[], Any]) -> list[Any]:
        t, x = new(), state_like(start, [new() for _ in start])
        u = block.U(*[tuple(new() for _ in range(size)) if size else new() for size in sizes.values()])
        y = block.output(t, x, block.D(*[getattr(u, name) for name in block.D._fields]))
        return [y.a_y_cmd, *block.update(t, x, u, y)]

    tick = traced(where, once, tables)
    timely = ("in", 0) in [tick.graph.nodes[i] for i in tick.graph.order(tick.roots)]
    require(not timely, where, "depends on the time t, which the challenge does not tell")
    code, (answer, *after) = statements(tick.graph, tick.roots, slots, tables)
    return from_template(
        "controls_challenge.py.in",
        name=type(block).__name__,
        version=version(),
        functions="".join(f"{f} as {f}_, " for f in sorted(FUNCTIONS) if any(f"{f}_(" in line for line in code)),
        tables="".join(f"table{i} = {table._tuples!r}\n" for i, table in enumerate(tables)),
        preview=PREVIEW,
        start=tuple(map(float, start)),
        slots="".join(f"s{i}, " for i in range(slots)),
        inputs=", ".join(f"*{name}" if size else name for name, size in sizes.items()),
        code="\n        ".join(code),
        after=f"({''.join(f'{name}, ' for name in after)})",
        answer=answer,
    )
