"""What is driven: course, car, disturbances, what controllers believe; one drive or many."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from steerkit._support.errors import known, require, require_within
from steerkit._support.files import read_toml
from steerkit._support.plugins import named_in
from steerkit._support.random import seed_state, uniform
from steerkit.diagram.block import Block
from steerkit.diagram.units import radians_of
from steerkit.paths.importers import is_road
from steerkit.paths.importers.course import check_bends
from steerkit.paths.path import Path
from steerkit.plants.single_track import SingleTrack
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed
from steerkit.scenario.catalogue import AUTO, RECOVERIES, DesignModel, make_recovery, plant_kind
from steerkit.scenario.parts import PARTS, Car, Course, Disturbances, Driver, Knowledge, Sensing, Steering
from steerkit.vehicles import Vehicle, drawn_car, rows_of

__all__ = ["CONDITIONS", "END_MARGIN", "Scenario", "fleet_scenario"]


FORMAT = "steerkit scenario 2"
END_MARGIN = 5.0
"""How far from the ends of an open course a drive begins or ends [m]."""
REFERENCES = ("front", "cg", "own")
Table = Mapping[str, Any]
_HARD: Table = {"sensors": {"noise": 1.0, "latency": 0.05}, "steering": {"lag": 0.15}}
CONDITIONS: Mapping[str, Table] = {
    "clean": {},
    "hard": _HARD,
    "real": {**_HARD, "sensors": {**_HARD["sensors"], "kind": "real"}},
}
"""Named disturbances: tables of a scenario. `hard`: 1 cm of noise, 50 ms of sensor delay, a slower motor; `real`: also
a noisy speed, no sideslip, late and lost samples, jumps, a heading that wanders (`Sensors.real`)."""
_SLOWEST = 4.0  # m/s: the speed of a careful driver in the tightest bend of all courses, 5.9 m
_TIME_TO_SPARE = 10.0  # s


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """What a drive is made in: course, car, driver, disturbances; for learning, tests and suites.

    Each part is given as such, as a table of its fields, as a file has it, or, for course and vehicle, by its name:
    `Scenario(course="genesis", steering={"delay": 0.2}, driver=Driver(v_min=5.0, v_max=5.0))`.

    Controllers know the car of the data sheet, and the steering's delay and lag unless `knowledge` says otherwise.
    A course or a car from a file is read when the scenario is made and its text is kept, so that a scenario that was
    stored, sent to another machine or moved to another folder stays what it was. Raises ValueError for whatever
    cannot be driven, naming table, field, unit and what is valid.
    """

    name: str = "scenario"
    """What it is called in results and errors."""
    reference: str = "front"
    """Where e is judged, and measured for a learner: at the `front` axle (as Stanley does), at the centre of gravity,
    `cg`, or at the controller's `own` point (the front axle for one that has none)."""
    recovery: str = AUTO
    """The recovery controller of a learned one: `stanley`, `stanley-delay`, or `adaptive`: `stanley-delay` that finds
    dead time and ratio by itself (`Adaptive`); `auto` is `adaptive`."""
    course: Course = Course()
    vehicle: Car = Car()
    driver: Driver = Driver()
    steering: Steering = Steering()
    sensors: Sensing = Sensing()
    disturbances: Disturbances = Disturbances()
    knowledge: Knowledge = Knowledge()

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            name: str = "scenario",
            reference: str = "front",
            recovery: str = AUTO,
            course: Course | Table | str = ...,
            vehicle: Car | Table | str = ...,
            driver: Driver | Table = ...,
            steering: Steering | Table = ...,
            sensors: Sensing | Table = ...,
            disturbances: Disturbances | Table = ...,
            knowledge: Knowledge | Table = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        where = "scenario" if self.name == "scenario" else f"scenario '{self.name}'"
        require(isinstance(self.name, str) and "--" not in self.name, where, "the name holds '--', which parts names")
        for name, valid in (("reference", REFERENCES), ("recovery", RECOVERIES)):
            require(getattr(self, name) in valid, where, f"{name} {getattr(self, name)!r}; valid: {', '.join(valid)}")
        try:
            for name, part in PARTS.items():
                object.__setattr__(self, name, part.of(getattr(self, name)))
            self._check_together()
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from error

    def _check_together(self) -> None:
        """What one part alone cannot know; each block checks itself as it is made."""
        dead = self.believed_dead_time
        require(dead <= 2.0, "steering, sensors", f"delay and latency add up to {dead:g} [s], expected at most 2")
        if self.course.text is not None:
            check_bends(self.path(), self.nominal.tightest)
        if self.course.start:
            length = self.path().length
            require_within("course", "start", self.course.start, "m", 0.0, length, "the course's length")
        if self.driver.speed != "wander":
            self.driver.profile(self.course, self.path())
        car = plant_kind(self.vehicle.plant)(vehicle=self.vehicle.true, v0=self.driver.v_min)  # type: ignore[call-arg]
        can_be_pushed = isinstance(car, SingleTrack) or not self.disturbances.present
        require(can_be_pushed, "disturbances", f"only single-track cars are pushed, not '{self.vehicle.plant}'")
        nominal = self.nominal
        _ = self.steering.link(0), self.steering.actuator(nominal), self.steering.column()
        _ = self.sensors.sensors(nominal, 0), self.sensors.state_estimator(nominal)

    @classmethod
    def under(cls, conditions: str = "clean", **changes: Any) -> Self:
        """The scenario of the named conditions, `clean`, `hard` or `real`, with these fields and tables.

        Where `vehicle` names a file with a table [steering], delay, lag and offset_deg are taken from it, also instead
        of the conditions' lag, but for those given in `changes`.
        Raises ValueError for unknown conditions or fields, with the valid ones.
        """
        disturbed = CONDITIONS[known(conditions, CONDITIONS, "conditions")]
        require_fields(cls, changes, "scenario")
        steering = Car.of(changes.get("vehicle", Car())).steering_in_file()
        return cls(**disturbed).with_(steering=steering).with_(**changes)

    def with_(self, **changes: Any) -> Self:
        """This scenario with other fields, and other fields in its parts: `with_(steering={"delay": 0.2})`.

        Raises ValueError for an unknown field, with the valid ones, and for what cannot be driven.
        """
        require_fields(type(self), changes, f"scenario '{self.name}'")
        for name, value in changes.items():
            if name in PARTS:
                changes[name] = PARTS[name].of(value, getattr(self, name))
        return replace(self, **changes)

    @property
    def random(self) -> bool:
        """Does anything depend on the seed (but for a learner's net)?"""
        pushed_or_late = max(self.disturbances.gust, self.steering.delay_jitter) > 0.0
        return self.driver.wanders or self.sensors.random or pushed_or_late or self._plant_draws

    @property
    def _plant_draws(self) -> bool:
        kind: Any = plant_kind(self.vehicle.plant)
        return "seed" in {field.name for field in fields(kind)}

    @property
    def nominal(self) -> Vehicle:
        """The car of the data sheet."""
        return self.vehicle.nominal

    @property
    def ahead(self) -> float:
        """The reference point's distance ahead of the centre of gravity [m], for a controller without its own."""
        return 0.0 if self.reference == "cg" else float(self.nominal.l_f)

    @property
    def believed_dead_time(self) -> float:
        """Delay of the steering and age of what is seen, as controllers believe it [s]; the mean of what varies.

        Behind an estimator nothing that is seen is old.
        """
        if self.knowledge.delay is not None:
            return self.knowledge.delay
        age = self.sensors.latency if self.sensors.estimator == "none" else 0.0
        return self.steering.delay + age + 0.5 * self.steering.delay_jitter

    def path(self) -> Path:
        """The course's path."""
        return self.course.path(self.driver.v_max)

    @property
    def round_length(self) -> float:
        """What counts as a round [m]: an open course is driven without END_MARGIN at either end."""
        path = self.path()
        return path.length - (0.0 if path.closed else 2.0 * END_MARGIN)

    @property
    def length(self) -> float:
        """How far a test drive goes [m]."""
        return self.course.rounds * self.round_length

    @property
    def seconds(self) -> float:
        """How long that takes the slowest driver, and some more [s]."""
        driver = self.driver
        if driver.speed != "wander":
            s, v = driver.profile(self.course, self.path())
            pace = 1.0 / np.clip(v, driver.v_min, driver.v_max)
            return math.ceil(self.course.rounds * float(np.trapezoid(pace, s)) + _TIME_TO_SPARE)
        return math.ceil(self.length / min(driver.v_min, _SLOWEST) + _TIME_TO_SPARE)

    def design_model(self, *, clock: Callable[[], float] | None = None) -> DesignModel:
        """What controllers are made for: the nominal car or the true one, the steering's delay and lag.

        clock: seconds, for the times that predictive controllers show; None: no time is taken.
        """
        oracle, steering, knowledge = self.knowledge.oracle, self.steering, self.knowledge
        torque, gain = steering.command == "torque", steering.gain if oracle else 1.0
        return DesignModel(
            vehicle=self.vehicle.true if oracle else self.nominal,
            path=self.path(),
            delay=self.believed_dead_time,
            lag=steering.lag if knowledge.lag is None else knowledge.lag,
            hold=SteeringActuator.dt,
            rate_limit=radians_of(steering.rate_limit_deg),
            slew=gain * steering.slew if torque else None,
            a_y_limit=gain * steering.a_y_limit if torque else None,
            offset=radians_of(steering.offset_deg) if oracle else 0.0,
            gain=gain if torque else 1.0,
            clock=clock,
        )

    def car(self, path: Path, s: float = 0.0, seed: int = 0) -> Block:
        """The plant, on the path at arc length s [m]; `seed` is that of the gusts, and of a plant that has one."""
        kind: Any = plant_kind(self.vehicle.plant)
        own = {"seed": seed} if self._plant_draws else {}
        car = kind(vehicle=self.vehicle.true, v0=self.driver.v_min, **own)
        return self.disturbances.around(placed(car, path, s=s), seed)

    def blocks(self, path: Path, s: float = 0.0, seed: int = 0) -> dict[str, Block | None]:
        """All blocks but the controllers, by the names that `steering_loop` has for them; None for those left out.

        s: where the car starts [m]. seed: of driver, sensors, gusts and the link's delays.
        """
        nominal = self.nominal
        return {
            "car": self.car(path, s, seed),
            "driver": self.driver.block(self.course, path, seed),
            "link": self.steering.link(seed),
            "actuator": None if plant_kind(self.vehicle.plant).own_steering else self.steering.actuator(nominal),
            "column": self.steering.column(),
            "sensors": self.sensors.sensors(nominal, seed),
            "estimator": self.sensors.state_estimator(nominal),
        }

    def recovery_controller(self, *, alone: bool = False) -> Block:
        """The analytic controller that takes over from a learned one; or drives `alone`."""
        return make_recovery(self.recovery, self.design_model(), alone=alone)


def tables(dotted: Table) -> dict[str, Any]:
    """Fields named `steering.delay` as tables, as `Scenario.with_` takes them; those without a dot stay as they are."""
    nested: dict[str, Any] = {}
    for key, value in dotted.items():
        table, _, name = key.rpartition(".")
        (nested.setdefault(table, {}) if table else nested)[name] = value
    return nested


def require_fields(kind: type[Scenario], table: Table, where: str) -> None:
    """Raise ValueError for a name that is no field of a scenario, saying in which table it is, or the valid ones."""
    valid = [f.name for f in fields(kind)]
    for name in table:
        holders = [part for part, cls in PARTS.items() if name in {f.name for f in fields(cls)}]
        hint = f"; it is a field of {' and '.join(holders)}" if holders else f"; valid: {', '.join(valid)}"
        require(name in valid, where, f"a scenario has no field '{name}'{hint}")


def read_scenario(file: str | FilePath) -> Scenario:
    """The scenario in a TOML file; courses and cars from files are looked for beside it, or their texts are in it.

    Raises ValueError naming the file, the key and the valid keys.
    """
    place = FilePath(file)
    table = read_toml(place, f"scenario {file}")
    format_ = table.pop("format", None)
    require(format_ == FORMAT, f"{file}", f"format = {format_!r}, expected {FORMAT!r} in the first line")
    for key, part in PARTS.items():
        given = table.get(key)
        if isinstance(given, str):
            given = table[key] = {"name": given}
        if isinstance(given, dict) and part.file in given and "text" not in given:
            name = given[part.file]
            own = isinstance(name, str) and name.lower().endswith((".csv", ".toml"))
            if own or (key == "course" and isinstance(name, str) and is_road(name)):
                given[part.file] = str(place.parent / name)
    with named_in(f"{file}"):
        return of_table(table, f"{file}")


def write_scenario(scenario: Scenario, file: str | FilePath) -> None:
    """Write a scenario as TOML, with the files that it needs in it; `read_scenario` gives it back bit for bit."""
    table = asdict(scenario)
    rows = [f"format = {json.dumps(FORMAT)}", *rows_of({k: v for k, v in table.items() if k not in PARTS})]
    for name in PARTS:
        rows += ["", f"[{name}]", *rows_of(table[name])]
    FilePath(file).write_text("\n".join(rows) + "\n", encoding="utf-8")


def of_table(table: Table, where: str, made: type[Scenario] = Scenario) -> Scenario:
    """The scenario whose fields and tables these are; missing ones take their defaults, `kind` is passed over.

    made: the class, one of your own that extends `Scenario`. Raises ValueError, beginning with `where`, for an unknown
    field, naming the valid ones, and for values that make no scenario.
    """
    values = {key: value for key, value in table.items() if key != "kind"}
    require_fields(made, values, where)
    try:
        return made(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


COURSES_FROM = 1000
"""Random courses from this number on are for such scenarios: nothing was tuned on them."""
LAG = (0.1, 0.3)
"""Least and largest lag of the steering [s]."""
OFFSET_DEG = 3.0
"""Largest |offset| of the steering wheel [degrees]."""
PLAY_DEG = 2.0
"""Largest free play of the steering, at the wheel [degrees]."""
_STREAM = 22  # of `seed_state`: what is drawn besides the car


def straightest(path: Path, length: float = 20.0) -> float:
    """Where the stretch of `length` [m] begins that bends least in its worst place [m]."""
    s = np.arange(0.0, path.length, 1.0)
    kappa = np.abs(path.kappa(s))
    worst = np.max([np.roll(kappa, -k) for k in range(int(length))], axis=0)
    return float(s[worst.argmin()])


def fleet_scenario(number: int, **changes: Any) -> Scenario:
    """A production car drawn by a seed, on a course that nothing was tuned on, under `hard` conditions.

    Drawn are: the car, as `vehicle("fleet-17")` is, with its own steering delay; the lag of its steering, uniform from
    0.1 to 0.3 s; the offset of its wheel, uniform within +-3 degrees; free play, uniform up to 2 degrees. The course is
    `random-1017` for number 17; drives begin where it is straightest, as a car put down in a tight bend leaves the path
    whoever steers it.

    number: the seed, a whole number >= 0. changes: as for `Scenario.with_`; a drive on another course begins where
    they say. Raises ValueError for another number, and for changes that make no scenario.
    """
    car = drawn_car(number)
    share, state = uniform(seed_state(number, stream=_STREAM))
    side, state = uniform(state)
    worn, _ = uniform(state)
    scenario = Scenario.under(
        "hard",
        name=f"fleet-{number}",
        vehicle=car.vehicle.name,
        course=f"random-{COURSES_FROM + number}",
        steering={
            "delay": round(car.steer_delay, 2),
            "lag": round(LAG[0] + (LAG[1] - LAG[0]) * share, 3),
            "offset_deg": round(OFFSET_DEG * (2.0 * side - 1.0), 2),
            "play_deg": round(PLAY_DEG * worn, 2),
        },
    ).with_(**changes)
    given = changes.get("course", {})
    if not isinstance(given, Mapping) or given.keys() & {"name", "start"}:  # a course takes longer than all the rest
        return scenario
    return scenario.with_(course={"start": straightest(scenario.path())})
