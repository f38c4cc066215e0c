"""A closed loop of steerkit as systems of python-control, wired three ways: what the study `throughput` compares with.

All three run the blocks' own functions on floats, so that only the machinery between them differs. Each maker returns a
system and its start state.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop, LoopState

Made = tuple[Any, list[float]]
"""A system of python-control, and its start state."""


def _state(x: Any, like: Any) -> Any:
    return like._make(x) if hasattr(like, "_make") else tuple(x)


def diagram(loop: Loop, start: LoopState) -> Made:
    """Every block a system of its own, every wire a connection."""
    import control

    systems = []
    for (name, block), x0 in zip(loop.blocks.items(), start.x):

        def values(x: Any, u: Any, block: Block = block, x0: Any = x0) -> tuple[Any, Any, Any]:
            state, all_in = _state(x.tolist(), x0), block.U(*u.tolist())
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


def two_systems(loop: Loop, start: LoopState) -> Made:
    """A plant (car, actuator, human) and a controller (tracker, Stanley), each written as one plain function."""
    import control

    car, motor, seen, stanley = (loop.blocks[n] for n in ("car", "actuator", "path", "controller"))
    x_car, x_motor, x_seen, x_stanley = (loop.block_state(start, n) for n in ("car", "actuator", "path", "controller"))
    n_car, n_seen = len(x_car), len(x_seen)
    speed = loop.blocks["driver"].speed  # type: ignore[attr-defined]
    signals = ["x", "y", "psi", "v", "beta", "r", "meas"]

    def move(t: float, x: Any, u: Any, params: Any) -> Any:
        numbers = x.tolist()
        wheel = motor.U(float(u[0]))
        moved = car.update(t, _state(numbers[:n_car], x_car), car.U(numbers[n_car], speed), None)
        return moved + motor.update(t, tuple(numbers[n_car:]), wheel, None)

    def show(t: float, x: Any, u: Any, params: Any) -> Any:
        numbers = x.tolist()
        return (*car.output(t, _state(numbers[:n_car], x_car), ())[:6], numbers[n_car])

    def looked(t: float, x: Any, u: Any) -> tuple[Any, ...]:
        numbers, given = x.tolist(), u.tolist()
        pose = seen.U(*given[:6])
        where, before = _state(numbers[:n_seen], x_seen), _state(numbers[n_seen:], x_stanley)
        y = seen.output(t, where, pose)
        errors = stanley.D(y.e, y.psi_e, y.kappa, given[3], given[5], given[6])
        return where, pose, y, before, errors, stanley.output(t, before, errors)

    def steer(t: float, x: Any, u: Any, params: Any) -> Any:
        _, _, y, _, _, command = looked(t, x, u)
        return command.delta_sw, y.e

    def remember(t: float, x: Any, u: Any, params: Any) -> Any:
        where, pose, y, before, errors, command = looked(t, x, u)
        return (*seen.update(t, where, pose, y), *stanley.update(t, before, errors, command))

    plant = control.nlsys(
        move, show, name="plant", inputs=["cmd"], outputs=signals, states=n_car + len(x_motor), dt=loop.dt
    )
    controller = control.nlsys(
        remember,
        steer,
        name="controller",
        inputs=signals,
        outputs=["cmd", "e"],
        states=n_seen + len(x_stanley),
        dt=loop.dt,
    )
    wires = [[f"controller.{n}", f"plant.{n}"] for n in signals] + [["plant.cmd", "controller.cmd"]]
    whole = control.interconnect(
        [plant, controller],
        connections=wires,
        inplist=[],
        inputs=None,
        outlist=["controller.e"],
        outputs=["e"],
        dt=loop.dt,
    )
    return whole, [*x_car, *x_motor, *x_seen, *x_stanley]


def one_function(loop: Loop, start: LoopState) -> Made:
    """The whole loop as one update function, steerkit's own interpreted tick: no diagram is left to python-control."""
    import control

    ends = np.cumsum([0, *[len(x) for x in start.x]]).tolist()
    east = ends[list(loop.blocks).index("car")]  # the first of the car's states

    def tick(t: float, x: Any) -> tuple[list[Any], list[Any]]:
        numbers, y = x.tolist(), list(start.y)
        states = [_state(numbers[a:b], like) for a, b, like in zip(ends, ends[1:], start.x)]
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
    import control

    system, x0 = made
    response = control.input_output_response(system, np.arange(steps) * system.dt, 0, x0)
    return np.asarray(response.outputs).ravel()
