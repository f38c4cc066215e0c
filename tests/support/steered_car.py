"""A car that is steered open loop, and what its sensors then say: what estimators are tried on."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from steerkit.diagram.block import Block
from steerkit.diagram.units import radians_of
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.steering_actuator import SteeringActuator, SteeringColumn
from steerkit.vehicles import VW_PASSAT as PASSAT
from steerkit.vehicles import Vehicle
from tests.support.stepped import from_there

HELD = 0.005
"""A plant of 10 ms holds its input: its answer is that much later [s]."""
Signals = dict[str, np.ndarray]


def steered(seconds: float, seed: int = 0) -> np.ndarray:
    """Steering as a person does it: smooth, to and fro within some tens of degrees, 20 samples a second [rad]."""
    rng, t = np.random.default_rng(seed), np.arange(round(seconds / 0.05)) * 0.05
    waves = [np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.3)) / np.sqrt(f) for f in (0.07, 0.13, 0.23, 0.41, 0.67)]
    return np.asarray(radians_of(8.0) * np.sum(waves, axis=0))


def answered(
    command: np.ndarray,
    *,
    delay: float = 0.0,
    lag: float = 0.1,
    v: float | Sequence[float] | np.ndarray = 8.0,
    offset: float = 0.0,
    car: Vehicle = PASSAT,
    friction: float = 0.0,
    play: float = 0.0,
) -> Signals:
    """Wheel, yaw rate and heading of a car whose steering has all this: signals for estimators' inputs, every 50 ms."""
    actuator, plant = SteeringActuator(delay=delay, lag=lag, offset=offset), LinearSingleTrack(vehicle=car)
    column, speeds = SteeringColumn(friction=friction, play=play), np.broadcast_to(v, command.shape).tolist()
    motor, x, worn, rows = actuator.init(), plant.init(), column.init(), []
    for k in range(5 * len(command)):
        angle = actuator.output(0.0, motor, ()).delta_sw
        y = column.output(0.0, worn, column.D(angle))
        if k % 5 == 0:
            rows.append((y.delta_sw_meas, x.r, x.psi))
        motor = actuator.update(0.0, motor, actuator.U(float(command[k // 5])), None)
        worn = column.update(0.0, worn, column.U(angle), y)
        x = plant.update(0.0, x, plant.U(y.delta_sw, speeds[k // 5]), None)
    wheel, r, psi = np.array(rows).T
    ones = np.ones(len(command))
    known = {
        "delay": delay * ones,
        "lag": lag * ones,
        "delay_deviation": 0.0 * ones,
        "lag_deviation": 0.0 * ones,
        "active": ones,
        "v": np.array(speeds, dtype=float),
    }
    return known | {"delta_sw_cmd": command, "delta_sw": command, "delta_sw_meas": wheel, "r": r, "psi": psi}


def driven(block: Block, signals: Signals, x: Any = None) -> Any:
    """The block's state after these signals."""
    x = block.init() if x is None else x
    for row in zip(*[signals[port.name].tolist() for port in block.inputs]):
        x = block.update(0.0, x, block.U(*row), None)
    return x


def driven_fast(block: Block, signals: Signals, x: Any = None) -> Any:
    """The same state to rounding, in CasADi's machine: for long signals."""
    rows = np.array([signals[port.name] for port in block.inputs]).T
    return tuple(from_there(block, block.init() if x is None else x, rows)[1].tolist())


def gaps(n: int) -> np.ndarray:
    """True in some stretches of one to four seconds, 40 % of the time."""
    rng, mask = np.random.default_rng(5), np.zeros(n, dtype=bool)
    while mask.mean() < 0.4:
        start, length = rng.integers(0, n), rng.integers(20, 80)
        mask[start : start + length] = True
    return mask


def quantities(block: Block) -> tuple[str, ...]:
    """What a block estimates: the names of its outputs that come with `NAME_deviation` and `NAME_valid`."""
    names = {port.name for port in block.outputs}
    return tuple(port.name for port in block.outputs if {f"{port.name}_deviation", f"{port.name}_valid"} <= names)
