"""A car for other programs: a CommonRoad parameter set, a row of opendbc, an MPC for comma's controls challenge."""

from collections.abc import Callable
from typing import Any

from steerkit._support.errors import known, require
from steerkit._support.version import version
from steerkit.compiled.graph import FUNCTIONS
from steerkit.compiled.python_code import statements
from steerkit.compiled.trace import traced
from steerkit.controllers.lateral import PREVIEW, ChallengeController
from steerkit.diagram.block import Block, state_like
from steerkit.diagram.maths import Table
from steerkit.export.c import from_template
from steerkit.vehicles import G, Vehicle


def commonroad(car: Vehicle) -> str:
    """The parameter set of CommonRoad's vehicle models (YAML), its single track and kinematic ones.

    C = c_f L/(mu m g l_r) at the front and c_r L/(mu m g l_f) at the rear; CommonRoad has one C for both axles,
    -p_ky1/p_dy1, so their mean stands there, and a comment says both. What no vehicle file knows, such as length and
    width, is left out: take it from a set of CommonRoad's. Raises ValueError for a batch of cars.
    """
    m, l_f, l_r, c_f, c_r, mu, ratio = _one(car)
    front, rear = (c * (l_f + l_r) / (mu * m * G * share) for c, share in ((c_f, l_r), (c_r, l_f)))
    stop = float(car.delta_sw_max) / ratio
    rows = [
        f"# {car.name}, written by steerkit",
        f"# cornering stiffness coefficients [1/rad]: front {front:.6g}, rear {rear:.6g}; CommonRoad has their mean",
        f"a: {l_f!r}  # centre of gravity to front axle [m]",
        f"b: {l_r!r}  # to rear axle [m]",
        f"m: {m!r}  # [kg]",
        f"I_z: {float(car.i_z)!r}  # [kg m^2]",
        "steering:",
        f"  min: {-stop!r}  # road wheels [rad]",
        f"  max: {stop!r}",
        "tire:",
        f"  p_dy1: {mu!r}  # friction [1]",
        f"  p_ky1: {-mu * 0.5 * (front + rear)!r}  # -mu times the mean coefficient [1/rad]",
    ]
    return "\n".join([*rows, ""])


def opendbc(car: Vehicle, *, delay: float | None = None) -> dict[str, float | str]:
    """The car as opendbc's CarParams name it, to be written as JSON.

    delay: of the steering [s], lag included, as its `steerActuatorDelay` is meant; left out where it is not known.
    """
    m, l_f, l_r, c_f, c_r, _, ratio = _one(car)
    row: dict[str, float | str] = {
        "carFingerprint": car.name,
        "mass": m,
        "wheelbase": l_f + l_r,
        "centerToFront": l_f,
        "steerRatio": ratio,
        "rotationalInertia": float(car.i_z),
        "tireStiffnessFront": c_f,
        "tireStiffnessRear": c_r,
    }
    return row if delay is None else {**row, "steerActuatorDelay": delay}


def _one(car: Vehicle) -> tuple[float, ...]:
    numbers = (car.m, car.l_f, car.l_r, car.c_f, car.c_r, car.mu, car.steer_ratio)
    require(all(not getattr(x, "shape", ()) for x in numbers), "export", f"'{car.name}' is a batch of cars; take one")
    return tuple(float(x) for x in numbers)


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
