"""A manoeuvre in simulation: any plant, steering and controller of a scenario; and many cars at once, compiled."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit.compiled import TraceError, compile
from steerkit.controllers.delay import delayed_stanley
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Array, Table
from steerkit.diagram.simulation import Log, simulate
from steerkit.paths.courses import straight
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import Playback
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.proving.manoeuvre import Manoeuvre
from steerkit.proving.runs import Run
from steerkit.scenario import Scenario, straightest
from steerkit.scenario.assembly import steering_loop
from steerkit.scenario.catalogue import make_controller
from steerkit.vehicles import FleetCar

DT = 0.01
"""Sample time of an open-loop run [s]."""
_MARGIN = 5.0  # m: so far before the end of an open course a run ends
_straight = lru_cache(maxsize=8)(straight)  # runs of a manoeuvre have equal ones
_OPEN = ("m", "i_z", "l_f", "l_r", "c_f", "c_r", "steer_ratio")


def simulated(manoeuvre: Manoeuvre, scenario: Scenario, *, controller: str = "stanley", seed: int = 0) -> list[Run]:
    """The runs of a manoeuvre by a scenario's car and steering; its course and speeds are the manoeuvre's.

    Open loop: `controller` drives straight on until the input begins. A manoeuvre on a course it drives alone.
    A run is of what the car does, in samples of 0.01 s (the plant's own, if those are longer); the wheel's angle
    is the one held in the sample before, so that dead times read half a sample too short. Repeats have another
    seed each, and where nothing is drawn by lot they are the same. Raises ValueError for a car that does not take the
    speed, and what the scenario's parts do.
    """
    scenario = _at(scenario, manoeuvre.conditions.v)
    runs = []
    repeats = manoeuvre.repeats if scenario.random else 1
    for side in manoeuvre.sides:
        for number in range(1, repeats + 1):
            draw = 1000 * seed + number
            if manoeuvre.input is None:
                runs.append(_driven(manoeuvre, scenario, controller, side, number, draw))
            else:
                loop = open_loop(manoeuvre, scenario, side, draw, controller)
                runs.append(run_of(_log(loop, _seconds(manoeuvre)), manoeuvre, side, number, -_wait(manoeuvre)))
    return runs


def _log(loop: Loop, seconds: float) -> Log:
    """What `simulate` gives, bit for bit: of generated Python, in a third of the time, where all blocks allow that."""
    try:
        return compile(loop, backend="python").run(seconds, allow_nonfinite=True)
    except TraceError:
        return simulate(loop, seconds, allow_nonfinite=True)


def _wait(manoeuvre: Manoeuvre) -> float:
    return manoeuvre.conditions.settle + 1.0


def _seconds(manoeuvre: Manoeuvre, late: float = 0.0) -> float:
    return _wait(manoeuvre) + manoeuvre.seconds + late + DT


def open_loop(manoeuvre: Manoeuvre, scenario: Scenario, side: str, seed: int = 0, controller: str = "stanley") -> Loop:
    """The loop of a run: straight on, then the input, on a straight course that is long enough.

    `stanley` is one that knows the steering's delay, and it and the wave steer every 0.01 s; others at their own pace.
    """
    v, car = manoeuvre.conditions.v, scenario.nominal
    path = _straight(2.0 * v * _seconds(manoeuvre) + 200.0)
    blocks: dict[str, Any] = dict(scenario.blocks(path, 50.0, seed))
    blocks["sensors"] = blocks["estimator"] = None  # a test driver holds the wheel, who needs neither
    known = replace(scenario.design_model(), path=path)
    steering: Any = {name: getattr(known, name) for name in ("delay", "lag", "rate_limit", "slew", "a_y_limit")}
    base = make_controller(controller, known) if controller != "stanley" else delayed_stanley(car, dt=DT, **steering)
    steering = manoeuvre.open_loop(base, car, side, wait=_wait(manoeuvre))
    return steering_loop(path=path, controller=steering, reference=float(car.l_f), **blocks)


def on_course(manoeuvre: Manoeuvre, scenario: Scenario, controller: str, seed: int = 0) -> tuple[Loop, float]:
    """The loop of a run on the manoeuvre's course, and how far it goes [m]: of a closed one half a round."""
    v = manoeuvre.conditions.v
    path = manoeuvre.path()
    scenario = _at(scenario, v)
    law = make_controller(controller, replace(scenario.design_model(), path=path))
    blocks: dict[str, Any] = dict(scenario.blocks(path, straightest(path) if path.closed else 0.0, seed))
    loop = steering_loop(path=path, controller=law, reference=scenario.ahead, **blocks)
    return loop, 0.5 * path.length if path.closed else path.length - _MARGIN


def _at(scenario: Scenario, v: float) -> Scenario:
    """The scenario at that speed, on no course of its own."""
    driver = {"speed": "wander", "v_min": v, "v_max": v}
    return scenario.with_(course={"name": "straight", "start": 0.0}, driver=driver)


def _driven(manoeuvre: Manoeuvre, scenario: Scenario, controller: str, side: str, number: int, seed: int) -> Run:
    """A run on the manoeuvre's course."""
    loop, length = on_course(manoeuvre, scenario, controller, seed)
    seconds = 1.5 * length / manoeuvre.conditions.v
    log = simulate(loop, seconds, until=lambda sample: sample["path.progress"] >= length, allow_nonfinite=True)
    run = run_of(log, manoeuvre, side, number, 0.0)
    short = "" if log["path.progress"][-1] >= length else "the end of the course was not reached"
    return replace(run, invalid=short)


def run_of(log: Log, manoeuvre: Manoeuvre, side: str, number: int, start: float, car: int | None = None) -> Run:
    """A run from the log of a steering loop, which begins at `start` [s]; of a batch, that car's."""
    names = {key: f"car.{key}" for key in ("delta_sw", "v", "r", "a_y", "beta", "x", "y", "psi") if f"car.{key}" in log}
    names |= {"e": "path.e", "delta_sw_cmd": "controller.delta_sw"}
    if "column.delta_sw_meas" in log:
        names["delta_sw"] = "column.delta_sw_meas"
    signals = {key: log[name] if car is None else log[name][:, car] for key, name in names.items() if name in log}
    return Run(t=log.t + start, signals=signals, side=side, number=number)


def of_fleet(
    manoeuvre: Manoeuvre, cars: Sequence[FleetCar], *, lag: float = 0.12
) -> Iterator[tuple[FleetCar, list[Run]]]:
    """The runs of many production cars, in batches of a compiled program.

    Each has its own dead time and is steered by the angle that its data ask, or on a course by `stanley-delay`, which
    knows it; lag: of their steering [s]. The cars are linear single tracks, as of stiffness is all that is known of
    their tyres. A run to the left alone: to the right it is the same, mirrored.
    """
    if manoeuvre.input is None:
        yield from _on_course(manoeuvre, cars, lag)
        return
    wait, v = _wait(manoeuvre), manoeuvre.conditions.v
    sizes = np.array([manoeuvre.required.angle(car.vehicle, v) for car in cars])
    late = np.array([car.steer_delay for car in cars])
    wave = np.concatenate((np.zeros(round(wait / DT)), np.median(sizes) * manoeuvre.required.wave))
    play = Playback(angles=tuple(wave.tolist()), speeds=(v,) * len(wave), dt=DT)
    actuator = SteeringActuator(lag=lag, limit=30.0, rate_limit=200.0, dt=DT)
    car = LinearSingleTrack(vehicle=cars[0].vehicle, v0=v, dt=DT)
    loop = Loop(
        blocks={"controller": play, "actuator": actuator, "car": car},
        wires=[(play.delta_sw, actuator.delta_sw_cmd), (actuator.delta_sw, car.delta_sw_cmd), (play.v, car.v_cmd)],
    )
    values = {f"car.vehicle.{key}": np.array([float(getattr(each.vehicle, key)) for each in cars]) for key in _OPEN}
    values |= {"controller.delay": late, "actuator.gain": sizes / np.median(sizes)}
    record = [f"car.{key}" for key in ("delta_sw", "v", "r", "a_y", "beta", "x", "y", "psi")]
    program = compile(loop, record=record, parameters=list(values))
    log = program.run(_seconds(manoeuvre, float(late.max())), parameters=values, allow_nonfinite=True)
    for k, each in enumerate(cars):
        yield each, [run_of(log, manoeuvre, "left", 1, -wait, k)]


def _on_course(manoeuvre: Manoeuvre, cars: Sequence[FleetCar], lag: float) -> Iterator[tuple[FleetCar, list[Run]]]:
    """The runs of a manoeuvre on a course: cars of one dead time are a batch."""
    for delay in sorted({round(car.steer_delay, 2) for car in cars}):
        group = [car for car in cars if round(car.steer_delay, 2) == delay]
        steering = {"delay": delay, "lag": lag}
        scenarios = [
            Scenario(vehicle={"name": car.vehicle.name, "plant": "linear"}, steering=steering) for car in group
        ]
        loops, lengths = zip(*(on_course(manoeuvre, scenario, "stanley-delay") for scenario in scenarios))
        values = differing(loops)
        record = [*(f"car.{key}" for key in ("delta_sw", "v", "r", "a_y")), "path.e"]
        program = compile(loops[0], record=record, parameters=list(values))
        log = program.run(
            lengths[0] / manoeuvre.conditions.v, parameters=values, batch=len(group), allow_nonfinite=True
        )
        yield from ((car, [run_of(log, manoeuvre, "left", 1, 0.0, k)]) for k, car in enumerate(group))


def differing(loops: Sequence[Loop]) -> dict[str, Array]:
    """The block fields in which loops of one structure differ, each with its value a loop (N,).

    Raises ValueError for loops that differ in what is no number, such as a table of gains.
    """
    each = [{f"{name}.{k}": v for name, block in loop.blocks.items() for k, v in _numbers(block)} for loop in loops]
    named = [key for key, value in each[0].items() if any(one.get(key) != value for one in each)]
    for key in named:
        require(isinstance(each[0][key], float), "batch", f"{key} differs from car to car and is no number")
    return {key: np.array([one[key] for one in each]) for key in named}


def _numbers(owner: Any, within: str = "") -> Iterator[tuple[str, Any]]:
    """Every field, those of dataclasses in it too; of what is no number whatever tells two of it apart."""
    for field in fields(owner):
        value, name = getattr(owner, field.name), f"{within}{field.name}"
        if is_dataclass(value):
            yield from _numbers(value, f"{name}.")
        elif isinstance(value, int | float):
            yield name, float(value)
        elif isinstance(value, Table):
            yield name, value.rows.tobytes()
        elif not isinstance(value, str):
            yield name, value
