"""A manoeuvre as data: conditions, steering input or course, when it is aborted, what is evaluated, its limits."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from steerkit._support.errors import Checked, check_numbers, known, made_of, number, require
from steerkit._support.files import read_toml
from steerkit.controllers.open_loop import OpenLoop
from steerkit.diagram.block import Block
from steerkit.diagram.maths import Array
from steerkit.diagram.units import radians_of
from steerkit.paths.path import Path
from steerkit.scenario.parts import Course
from steerkit.vehicles import Vehicle

SPACING = 0.01
"""Between two samples of a wave [s]."""
SIDES = {"left": 1.0, "right": -1.0}
EVALUATIONS = ("steady", "step", "sine", "frequency", "on-centre", "transition", "dwell", "request", "course")
"""What can be evaluated: see `steerkit.proving.evaluate`."""


@dataclass(frozen=True, kw_only=True)
class Input:
    """An open-loop steering input: its form, its size and its times."""

    form: str
    """One of `FORMS`."""
    a_y: float = number(0.0, "m/s^2", low=0.0, high=30.0)
    """Size, as the lateral acceleration that the angle would give in steady driving by the car's linear model ..."""
    angle_deg: float = number(0.0, "deg", low=0.0, high=720.0)
    """... or as an angle of the steering wheel [degrees]."""
    rise: float = number(0.1, "s", low=0.0, high=60.0)
    """How long the wheel takes to the next angle [s]."""
    hold: float = number(3.0, "s", low=0.0, high=60.0)
    """How long an angle is held [s]."""
    levels: tuple[float, ...] = ()
    """Angles one after the other, as shares of the size [1]."""
    seconds: tuple[float, ...] = ()
    """How long each level lasts [s]; default: `hold`."""
    frequency: float = number(0.5, "Hz", low=0.01, high=5.0)
    """Of a sine [Hz]."""
    periods: float = number(1.0, "1", low=0.5, high=100.0)
    """Of a sine, or of a random input [1]."""
    low: float = number(0.2, "Hz", low=0.02, high=5.0)
    """Lowest frequency of a random input [Hz]."""
    high: float = number(2.0, "Hz", low=0.1, high=10.0)
    """Highest frequency of a random input [Hz]."""
    period: float = number(10.0, "s", low=1.0, high=120.0)
    """After which a random input repeats [s]."""
    dwell: float = number(0.5, "s", low=0.0, high=5.0)
    """Pause at the second peak of a sine with dwell [s]."""
    tail: float = number(0.0, "s", low=0.0, high=30.0)
    """With the wheel straight, after the input [s]."""
    seed: int = 0
    """Of a random input."""

    def __post_init__(self) -> None:
        check_numbers(self, "input")
        known(self.form, FORMS, "input: form")
        require((self.a_y > 0.0) != (self.angle_deg > 0.0), "input", "expected either a_y or angle_deg")
        times = not self.seconds or len(self.seconds) == len(self.levels)
        require(times, "input", f"{len(self.seconds)} seconds for {len(self.levels)} levels, expected as many")

    @property
    def wave(self) -> Array:
        """The steering wheel over its size, every `SPACING` (n,) [1]."""
        wave: Any = np.concatenate((FORMS[self.form](self), np.zeros(round(self.tail / SPACING) + 1)))
        return wave

    def angle(self, vehicle: Vehicle, v: float) -> float:
        """Its size for that car at speed v [m/s], at the steering wheel [rad]."""
        if self.angle_deg:
            return radians_of(self.angle_deg)
        return float(self.a_y * vehicle.wheel_per_a_y(v))


def _time(seconds: float) -> Array:
    return np.asarray(np.arange(round(seconds / SPACING)) * SPACING, dtype=float)


def _levels(i: Input) -> Array:
    """From each level to the next within `rise`, then held."""
    parts, before = list[Array](), 0.0
    for level, seconds in zip(i.levels or (1.0,), i.seconds or (i.rise + i.hold,) * max(1, len(i.levels))):
        share = np.minimum(_time(seconds) / max(i.rise, 1e-9), 1.0)
        parts.append(before + (level - before) * share)
        before = level
    return np.concatenate(parts)


def _random(i: Input) -> Array:
    """Sines of equal size at all multiples of 1/period from low to high, phases drawn; the largest value is 1.

    Source: Schroeder 1970 (periodic inputs of a given spectrum); here with random phases.
    """
    lines = np.arange(math.ceil(i.low * i.period - 1e-9), math.floor(i.high * i.period + 1e-9) + 1)
    t, phases = _time(i.period * i.periods), np.random.default_rng(i.seed).uniform(0.0, 2.0 * np.pi, len(lines))
    wave = np.sin(2.0 * np.pi * np.outer(t, lines) / i.period + phases).sum(axis=1)
    return np.asarray(wave / np.abs(wave).max() * np.minimum(t / i.rise, 1.0) * np.minimum((t[-1] - t) / i.rise, 1.0))


def _sine(i: Input) -> Array:
    """Several periods grow over `rise`: one that begins at its full size leaves the car with a sideways speed."""
    t = _time(i.periods / i.frequency)
    grown = np.minimum(t / i.rise, 1.0) if i.periods > 1.0 and i.rise > 0.0 else 1.0
    return np.asarray(grown * np.sin(2.0 * np.pi * i.frequency * t))


def _dwell(i: Input) -> Array:
    """One period of a sine, the third quarter's end held. Source: 49 CFR 571.126, S7.9 (figure 2)."""
    quarter = 0.25 / i.frequency
    first, last = _time(3.0 * quarter), _time(quarter)
    held = np.full(round(i.dwell / SPACING), -1.0)
    sine = lambda t: np.sin(2.0 * np.pi * i.frequency * t)  # noqa: E731
    return np.concatenate((sine(first), held, sine(3.0 * quarter + last)))


FORMS: Mapping[str, Any] = {
    "levels": _levels,
    "sine": _sine,
    "pulse": lambda i: 1.0 - np.abs(2.0 * _time(i.hold) / i.hold - 1.0),
    "random": _random,
    "dwell": _dwell,
}
"""The forms of an input, each as samples of `Input.wave`."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """What a result has to keep to."""

    quantity: str
    low: float = -math.inf
    high: float = math.inf
    source: str = ""

    def __post_init__(self) -> None:
        bounded = self.low < self.high and (math.isfinite(self.low) or math.isfinite(self.high))
        require(bounded, f"limit of {self.quantity}", f"low = {self.low:g}, high = {self.high:g}; expected low < high")

    def text(self) -> str:
        """As in a table: its bounds."""
        if math.isinf(self.low):
            return f"<= {self.high:g}"
        return f">= {self.low:g}" if math.isinf(self.high) else f"{self.low:g} to {self.high:g}"


@dataclass(frozen=True, kw_only=True)
class Conditions(Checked):
    """What must hold before a run begins, and what makes it invalid."""

    v: float = number(22.2, "m/s", low=1.0, high=60.0)
    """Speed [m/s]."""
    v_tolerance: float = number(0.8, "m/s", low=0.05, high=10.0)
    """By which the speed may differ, before and within a run [m/s]."""
    settle: float = number(2.0, "s", low=0.2, high=30.0)
    """Straight ahead before each run [s]."""
    r_max: float = number(0.02, "rad/s", low=1e-4, high=1.0)
    """|yaw rate| meanwhile, as a mean [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class Abort(Checked):
    """What ends a run at once; besides all that the car's own state machine watches."""

    a_y: float = number(8.0, "m/s^2", low=0.1, high=50.0)
    """|lateral acceleration| [m/s^2]."""
    v: float = number(2.0, "m/s", low=0.1, high=20.0)
    """|speed - that of the conditions| [m/s]."""
    e: float = number(3.5, "m", low=0.05, high=100.0)
    """|cross-track error|: how far it may lead off a course that a car is on [m]."""
    r: float = number(1.0, "rad/s", low=0.005, high=5.0)
    """|yaw rate| [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class Manoeuvre:
    """A manoeuvre, as its file says. Raises ValueError naming the table, the key and what is valid."""

    name: str
    title: str
    norm: str
    """The norm, its year and clause; or who else describes it."""
    about: str
    evaluation: str
    """One of `EVALUATIONS`."""
    input: Input | None = None
    course: str = ""
    """Of a closed loop: a name of `steerkit.paths.courses`, or a file; lane changes are stretched to the speed."""
    conditions: Conditions = Conditions()
    abort: Abort = Abort()
    repeats: int = number(3, low=1, high=100)
    """Valid runs to each side."""
    sides: tuple[str, ...] = ("left", "right")
    cutoff: float = number(0.0, "Hz", low=0.0, high=50.0)
    """Of the filter before evaluation, Butterworth of fourth order, forward and backward; 0: none [Hz]."""
    limits: tuple[Limit, ...] = ()
    sources: Mapping[str, str] = field(default_factory=dict)
    """Where each number of the file comes from, by its table and key."""

    def __post_init__(self) -> None:
        where = f"manoeuvre '{self.name}'"
        check_numbers(self, where)
        known(self.evaluation, EVALUATIONS, f"{where}: evaluation")
        require((self.input is None) != (self.course == ""), where, "expected either [input] or a course")
        require((self.evaluation == "course") == (self.course != ""), where, "a course is evaluated as 'course'")
        require(len(self.sides) > 0, where, "sides are empty; valid: left, right")
        for side in self.sides:
            known(side, SIDES, f"{where}: side")

    @property
    def unverified(self) -> tuple[str, ...]:
        """Numbers whose source was not at hand."""
        return tuple(key for key, source in self.sources.items() if "unverified" in source)

    @property
    def seconds(self) -> float:
        """Length of the input [s]; raises ValueError for a manoeuvre on a course."""
        return (len(self.required.wave) - 1) * SPACING

    def at(self, v: float | None = None, a_y: float | None = None) -> "Manoeuvre":
        """The same at another speed [m/s], or of another size [m/s^2]: what is left out stays."""
        changed, sources = self, dict(self.sources)
        if v not in (None, self.conditions.v):
            changed = replace(changed, conditions=replace(self.conditions, v=v))
            sources["conditions.v"] = f"as driven or asked for; {self.norm}: {self.conditions.v:g}"
        if a_y is not None and a_y != self.required.a_y:
            changed = replace(changed, input=replace(self.required, a_y=a_y, angle_deg=0.0))
            sources["input.a_y"] = f"as asked for; {self.norm}: {self.required.a_y:g}"
        return replace(changed, sources=sources)

    @property
    def required(self) -> Input:
        """Its input; raises ValueError for a manoeuvre on a course."""
        if self.input is None:
            raise ValueError(f"manoeuvre '{self.name}': is driven on a course, it has no open-loop input")
        return self.input

    def path(self) -> Path:
        """Its course at its speed; raises ValueError for a manoeuvre with an open-loop input."""
        require(self.course, f"manoeuvre '{self.name}'", "is an open-loop input, it has no course")
        return Course(name=self.course).path(self.conditions.v)

    def open_loop(self, base: Block, vehicle: Vehicle, side: str = "left", **more: Any) -> OpenLoop:
        """The block that steers it to a side, before and after which `base` steers; more: fields of `OpenLoop`."""
        wave, size = tuple(self.required.wave.tolist()), self.required.angle(vehicle, self.conditions.v)
        return OpenLoop(block=base, wave=wave, spacing=SPACING, amplitude=SIDES[side] * size, **more)


_SHIPPED = FilePath(__file__).with_name("manoeuvres")
_PARTS: Mapping[str, Any] = {"input": Input, "conditions": Conditions, "abort": Abort}


def manoeuvre_of(data: Mapping[str, Any], name: str) -> Manoeuvre:
    """The manoeuvre in the tables of a TOML file; raises ValueError naming what is wrong, and what is valid."""
    where = f"manoeuvre '{name}'"
    parts = {part: made_of(kind, data[part], f"{where}: [{part}]") for part, kind in _PARTS.items() if part in data}
    limits, sources = tuple(limits_of(data.get("limit", []), where)), dict(data.get("sources", {}))
    own = {key: value for key, value in data.items() if key != "limit"}
    return made_of(Manoeuvre, own | parts | {"name": name, "limits": limits, "sources": sources}, where)


def limits_of(rows: Any, where: str) -> list[Limit]:
    """Tables `[[limit]]` with quantity, low, high, source; raises ValueError."""
    require(isinstance(rows, list), where, "limit, expected tables [[limit]] with quantity, low, high, source")
    return [made_of(Limit, row, f"{where}: [[limit]]") for row in rows]


def read_limits(file: str | FilePath) -> list[Limit]:
    """The limits in a TOML file of tables [[limit]]; raises ValueError for a broken one, or one without any."""
    found = limits_of(read_toml(file, f"{file}").get("limit", []), f"{file}")
    require(found, f"{file}", "no table [[limit]] in it; expected quantity, low or high, source")
    return found


@cache
def names() -> tuple[str, ...]:
    """The manoeuvres that ship."""
    return tuple(sorted(file.stem for file in _SHIPPED.glob("*.toml")))


def manoeuvre(name: str) -> Manoeuvre:
    """A manoeuvre by name, or of a TOML file; raises ValueError with the valid ones."""
    own = name.lower().endswith(".toml")
    file = FilePath(name) if own else _SHIPPED / f"{known(name, names(), 'manoeuvre', also='FILE.toml')}.toml"
    return manoeuvre_of(read_toml(file, f"manoeuvre {name}"), file.stem)


def some(given: Sequence[str]) -> list[Manoeuvre]:
    """Manoeuvres by name; `all`: those that ship."""
    return [manoeuvre(name) for name in (names() if list(given) == ["all"] else given)]
