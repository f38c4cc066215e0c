"""What suites and studies drive: scenarios, cars that nothing was tuned on, and what a compiled drive leaves open."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.scenario import END_MARGIN, Scenario, fleet_scenario, straightest
from steerkit.scenario.catalogue import PLANTS
from steerkit.scenario.drive import drive_loop
from steerkit.scenario.parts import PARTS

MULTI_BODY = "benchmarks.peers.commonroad:CommonRoadMultiBody"
"""The plant that is CommonRoad's; it has `bmw-320i` and `ford-escort`."""
scene = partial(Scenario, reference="own")
"""A scenario of a suite: e is judged where the controller that drives has it measured."""

OPEN = {
    "vehicle.tyres": ("vehicle.c_f", "vehicle.c_r"),
    "vehicle.friction": ("vehicle.mu",),
    "vehicle.ratio": ("vehicle.steer_ratio",),
    "steering.offset_deg": ("actuator.offset",),
    "steering.lag": ("actuator.lag",),
    "disturbances.wind": ("car.wind",),
    "disturbances.gust": ("car.gust",),
    "disturbances.bank_deg": ("car.bank",),
}
"""Fields that a compiled drive leaves open, so that one program serves many scenarios, and what they are in a loop."""


_SHEET: dict[str, Any] = dict(recovery="stanley-delay", knowledge={"delay": 0.0, "lag": 0.0})
_ADAPT_COURSE = "random-2000"
FLEET = (0, 10, 1, 9)
"""Cars of the fleet in `unlike_the_data_sheet`: the first with 0.1, 0.12, 0.15 and 0.2 s of steering delay."""


@lru_cache(maxsize=1)
def unlike_the_data_sheet() -> tuple[Scenario, ...]:
    """Cars that differ from their data sheet, which is all that controllers know: no delay, no lag, nothing wrong.

    Cars of the fleet, each with the delay, lag, offset and play that its number draws, and the Passat with one kind of
    trouble at a time; all with `hard` sensors, on random courses that nothing was tuned on.
    """
    start = straightest(Scenario(course=_ADAPT_COURSE).path())

    def passat(name: str, **trouble: Any) -> Scenario:
        return Scenario.under(
            "hard", name=f"passat-{name}", course={"name": _ADAPT_COURSE, "start": start}, **(_SHEET | trouble)
        )

    return (
        *(fleet_scenario(number, **_SHEET) for number in FLEET),
        passat("ratio-tyres", vehicle={"ratio": 1.25, "tyres": 0.6}),
        passat("delay", steering={"delay": 0.2}),
        passat("lag", steering={"lag": 0.3}),
        passat("offset", steering={"offset_deg": 4.0}),
        passat("play", steering={"play_deg": 4.0}),
        passat("wind-bank", disturbances={"wind": 0.4, "gust": 0.2, "bank_deg": 3.0}),
        passat("noise", sensors={"noise": 2.0, "latency": 0.1}),
    )


def of_kind(name: str, **changes: Any) -> tuple[Scenario, ...]:
    """The cars of a kind, one of `KINDS`, for studies of learners; changes: fields that are to be others."""
    return tuple(scenario.with_(**changes) for scenario in KINDS[name]())


def of_fleet(count: int, rounds: float = 1.0) -> tuple[Scenario, ...]:
    """The first `count` cars of the fleet, on so many rounds."""
    return tuple(fleet_scenario(number, course={"rounds": rounds}) for number in range(count))


def _delays(course: str, v_min: float, v_max: float) -> tuple[Scenario, ...]:
    start = straightest(Scenario(course=course).path(), 60.0 if course.startswith("sweeping") else 20.0)
    driven: Any = dict(course={"name": course, "start": start}, driver={"v_min": v_min, "v_max": v_max})
    return tuple(
        Scenario.under("hard", name=f"{delay:g} s", steering={"delay": delay, "lag": 0.2}, **driven) for delay in DELAYS
    )


def _multi_body() -> tuple[Scenario, ...]:
    start = straightest(Scenario(course=_ADAPT_COURSE).path())
    return (
        Scenario.under(
            "hard",
            name="multi-body",
            course={"name": _ADAPT_COURSE, "start": start},
            vehicle={"name": "bmw-320i", "plant": MULTI_BODY},
            steering={"delay": 0.2, "lag": 0.2},
        ),
    )


DELAYS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Steering delays of the kinds `delays` and `fast-delays` [s]."""
KINDS: Mapping[str, Callable[[], tuple[Scenario, ...]]] = MappingProxyType(
    {
        "delays": lambda: _delays(_ADAPT_COURSE, 4.0, 7.5),
        "fast-delays": lambda: _delays("sweeping-2000", 12.0, 25.0),
        "multi-body": _multi_body,
    }
)
"""Cars besides the fleet's: the Passat with a delay, at 4 to 7.5 and at 12 to 25 m/s; CommonRoad's multi-body BMW with
0.2 s of delay. All with `hard` sensors."""


def suite_loop(scenario: Scenario, controller: Block, *, doe: Block | None = None, seed: int = 0) -> Loop:
    """The loop of a suite's drive, which begins END_MARGIN behind the start of an open course."""
    start = {} if scenario.path().closed else {"start": END_MARGIN}
    return drive_loop(scenario.with_(course=start), controller, doe=doe, seed=seed)


def facts(scenario: Scenario) -> dict[str, Any]:
    """The scenario's fields for the protocol, such as `steering.delay`; of the texts of its files only a hash."""
    flat: dict[str, Any] = {}
    for table, values in asdict(scenario).items():
        for name, value in values.items() if table in PARTS else ():
            flat[f"{table}.{name}"] = value
        if table not in PARTS:
            flat[table] = values
    texts = {name: text for name, text in flat.items() if name.endswith(".text") and text is not None}
    return flat | {name: hashlib.sha256(text.encode()).hexdigest()[:16] for name, text in texts.items()}


def shape(scenario: Scenario) -> Scenario:
    """What a compiled drive depends on: the scenario with all that is left open put to one value."""
    if scenario.vehicle.plant not in PLANTS:
        return replace(scenario, name="shape")
    if scenario.knowledge.oracle:  # then the controller itself depends on all of it
        return replace(scenario, name="shape")
    believed = scenario.design_model()
    plain = scenario.with_(
        name="shape",
        knowledge={"delay": believed.delay, "lag": believed.lag},
        vehicle={"tyres": 1.0, "friction": 1.0, "ratio": 1.0},
        steering={"offset_deg": 0.0, "lag": 0.1},
    )
    if scenario.disturbances.present:
        plain = plain.with_(disturbances={"wind": 0.1, "gust": 0.1, "bank_deg": 0.1})
    return plain.with_(driver={"v_min": 4.0, "v_max": 8.0}) if _open_speeds(scenario) else plain


def open_parameters(scenario: Scenario) -> tuple[str, ...]:
    """Names of the loop's parameters that are left open."""
    if scenario.vehicle.plant not in PLANTS:
        return ()
    car = "car.block." if scenario.disturbances.present else "car."
    names = [car + name if name.startswith("vehicle.") else name for fields in OPEN.values() for name in fields]
    kept = [name for name in names if scenario.disturbances.present or name not in ("car.wind", "car.gust", "car.bank")]
    return (*kept, *_open_speeds(scenario).values())


def _open_speeds(scenario: Scenario) -> dict[str, str]:
    """The human's speeds, unless the course's own length or a record hangs on them."""
    if scenario.driver.speed == "recorded" or scenario.course.name.startswith("iso3888-"):
        return {}
    return {"v_min": "driver.driver.v_min", "v_max": "driver.driver.v_max"}
