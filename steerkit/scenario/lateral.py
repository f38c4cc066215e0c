"""Drives after a target of lateral acceleration instead of a course, judged as comma's controls challenge judges."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from steerkit._support.errors import known, number, require, require_within
from steerkit._support.files import read_text
from steerkit._support.plugins import is_outside
from steerkit.controllers.lateral import DT, PREVIEW, STEER, ChallengeController, LateralMpc
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Table
from steerkit.diagram.simulation import Log, simulate
from steerkit.metrics import lateral_cost
from steerkit.paths.waypoints import read_columns
from steerkit.scenario import Scenario
from steerkit.vehicles import VW_PASSAT, Vehicle

_BOUNDS = {"a_y": ("m/s^2", 20.0), "v": ("m/s", 100.0), "a_roll": ("m/s^2", 10.0)}


@dataclass(frozen=True, eq=False, kw_only=True)
class LateralTarget(Block):
    """A target of lateral acceleration over time, at a given speed and roll; and what a command means for a car.

        a_y = answer + a_roll,   delta_sw = steer_ratio atan(C(v) sat(a_y_cmd)),  C(v) = (L + K v^2)/v^2

    answer [m/s^2]: of the car on a level road; a_roll [m/s^2]: what the bank of the road adds; a_y_cmd [m/s^2] is cut
    at +-2. Outputs, all but the last two of state only: a_y_target, a_roll [m/s^2], v [m/s], a_x [m/s^2], each with its
    next `preview_points` samples in preview, preview_roll [m/s^2], preview_v [m/s], preview_a_x [m/s^2], where the
    last sample stays; a_y [m/s^2]; delta_sw [rad]. State: the sample's number. NaN gives NaN.
    """

    answer = In("m/s^2")
    a_y_cmd = In("m/s^2")
    a_y_target = Out("m/s^2", direct=())
    a_roll = Out("m/s^2", direct=())
    v = Out("m/s", direct=())
    a_x = Out("m/s^2", direct=())
    preview = Out("m/s^2", direct=(), size="preview_points")
    preview_roll = Out("m/s^2", direct=(), size="preview_points")
    preview_v = Out("m/s", direct=(), size="preview_points")
    preview_a_x = Out("m/s^2", direct=(), size="preview_points")
    a_y = Out("m/s^2", direct=(answer,))
    delta_sw = Out("rad", direct=(a_y_cmd,))

    table: Table
    """A row a sample: a_y, a_roll [m/s^2], v [m/s], a_x [m/s^2]."""
    vehicle: Vehicle = VW_PASSAT
    """The car of the data sheet by which commands are meant."""
    preview_points: int = number(PREVIEW, "1", low=1, high=1000)
    dt: float = number(DT, "s", above=0.0, high=1.0)

    @classmethod
    def of(
        cls, a_y: ArrayLike, v: ArrayLike, a_roll: ArrayLike = 0.0, *, where: str = "LateralTarget"
    ) -> "LateralTarget":
        """The target of these samples, 0.1 s apart, (n,) or one number for all; a_x is the change of v.

        Raises ValueError for fewer than 2 samples, for a NaN, or for what no car drives.
        """
        columns = dict(zip(_BOUNDS, np.atleast_1d(*np.broadcast_arrays(a_y, v, a_roll))))
        require(columns["a_y"].ndim == 1 and len(columns["a_y"]) > 1, where, "expected 2 or more samples, 0.1 s apart")
        for name, values in columns.items():
            unit, most = _BOUNDS[name]
            least = 1.0 if name == "v" else -most
            first = int(np.argmax(~((least <= values) & (values <= most))))  # that does not fit, if any
            require_within(f"{where}, at {first * DT:.1f} s", name, float(values[first]), unit, least, most)
        a_x = np.gradient(columns["v"], DT)
        return cls(table=Table(np.column_stack((columns["a_y"], columns["a_roll"], columns["v"], a_x))))

    @classmethod
    def drawn(cls, seed: int, *, seconds: float = 60.0) -> "LateralTarget":
        """A target by seed: bends of 0.5 to 1.8 m/s^2 and slower ones than 0.25 Hz, 9 to 29 m/s, a banked road."""
        rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, DT)

        def wave(fastest: float) -> Any:
            f = rng.uniform(0.02, fastest, 8)
            sines = np.sin(2.0 * np.pi * (f[:, None] * t + rng.random((8, 1)))) / np.sqrt(f[:, None])
            return sines.sum(axis=0) / np.abs(sines.sum(axis=0)).max()

        slow = rng.uniform(11.0, 27.0)
        a_y = rng.uniform(0.5, 1.8) * wave(0.25) * np.clip(t / 3.0, 0.0, 1.0)  # from straight ahead
        return cls.of(a_y, slow + 2.0 * wave(0.03), 0.3 * wave(0.05) * np.clip(t / 3.0, 0.0, 1.0))

    @classmethod
    def lap(cls, scenario: Scenario) -> "LateralTarget":
        """The lateral acceleration of a scenario's course, at its driver's speeds along it."""
        path = scenario.path()
        s, v = scenario.driver.profile(scenario.course, path)
        t = np.concatenate(([0.0], np.cumsum(2.0 * np.diff(s) / np.maximum(v[1:] + v[:-1], 1.0))))
        even = np.arange(0.0, t[-1], DT)
        v = np.maximum(np.interp(even, t, v), 1.0)
        return cls.of([path.kappa(place) for place in np.interp(even, t, s).tolist()] * v * v, v)

    @classmethod
    def read(cls, name: str, scenario: Scenario | None = None) -> "LateralTarget":
        """The target of that name: `drawn-7`, by a seed; `lap`, the scenario's; or a CSV file.

        Its columns: a_y [m/s^2] and v [m/s], and, if there, a_roll [m/s^2] and t [s], without which samples are 0.1 s
        apart. Raises ValueError naming the file, and what is valid.
        """
        kind, _, seed = name.partition("-")
        if kind == "drawn" and seed.isdecimal():
            return cls.drawn(int(seed))
        if name == "lap":
            return cls.lap(scenario or Scenario())
        where = f"target {name}"
        require(name.endswith(".csv"), where, "is not known; valid: drawn-7 (a seed), lap, FILE.csv")
        columns = read_columns(read_text(name, "target"), where)
        missing = {"a_y", "v"} - columns.keys()
        lacks = f"no column {', '.join(sorted(missing))}; expected a_y, v, and if need be a_roll, t"
        require(not missing, where, lacks)
        n = len(columns["a_y"])
        t = columns.get("t", DT * np.arange(n))
        require((np.diff(t) > 0.0).all(), where, "t [s] does not rise from row to row")
        widest = int(np.argmax(np.diff(t))) if n > 1 else 0
        gap = f"no row for {np.max(np.diff(t), initial=0.0):.6g} s from t = {t[widest]:.6g} s on, expected one in 10 s"
        require((np.diff(t) <= 10.0).all(), where, gap)
        even = np.arange(t[0], t[-1] + 1e-9, DT)
        a_y, v, a_roll = (np.interp(even, t, columns.get(key, np.zeros(n))) for key in _BOUNDS)
        return cls.of(a_y, v, a_roll, where=where)

    @property
    def seconds(self) -> float:
        """How long it lasts [s]."""
        return len(self.table) * self.dt

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        last = len(self.table) - 1.0
        now, *ahead = (self.table(m.minimum(x[0] + i, last)) for i in map(float, range(self.preview_points + 1)))
        car, v = self.vehicle, now[2]
        i = car.steer_ratio
        angle = i * m.atan(car.wheel_per_a_y(v) / i * m.clip(u.a_y_cmd, -STEER, STEER))
        return self.Y(*now, *map(tuple, zip(*ahead)), u.answer + now[1], angle)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (x[0] + 1.0,)


def lateral_loop(scenario: Scenario, target: LateralTarget, controller: Block, *, seed: int = 0) -> Loop:
    """The loop of such a drive: target, controller, and the scenario's steering and car; seed: of car and steering.

    Of the scenario, course, driver and sensors are left out. A controller's inputs are joined by name with the
    target's outputs; its output is a_y_cmd [m/s^2]. Raises AttributeError, naming both, where one has no such port.
    """
    v = float(target.table.rows[0, 2])
    scenario = scenario.with_(driver={"v_min": v, "v_max": max(v, scenario.driver.v_max)})
    parts = scenario.blocks(scenario.path(), seed=seed)
    chain = {name: parts[name] for name in ("link", "actuator", "column", "car")}
    target = replace(target, vehicle=scenario.nominal)
    blocks: dict[str, Any] = {"target": target, "controller": controller}
    blocks |= {name: block for name, block in chain.items() if block is not None}
    car: Any = blocks["car"]
    law: Any = controller
    wires: list[Any] = [(target.v, car.v_cmd), (car.a_y, target.answer), (law.a_y_cmd, target.a_y_cmd)]
    wires += [(getattr(target, port.name), getattr(law, port.name)) for port in law.inputs]
    source = target
    for name in [name for name in chain if name in blocks]:
        part: Any = blocks[name]
        into = next(port.name for port in part.inputs if port.name in ("delta_sw_cmd", "delta_sw_in"))
        wires.append((source.delta_sw, getattr(part, into)))
        if "v" in [port.name for port in part.inputs]:
            wires.append((car.v, part.v))
        source = part
    return Loop(blocks=blocks, wires=wires)


def lateral_drive(scenario: Scenario, target: LateralTarget, controller: Block, *, seed: int = 0) -> Log:
    """Drive the target from its first sample to its last, and return the log, 10 samples a second."""
    loop = lateral_loop(scenario, target, controller, seed=seed)
    return simulate(loop, target.seconds, every=round(target.dt / loop.dt))


def lateral_cost_of(log: Log) -> dict[str, float]:
    """The `lateral_cost` of such a drive."""
    return lateral_cost(log.t, log["target.a_y"], log["target.a_y_target"])


MOVES = {"lqr": 1, "mpc": 10}
"""The controllers of lateral acceleration, and how many moves of a `LateralMpc` they are."""


def lateral_controller(name: str, scenario: Scenario) -> Block:
    """`lqr` or `mpc` for the dead time and lag that the scenario tells, or the `my_file.py:Controller` of anyone.

    The latter is a file for comma's controls challenge: see `ChallengeController`. Raises ValueError for others.
    """
    if is_outside(name):
        return ChallengeController.load(name)
    moves = MOVES[known(name, MOVES, "controller of lateral acceleration", also="my_file.py:Controller")]
    told = scenario.design_model()
    return LateralMpc(response=LateralMpc.told(told.delay + 0.5 * told.hold, told.lag), moves=moves)
