"""Cars that nothing was tuned on, for the studies of learners: of the fleet, or of another kind, each on its course."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from benchmarks.scenarios import MULTI_BODY
from steerkit.scenario import Scenario, fleet_scenario, straightest


def of_kind(name: str, **changes: Any) -> tuple[Scenario, ...]:
    """The cars of a kind, one of `KINDS`; changes: fields that are to be others."""
    return tuple(scenario.with_(**changes) for scenario in KINDS[name]())


def of_fleet(count: int, rounds: float = 1.0) -> tuple[Scenario, ...]:
    """The first `count` cars of the fleet, on so many rounds."""
    return tuple(fleet_scenario(number, course={"rounds": rounds}) for number in range(count))


def _delays(course: str, v_min: float, v_max: float) -> tuple[Scenario, ...]:
    driven: Any = dict(course={"name": course, "start": _start(course)}, driver={"v_min": v_min, "v_max": v_max})
    return tuple(
        Scenario.under("hard", name=f"{delay:g} s", steering={"delay": delay, "lag": 0.2}, **driven) for delay in DELAYS
    )


def _multi_body() -> tuple[Scenario, ...]:
    course = "random-2000"
    return (
        Scenario.under(
            "hard",
            name="multi-body",
            course={"name": course, "start": _start(course)},
            vehicle={"name": "bmw-320i", "plant": MULTI_BODY},
            steering={"delay": 0.2, "lag": 0.2},
        ),
    )


def _start(course: str) -> float:
    """Where the course hardly bends [m], for longer where cars are fast."""
    return straightest(Scenario(course=course).path(), 60.0 if course.startswith("sweeping") else 20.0)


DELAYS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Steering delays of the kinds `delays` and `fast-delays` [s]."""
KINDS: Mapping[str, Callable[[], tuple[Scenario, ...]]] = MappingProxyType(
    {
        "delays": lambda: _delays("random-2000", 4.0, 7.5),
        "fast-delays": lambda: _delays("sweeping-2000", 12.0, 25.0),
        "multi-body": _multi_body,
    }
)
"""Cars besides the fleet's: the Passat with a delay, at 4 to 7.5 and at 12 to 25 m/s; CommonRoad's multi-body BMW with
0.2 s of delay. All with `hard` sensors."""
