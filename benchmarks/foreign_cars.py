"""Cars that no one here wrote, as scenarios: what drives them, how fast, and what controllers are told."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from benchmarks.peers.commonroad import VANAGON_FILE
from benchmarks.scenarios import MULTI_BODY
from steerkit.scenario import Scenario, straightest
from steerkit.task import A_Y_MAX

_MOTOR = {"delay": 0.2, "lag": 0.12}
WIDE = 8.0
"""From this speed on a course is wide [m/s]: `sweeping-N`, bends of 100 m and more and straights."""


@dataclass(frozen=True)
class Foreign:
    """A foreign car: plant and data sheet, the steering in front of it or told of it, and speeds."""

    plant: str
    steering: Mapping[str, Any]
    vehicle: Mapping[str, str] = field(default_factory=lambda: {"name": "vw-passat"})
    speeds: tuple[float, ...] = (5.0, 10.0, 20.0)
    """Steady ones [m/s]."""
    ranges: tuple[tuple[float, float], ...] = ((4.0, 7.5), (12.0, 20.0))
    """Between which a human wanders [m/s], slowest first."""
    a_y_max: float = A_Y_MAX
    """Lateral acceleration in bends for which that human slows down [m/s^2]."""


CARS: Mapping[str, Foreign] = MappingProxyType(
    {
        "torque": Foreign(
            plant="benchmarks.plants.torque_car:TorqueCar",
            steering={"command": "torque", "delay": 0.5, "lag": 0.1, "slew": 5.0, "a_y_limit": 3.0},
            speeds=(8.0, 12.0, 16.0),
            ranges=((8.0, 12.0), (12.0, 16.0)),
            a_y_max=1.5,
        ),
        "mujoco": Foreign("benchmarks.plants.mujoco_car:MujocoCar", _MOTOR),
        "commonroad-1": Foreign(MULTI_BODY, _MOTOR, {"name": "ford-escort"}),
        "commonroad-2": Foreign(MULTI_BODY, _MOTOR, {"name": "bmw-320i"}),
        "commonroad-3": Foreign(MULTI_BODY, _MOTOR, VANAGON_FILE),
    }
)
HOME = "passat"
"""The Passat as a single track, which can change in every way that is measured; not a foreign car."""
_ALL = {**CARS, HOME: Foreign("nonlinear", _MOTOR)}


@lru_cache(maxsize=64)
def scene(car: str, v_min: float, v_max: float, seed: int, conditions: str = "clean") -> Scenario:
    """That car at those speeds [m/s], told the truth: on `random-N` below `WIDE`, on `sweeping-N` above, N by the seed.

    It starts where the course hardly bends.
    """
    foreign, wide = _ALL[car], v_min >= WIDE
    course = f"{'sweeping' if wide else 'random'}-{7 + seed}"
    return Scenario.under(
        conditions,
        name=f"{car}-{v_min:g}" if v_min == v_max else f"{car}-{v_min:g}-to-{v_max:g}",
        course={"name": course, "start": straightest(Scenario(course=course).path(), 10.0 * v_min if wide else 20.0)},
        vehicle={**foreign.vehicle, "plant": foreign.plant},
        driver={"v_min": v_min, "v_max": v_max, "a_y_max": foreign.a_y_max},
        steering=dict(foreign.steering),
    )


def told(scenario: Scenario, factor: float) -> Scenario:
    """The scenario with that much of its dead time told [1]; 0: that there is none."""
    truth = scenario.with_(knowledge={"delay": None})
    return scenario.with_(knowledge={"delay": factor * truth.believed_dead_time})


@lru_cache(maxsize=1)
def foreign_scenarios() -> tuple[Scenario, ...]:
    """Every car in both ranges of speed, under `hard` conditions; controllers are told no dead time and no lag."""
    return tuple(
        scene(car, *speeds, 0, "hard").with_(reference="own", knowledge={"delay": 0.0, "lag": 0.0})
        for car, foreign in CARS.items()
        for speeds in foreign.ranges
    )
