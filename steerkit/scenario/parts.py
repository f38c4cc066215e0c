"""The parts of a scenario: course, vehicle, driver, steering, sensors, disturbances, and what controllers believe."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path as FilePath
from typing import Any, ClassVar, Self, cast

import numpy as np

from steerkit._support.errors import check_numbers, known, number, require
from steerkit._support.files import read_text
from steerkit.diagram.block import Block
from steerkit.diagram.maths import Array
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.vehicle_state import VehicleState
from steerkit.paths.courses import course, lane_change, names, random_course, recorded_speed
from steerkit.paths.importers import KINDS, Address, is_road, read_course
from steerkit.paths.importers.course import course_of
from steerkit.paths.path import Path
from steerkit.paths.waypoints import mended, read_columns
from steerkit.plants.disturbed_plant import DisturbedPlant
from steerkit.plants.sensors import Sensors
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.plants.speed_driver import CurveSpeedDriver, SpeedDriver, SpeedProfile, ceiling
from steerkit.plants.steering_actuator import (
    SteeringActuator,
    SteeringColumn,
    SteeringLink,
    TorqueSteering,
    steering_of,
)
from steerkit.scenario.catalogue import plant_kind
from steerkit.task import A_Y_MAX, DT
from steerkit.vehicles import G, Vehicle, tables_of, vehicle, vehicle_of

RANDOM_COURSES = {"random": (500.0, 0.1), "sweeping": (2000.0, 0.01)}
"""Length [m] and largest curvature [1/m] of random courses, by what their names begin with."""
_TIGHTEST = 0.5  # m: no course from a map is tighter; what the scenario's car can do is judged besides


def _word(*valid: str) -> Any:
    """A field that holds one of these words; the first is the default."""
    return field(default=valid[0], metadata={"valid": valid})


_KINDS: Mapping[Any, str] = {
    str: "text",
    str | None: "text, or nothing",
    bool: "true or false",
    bool | None: "true or false, or nothing",
}
"""What a field of that annotation holds, and how it is called in an error."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """A table of a scenario's file; its numbers and words are checked against what stands beside each field.

    Raises ValueError naming the table, the field, its unit and what is valid.
    """

    table: ClassVar[str]
    """Name of the table in a file, and of the part in a `Scenario`."""
    file: ClassVar[str] = ""
    """The field that may name a file, whose text is then kept in `text`."""

    def __post_init__(self) -> None:
        check_numbers(self, self.table)
        for f in fields(self):
            value, kind = getattr(self, f.name), cast(Any, f.type)
            if "valid" in f.metadata:
                valid = f.metadata["valid"]
                require(value in valid, self.table, f"{f.name} {value!r}; valid: {', '.join(valid)}")
            elif "number" in f.metadata and value is not None:
                plain = isinstance(value, int | float) and not isinstance(value, bool)
                require(plain, self.table, f"{f.name} = {value!r}, expected a number [{f.metadata['number'][0]}]")
                object.__setattr__(self, f.name, float(value))
            elif kind in _KINDS:
                fits = isinstance(value, kind) or (f.name == self.file and isinstance(value, FilePath))
                require(fits, self.table, f"{f.name} = {value!r:.60}, expected {_KINDS[kind]}")

    @classmethod
    def of(cls, given: Any, base: Self | None = None) -> Self:
        """The part itself; or a table of its fields, the others as in `base`; or of a course or vehicle, its name."""
        if isinstance(given, cls):
            return given
        if isinstance(given, str | FilePath) and cls.file == "name":
            given = {"name": str(given)}
        valid = [f.name for f in fields(cls)]
        require(isinstance(given, Mapping), cls.table, f"{given!r:.60}, expected a table of {', '.join(valid)}")
        for key in given:
            require(key in valid, cls.table, f"no field '{key}'; valid: {', '.join(valid)}")
        if base is None:
            return cls(**given)
        if cls.file in given:  # another file
            given = {"text": None, **given}
        return replace(base, **given)

    def _keep_file(self, suffix: str) -> None:
        """Read the file that is named, unless its text is known, and keep the text and the name without folders."""
        given, text = str(getattr(self, self.file)), getattr(self, "text")  # noqa: B009
        if text is None and given.lower().endswith(suffix):
            object.__setattr__(self, "text", read_text(given, self.table, latin=suffix == ".csv"))
            object.__setattr__(self, self.file, FilePath(given).name)


@dataclass(frozen=True, kw_only=True)
class Course(Part):
    """Where is driven, from where on and how far."""

    table: ClassVar[str] = "course"
    file: ClassVar[str] = "name"
    name: str = "paper"
    """A course of `steerkit.paths.courses`; `random-7` and the like, a random course by its seed (500 m, radii of 10 m
    and more), `sweeping-7` one with wide bends (2 km, 100 m and more); or a file: CSV with the columns x, y [m] or lat,
    lon [degrees], or any that `steerkit.paths.importers.read_course` reads, such as `town.xodr#road=1,lane=-1`, which
    is kept as such a CSV. ISO lane changes are as long as the driver's v_max asks."""
    closed: bool | None = None
    """Is a course from a file closed? None: as the file says, or as it looks (`steerkit.paths.importers.course_of`)."""
    start: float = number(0.0, "m", low=0.0, high=1e6)
    """Where on the course a drive begins [m]: at rest relative to it, so that a tight bend there is no fair start."""
    rounds: float = number(1.0, "1", low=1e-3, high=1e6)
    """Rounds that a test drive takes; an open course is driven without END_MARGIN at either end."""
    text: str | None = field(default=None, repr=False)
    """The text of the file that `name` names; filled in when the part is made."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "name", str(self.name))  # it may be a file's path
        if self.text is None and is_road(self.name):
            text = read_course(self.name, tightest=_TIGHTEST, closed=self.closed).text()
            object.__setattr__(self, "text", text)
            object.__setattr__(self, "name", f"{Address.parsed(self.name).name}.csv")
        read = self.text is None
        self._keep_file(".csv")
        if read and self.text is not None:
            object.__setattr__(self, "text", mended(self.text, self.name))
        if self.text is None:
            require(self.closed is None, self.table, f"closed = {self.closed} is only for a course from a file")
            if drawn_course(self.name) is None:
                known(self.name, [*names(), "random-7", "sweeping-7"], self.table, also=f"FILE{', '.join(KINDS)}")

    def path(self, v_max: float) -> Path:
        """The course's path; v_max: the driver's [m/s]."""
        return _path(self.name, self.closed, self.text, v_max)


@dataclass(frozen=True, kw_only=True)
class Car(Part):
    """Which car is driven, by which model, and how it differs from its data sheet."""

    table: ClassVar[str] = "vehicle"
    file: ClassVar[str] = "name"
    name: str = "vw-passat"
    """A car of `steerkit.vehicles`; `fleet-17` and the like, a production car by its seed, of which the steering delay
    is not taken (`fleet_scenario` does); or a vehicle file, `my-car.toml`. Its table [steering] is not read here:
    `Scenario.under` does, and so do the command line and the environments."""
    plant: str = "nonlinear"
    """`nonlinear` or `linear` single track; or `package.module:Class`, see `steerkit.scenario.catalogue.plant_kind`."""
    tyres: float = number(1.0, "1", low=0.1, high=10.0)
    """Cornering stiffness over that of the data sheet [1]."""
    friction: float = number(1.0, "1", low=0.1, high=10.0)
    """Friction coefficient over that of the data sheet [1]."""
    ratio: float = number(1.0, "1", low=0.1, high=10.0)
    """Steering ratio over that of the data sheet [1]."""
    mass: float = number(1.0, "1", low=0.5, high=2.0)
    """Mass and moment of inertia over those of the data sheet [1]."""
    text: str | None = field(default=None, repr=False)
    """The text of the file that `name` names; filled in when the part is made."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._keep_file(".toml")
        _ = self.true, plant_kind(self.plant)

    @property
    def nominal(self) -> Vehicle:
        """The car of the data sheet."""
        return vehicle(self.name) if self.text is None else _vehicle(self.text, self.name)

    @property
    def true(self) -> Vehicle:
        """The car as it is."""
        p = self.nominal
        if (self.tyres, self.friction, self.ratio, self.mass) == (1.0, 1.0, 1.0, 1.0):
            return p
        return replace(
            p,
            m=self.mass * p.m,
            i_z=self.mass * p.i_z,
            c_f=self.tyres * p.c_f,
            c_r=self.tyres * p.c_r,
            mu=self.friction * p.mu,
            steer_ratio=self.ratio * p.steer_ratio,
        )

    def steering_in_file(self) -> dict[str, float]:
        """Delay, lag and offset_deg of the file's table [steering]; empty where there is none."""
        if self.text is None or "steering" not in tables_of(self.text, self.name):
            return {}
        motor = steering_of(self.name, text=self.text)
        return {"delay": motor.delay, "lag": motor.lag, "offset_deg": degrees_of(motor.offset)}


@dataclass(frozen=True, kw_only=True)
class Driver(Part):
    """Who sets the speed."""

    table: ClassVar[str] = "driver"
    file: ClassVar[str] = "speed"
    speed: str = "wander"
    """`wander`: between v_min and v_max, slower in bends; `recorded`: as driven on a recorded course; `limit`: as fast
    as a course from a map allows, slower in bends; or a CSV file with the columns s [m] along the course and v [m/s];
    all within v_min and v_max."""
    v_min: float = number(4.0, "m/s", low=0.2, high=40.0)
    """Slowest speed [m/s]; equal to v_max: a steady one."""
    v_max: float = number(7.5, "m/s", low=0.2, high=40.0)
    """Fastest speed [m/s]."""
    a_y_max: float = number(A_Y_MAX, "m/s^2", low=0.1, high=20.0)
    """Lateral acceleration in bends for which a driver who wanders slows down [m/s^2]."""
    text: str | None = field(default=None, repr=False)
    """The text of the file that `speed` names; filled in when the part is made."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.v_min <= self.v_max, self.table, f"v_min = {self.v_min}, v_max = {self.v_max} [m/s]")
        self._keep_file(".csv")
        valid = ("wander", "recorded", "limit")
        words = f"speed {self.speed!r}; valid: {', '.join(valid)}, FILE.csv; a steady one: v_min = v_max"
        require(self.speed in valid or self.text is not None, self.table, words)
        _ = SpeedDriver(v_min=self.v_min, v_max=self.v_max)

    @property
    def wanders(self) -> bool:
        """Does the speed depend on a seed?"""
        return self.speed == "wander" and self.v_min < self.v_max

    def profile(self, course: Course, path: Path) -> tuple[Array, Array]:
        """s [m] along the course and the speed there [m/s], as recorded, as a map allows or from a file."""
        if self.text is not None:
            s, v = profile_in(self.text, self.speed)
            longest = f"s to {s[-1]:g} m, on a course of {path.length:.1f} m; expected s from 0 to the course's length"
            require(s[0] >= 0.0 and s[-1] <= path.length + 1.0, self.speed, longest)
            span = f"{v.min():g} to {v.max():g} m/s, expected v_min to v_max, {self.v_min:g} to {self.v_max:g}"
            within = self.v_min - 1e-9 <= v.min() and v.max() <= self.v_max + 1e-9
            require(within, f"speed {self.speed}", f"{span}; change v_min, v_max")
            return _each_metre(path, s, v)
        if course.text is not None:
            return self._course_speed(course, path)
        require(self.speed == "recorded", f"speed {self.speed}", f"course '{course.name}' has none; a map's file has")
        return recorded_speed(course.name)

    def block(self, course: Course, path: Path, seed: int) -> Block:
        """The driver on that path."""
        if self.speed != "wander":
            s, v = self.profile(course, path)
            v = np.clip(v, self.v_min, self.v_max)
            even = np.linspace(s[0], s[-1], 1 + max(1, math.ceil((s[-1] - s[0]) / 2.0 - 1e-9)))
            speeds = tuple(np.interp(even, s, v).tolist())
            return SpeedProfile(speeds=speeds, spacing=float(even[1] - even[0]), repeat=path.closed)
        driver = SpeedDriver(v_min=self.v_min, v_max=self.v_max, seed=seed)
        return CurveSpeedDriver(path=path, driver=driver, a_y_max=self.a_y_max)

    def _course_speed(self, course: Course, path: Path) -> tuple[Array, Array]:
        """The speed that a course's file holds: as it was driven, or as fast as is allowed.

        `limit`: v_limit, v_max where it is empty, and slower for bends, as a `CurveSpeedDriver` is.
        """
        columns = read_columns(course.text or "", course.name)
        key = {"recorded": "v", "limit": "v_limit"}[self.speed]
        lacks = f"no column {key} [m/s]; columns: {', '.join(columns)}"
        require({"s", key} <= columns.keys(), f"speed {self.speed}: {course.name}", lacks)
        s, v = columns["s"], columns[key]
        if self.speed == "recorded":
            fine = np.isfinite(v).all() and (np.diff(s) > 0.0).all()
            require(fine, course.name, "s rising, v [m/s], expected numbers")
            return _each_metre(path, s, v)
        at = np.linspace(0.0, path.length, max(2, round(path.length)) + 1)
        allowed = v[np.clip(np.searchsorted(s, at[:-1] + 1e-6, side="right") - 1, 0, len(s) - 1)]
        allowed = np.clip(np.where(np.isfinite(allowed), allowed, self.v_max), self.v_min, self.v_max)
        fastest = ceiling(path, self.a_y_max, CurveSpeedDriver.a_x_max, allowed)
        return at, np.append(fastest, fastest[0] if path.closed else fastest[-1])


@dataclass(frozen=True, kw_only=True)
class Steering(Part):
    """From a command to the road wheels: link, actuator and column."""

    table: ClassVar[str] = "steering"
    command: str = _word("angle", "torque")
    """`angle`: a motor that turns the wheel; `torque`: as lane keeping steers most cars (`TorqueSteering`)."""
    lag: float = number(0.12, "s", low=0.0, high=10.0)
    """First-order lag of the actuator [s]."""
    delay: float = number(0.0, "s", low=0.0, high=2.0)
    """Dead time of the actuator [s], a multiple of 0.01."""
    delay_jitter: float = number(0.0, "s", low=0.0, high=0.5)
    """Longest time that a command takes beyond `delay` [s], each its own, a multiple of 0.01."""
    rate_limit_deg: float = number(550.0, "deg/s", low=1.0, high=10_000.0)
    """Fastest steering wheel [deg/s]."""
    offset_deg: float = number(0.0, "deg", low=-90.0, high=90.0)
    """Offset of the steering wheel [deg]."""
    slew: float = number(5.0, "m/s^3", low=0.1, high=1000.0)
    """With `torque`: fastest change of the lateral acceleration [m/s^3]."""
    a_y_limit: float = number(3.0, "m/s^2", low=0.1, high=100.0)
    """With `torque`: largest lateral acceleration [m/s^2]."""
    gain: float = number(1.0, "1", low=0.1, high=10.0)
    """With `torque`: lateral acceleration reached over lateral acceleration commanded [1]; controllers believe 1."""
    play_deg: float = number(0.0, "deg", low=0.0, high=20.0)
    """Free play between steering wheel and road wheels, from end to end, at the steering wheel [deg]."""
    friction_deg: float = number(0.0, "deg", low=0.0, high=20.0)
    """Twist of the column that its friction holds, to either side [deg]; see `SteeringColumn`."""
    dead_band_deg: float = number(0.0, "deg", low=0.0, high=20.0)
    """Change of a command that the motor ignores [deg]."""
    quantum_deg: float = number(0.0, "deg", low=0.0, high=20.0)
    """Resolution of a command [deg]."""
    wheel_zero_deg: float = number(0.0, "deg", low=-20.0, high=20.0)
    """What the steering wheel's sensor reports while the wheel is straight [deg], to controllers and estimators."""

    def link(self, seed: int) -> SteeringLink | None:
        """What happens to a command before the actuator; None for a perfect link. `seed` is that of its delays."""
        if (self.quantum_deg, self.dead_band_deg, self.delay_jitter) == (0.0, 0.0, 0.0):
            return None
        return SteeringLink(
            quantum=radians_of(self.quantum_deg),
            dead_band=radians_of(self.dead_band_deg),
            jitter=self.delay_jitter,
            seed=seed,
        )

    def actuator(self, nominal: Vehicle) -> Block:
        """The motor at the steering wheel, or what steers by torque in its place."""
        common: dict[str, Any] = dict(
            delay=self.delay,
            lag=self.lag,
            rate_limit=radians_of(self.rate_limit_deg),
            offset=radians_of(self.offset_deg),
        )
        if self.command == "torque":
            return TorqueSteering.of(nominal, slew=self.slew, a_y_limit=self.a_y_limit, gain=self.gain, **common)
        return SteeringActuator(limit=nominal.delta_sw_max, **common)

    def column(self) -> SteeringColumn | None:
        """Friction and free play between motor and road wheels; None for a rigid column."""
        if (self.friction_deg, self.play_deg, self.wheel_zero_deg) == (0.0, 0.0, 0.0):
            return None
        return SteeringColumn(
            friction=radians_of(self.friction_deg), play=radians_of(self.play_deg), zero=radians_of(self.wheel_zero_deg)
        )


@dataclass(frozen=True, kw_only=True)
class Sensing(Part):
    """What is measured of the car, and the estimator behind it."""

    table: ClassVar[str] = "sensors"
    kind: str = _word("hard", "no sideslip", "real")
    """Which errors `noise` scales: those of `hard` sensors, with or with `no sideslip`, or of `real` ones
    (`Sensors.real`), which have no sideslip and up to 20 ms of jitter even without noise."""
    noise: float = number(0.0, "1", low=0.0, high=1000.0)
    """Pose and rate noise: 1 is 1 cm and 0.1 deg of drift and 0.2 deg/s of white noise (`Sensors.hard`)."""
    latency: float = number(0.0, "s", low=0.0, high=2.0)
    """Age of what the controllers see [s], a multiple of 0.05."""
    gyro_zero_deg: float = number(0.0, "deg/s", low=-5.0, high=5.0)
    """What the gyro reports while the car does not turn [deg/s]."""
    bias: float = number(0.0, "m", low=-10.0, high=10.0)
    """By how much more than the truth x is reported, as by satellites without correction [m]."""
    estimator: str = _word("none", "vehicle-state", "adaptive-state")
    """What stands between sensors and controllers: `none`; `vehicle-state`, an estimator that is given the sensors'
    noise and the car of the data sheet, needs no sideslip and predicts to now (`VehicleState`); or `adaptive-state`,
    the same with ratio, understeer and zeros as they are found (its `steering`)."""

    @property
    def random(self) -> bool:
        """Do they depend on a seed?"""
        return self.kind == "real" or self.noise > 0.0

    def sensors(self, nominal: Vehicle, seed: int) -> Sensors | None:
        """What is measured; None for the truth."""
        noise, latency = self.noise, self.latency
        biases: Any = dict(r_bias=radians_of(self.gyro_zero_deg), x_bias=self.bias)
        if self.kind == "real":
            return replace(Sensors.real(nominal, seed, noise), latency=latency, **biases)
        sideslip = self.kind == "hard"
        if not any((noise, latency, *biases.values())) and sideslip and self.estimator == "none":
            return None
        rear = None if sideslip else nominal.l_r
        return replace(Sensors.hard(seed, noise), latency=latency, rear=rear, **biases)

    def state_estimator(self, nominal: Vehicle) -> VehicleState | None:
        """The estimator of the car's state; None if controllers see the sensors themselves."""
        if self.estimator == "none":
            return None
        noise: Any = self.sensors(nominal, 0)
        adapts = self.estimator == "adaptive-state"
        return VehicleState.of(
            NonlinearSingleTrack(vehicle=nominal),
            horizon=self.latency + DT,
            position_drift=math.hypot(noise.position_drift, noise.jump),
            psi_drift=noise.psi_drift,
            drift_time=noise.drift_time,
            v_noise=noise.v_noise,
            r_noise=noise.r_noise,
            heading_drift=noise.heading_drift,
            steering=SingleTrackFilter(vehicle=nominal, held=False) if adapts else None,
        )


@dataclass(frozen=True, kw_only=True)
class Disturbances(Part):
    """What pushes the car sideways."""

    table: ClassVar[str] = "disturbances"
    wind: float = number(0.0, "m/s^2", low=-20.0, high=20.0)
    """Lateral acceleration by steady crosswind [m/s^2], acting 0.3 m ahead of the centre of gravity."""
    gust: float = number(0.0, "m/s^2", low=0.0, high=20.0)
    """Standard deviation of the gusts' [m/s^2]."""
    bank_deg: float = number(0.0, "deg", low=-45.0, high=45.0)
    """Bank of the road, + = low on the left [deg]."""

    @property
    def present(self) -> bool:
        """Is there wind or bank?"""
        return (self.wind, self.gust, self.bank_deg) != (0.0, 0.0, 0.0)

    def around(self, car: Any, seed: int) -> Block:
        """The car under these disturbances; `seed` is that of the gusts."""
        if not self.present:
            return car
        bank = G * math.sin(radians_of(self.bank_deg))
        return DisturbedPlant(block=car, wind=self.wind, gust=self.gust, bank=bank, seed=seed)


@dataclass(frozen=True, kw_only=True)
class Knowledge(Part):
    """What controllers believe of car and steering: by default the data sheet and the true delay and lag."""

    table: ClassVar[str] = "knowledge"
    oracle: bool = False
    """Do controllers know the true tyres, friction, ratio and mass, and the steering's offset and gain?"""
    delay: float | None = number(None, "s", low=0.0, high=2.0)
    """The delay that controllers believe, latency included [s]; None: the true one."""
    lag: float | None = number(None, "s", low=0.0, high=10.0)
    """The lag that they believe [s]; None: the true one."""


PARTS: Mapping[str, type[Part]] = {
    part.table: part for part in (Course, Car, Driver, Steering, Sensing, Disturbances, Knowledge)
}
"""The parts of a scenario by the names of their tables."""


def drawn_course(name: str) -> tuple[int, float, float] | None:
    """Seed, length [m] and largest curvature [1/m] of a random course; None for any other name."""
    kind, _, number = name.partition("-")
    return (int(number), *RANDOM_COURSES[kind]) if kind in RANDOM_COURSES and number.isdigit() else None


@lru_cache(maxsize=32)
def _path(name: str, closed: bool | None, text: str | None, v_max: float) -> Path:
    """The course of that name, or in the text of a file."""
    if text is not None:
        return course_of(text, name, closed=closed)
    if name.startswith("iso3888-"):
        return lane_change(int(name[-1]), speed=v_max)
    drawn = drawn_course(name)
    if drawn is None:
        return course(name)
    seed, length, max_kappa = drawn
    return _random_course(seed, length=length, max_kappa=max_kappa, name=name)


_vehicle = lru_cache(maxsize=32)(vehicle_of)
_random_course = lru_cache(maxsize=32)(random_course)


def profile_in(text: str, name: str) -> tuple[Array, Array]:
    """s [m] and v [m/s] in the text of a CSV file; raises ValueError for other columns, or an s that does not rise."""
    columns = read_columns(text, name)
    require({"s", "v"} <= columns.keys(), name, f"columns {', '.join(columns)}; valid: s [m], v [m/s]")
    s, v = columns["s"], columns["v"]
    fine = bool(np.isfinite(s).all() and np.isfinite(v).all() and (np.diff(s) > 0.0).all() and len(s) >= 2)
    require(fine, name, "expected two rows or more of numbers, s [m] rising from row to row")
    return s, v


def _each_metre(path: Path, s: Array, v: Array) -> tuple[Array, Array]:
    at = np.linspace(0.0, path.length, max(2, round(path.length) + 1))
    return at, np.interp(at, s, v, period=path.length if path.closed else None)
