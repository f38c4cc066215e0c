"""A closed loop of steerkit as systems of python-control, wired two ways: what the study `throughput` compares with.

Both run the blocks' own functions on floats, so that only the machinery between them differs. Each maker returns a
system and its start state.
"""

from typing import Any

import control
import numpy as np

from steerkit.diagram.block import Block, state_like
from steerkit.diagram.loop import Loop, LoopState

Made = tuple[Any, list[float]]
"""A system of python-control, and its start state."""


def diagram(loop: Loop, start: LoopState) -> Made:
    """Every block a system of its own, every wire a connection."""
    systems = []
    for (name, block), x0 in zip(loop.blocks.items(), start.x):

        def values(x: Any, u: Any, block: Block = block, x0: Any = x0) -> tuple[Any, Any, Any]:
            state, all_in = state_like(x0, x.tolist()), block.U(*u.tolist())
            return state, all_in, block.D(*[getattr(all_in, n) for n in block.D._fields])

        def output(t: float, x: Any, u: Any, params: Any, block: Block = block, values: Any = values) -> Any:
            state, _, direct = values(x, u)
            return [v for v in block.output(t, state, direct) if v.__class__ is float]

        def update(t: float, x: Any, u: Any, params: Any, block: Block = block, values: Any = values) -> Any:
            state, all_in, direct = values(x, u)
            return block.update(t, state, all_in, block.output(t, state, direct))

        ports = [p.name for p in block.outputs if getattr(block, p.name).size is None]
        systems.append(
            control.nlsys(
                update if len(x0) else None,
                output,
                name=name,
                dt=loop.dt,
                states=len(x0),
                inputs=[p.name for p in block.inputs],
                outputs=ports,
            )
        )
    whole = control.interconnect(
        systems,
        connections=[[loop.port_name(b), loop.port_name(a)] for a, b in loop.wires],
        inplist=[],
        inputs=None,
        outlist=["path.e"],
        outputs=["e"],
        dt=loop.dt,
    )
    return whole, [v for x in start.x for v in x]


def one_function(loop: Loop, start: LoopState) -> Made:
    """The whole loop as one update function, steerkit's own interpreted tick: no diagram is left to python-control."""
    ends = np.cumsum([0, *[len(x) for x in start.x]]).tolist()
    east = ends[list(loop.blocks).index("car")]  # the first of the car's states

    def tick(t: float, x: Any) -> tuple[list[Any], list[Any]]:
        numbers, y = x.tolist(), list(start.y)
        states = [state_like(like, numbers[a:b]) for a, b, like in zip(ends, ends[1:], start.x)]
        loop.run_phase(0, t, states, y)
        return states, y

    def update(t: float, x: Any, u: Any, params: Any) -> Any:
        return [v for state in tick(t, x)[0] for v in state]

    def output(t: float, x: Any, u: Any, params: Any) -> Any:
        return x[east : east + 1]

    whole = control.nlsys(update, output, inputs=0, outputs=["x"], states=ends[-1], dt=loop.dt)
    return whole, [v for x in start.x for v in x]


def run(made: Made, steps: int) -> np.ndarray:
    """Outputs of `control.input_output_response`, a fixed-step discrete-time run."""
    system, x0 = made
    response = control.input_output_response(system, np.arange(steps) * system.dt, 0, x0)
    return np.asarray(response.outputs).ravel()
