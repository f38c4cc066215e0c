"""The scenario: where and how fast is driven, with which car, what disturbs it, what the controllers are told."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path as FilePath
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import known, require, require_within
from steerkit._support.files import read_text
from steerkit.diagram.block import Block
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.paths.courses import names, recorded_speed
from steerkit.paths.importers.course import check_bends
from steerkit.paths.importers.reading import KINDS, Address, is_road, read_course
from steerkit.paths.path import Path
from steerkit.plants.disturbed_plant import DisturbedPlant
from steerkit.plants.single_track import SingleTrack
from steerkit.plants.speed_driver import CurveSpeedDriver, SpeedDriver, SpeedProfile
from steerkit.plants.steering_actuator import SteeringActuator, steering_in
from steerkit.scenario.assembly import placed
from steerkit.scenario.catalogue import AUTO, RECOVERIES, DesignModel, make_recovery, plant_kind
from steerkit.scenario.parts import (
    actuator_of,
    car_of,
    carried_speed,
    column_of,
    drawn_course,
    estimator_of,
    link_of,
    path_of,
    profile_on,
    sensors_of,
)
from steerkit.task import A_Y_MAX
from steerkit.vehicles import G, Vehicle, vehicle
from steerkit.vehicles.file import tables_of

END_MARGIN = 5.0
"""How far from the ends of an open course a drive begins or ends [m]."""
SPEEDS = ("wander", "recorded", "limit")
REFERENCES = ("front", "cg", "own")
SENSING = ("hard", "no sideslip", "real")
ESTIMATORS = ("none", "vehicle-state", "adaptive-state")
STEERING = ("angle", "torque")
TOLD = ("data sheet", "truth")
_HARD: dict[str, Any] = {"noise": 1.0, "latency": 0.05, "lag": 0.15}
CONDITIONS: Mapping[str, dict[str, Any]] = MappingProxyType(
    {"clean": {}, "hard": _HARD, "real": _HARD | {"sensing": "real"}}
)
"""Named disturbances: fields of a scenario. `hard` is 1 cm of noise, 50 ms of sensor delay, a slower motor; `real` is
that with a noisy speed, no sideslip, late and lost samples, jumps and a heading that wanders
(`DegradedSensors.real`)."""
_RANGES = (  # field, unit, least, largest
    ("v_min", "m/s", 0.2, 40.0),
    ("v_max", "m/s", 0.2, 40.0),
    ("rounds", "1", 1e-3, 1e6),
    ("start", "m", 0.0, 1e6),
    ("lag", "s", 0.0, 10.0),
    ("delay", "s", 0.0, 2.0),
    ("rate_limit_deg", "deg/s", 1.0, 10_000.0),
    ("offset_deg", "deg", -90.0, 90.0),
    ("slew", "m/s^3", 0.1, 1000.0),
    ("a_y_limit", "m/s^2", 0.1, 100.0),
    ("gain", "1", 0.1, 10.0),
    ("a_y_human", "m/s^2", 0.1, 20.0),
    ("play_deg", "deg", 0.0, 20.0),
    ("friction_deg", "deg", 0.0, 20.0),
    ("dead_band_deg", "deg", 0.0, 20.0),
    ("quantum_deg", "deg", 0.0, 20.0),
    ("delay_jitter", "s", 0.0, 0.5),
    ("wheel_zero_deg", "deg", -20.0, 20.0),
    ("gyro_zero_deg", "deg/s", -5.0, 5.0),
    ("tyres", "1", 0.1, 10.0),
    ("friction", "1", 0.1, 10.0),
    ("ratio", "1", 0.1, 10.0),
    ("wind", "m/s^2", -20.0, 20.0),
    ("gust", "m/s^2", 0.0, 20.0),
    ("bank_deg", "deg", -45.0, 45.0),
    ("noise", "1", 0.0, 1000.0),
    ("latency", "s", 0.0, 2.0),
    ("believed_delay", "s", 0.0, 2.0),
    ("believed_lag", "s", 0.0, 10.0),
)
_TIGHTEST = 0.5  # m: no course from a map is tighter; what the scenario's car can do is judged besides
_SLOWEST = 4.0  # m/s: the careful human's speed in the tightest bend of all courses, 5.9 m
_TIME_TO_SPARE = 10.0  # s


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A drive to be made: where, how fast, with which car, and what is wrong with it; for learning, tests and suites.

    Controllers know the nominal car, and the steering's delay and lag unless `believed_delay`, `believed_lag` say
    otherwise.
    A course or a car from a file is read when the scenario is made and kept in `files`, so that a scenario that was
    stored, sent to another machine or carried to another folder stays what it was. Raises ValueError for whatever
    cannot be driven, naming the field, its unit and what is valid.
    """

    name: str = "scenario"
    """What it is called in results and errors."""
    course: str = "paper"
    """Name of a course (`steerkit.paths.courses`); `random-7` and the like, a random course by its seed (500 m, radii
    of 10 m and more), `sweeping-7` one with wide bends (2 km, 100 m and more); or a file: CSV with the columns x, y [m]
    or lat, lon [degrees], or any that `steerkit.paths.importers.read_course` reads, such as
    `town.xodr#road=1,lane=-1`, which is kept as such a CSV. ISO lane changes are as long as v_max asks."""
    closed: bool | None = None
    """Is a course from a file closed? None: as the file says, or as it looks (`steerkit.paths.courses.course_of`)."""
    vehicle: str = "vw-passat"
    """Name of a car (`steerkit.vehicles`); `fleet-17` and the like, a production car by its seed, of which the steering
    delay is not taken (`fleet_scenario` does); or a vehicle file, `my-car.toml`. Its table [steering] is not read here:
    `Scenario.under` does, and so do the command line and the environments."""
    plant: str = "nonlinear"
    """`nonlinear` or `linear` single track; or `package.module:Class`, see `steerkit.scenario.catalogue.plant_kind`."""
    reference: str = "front"
    """Where e is judged, and measured for a learner: at the `front` axle (as Stanley does), at the centre of gravity,
    `cg`, or at the controller's `own` point (the front axle for one that has none)."""
    recovery: str = AUTO
    """Who catches a learned controller: `stanley`, `stanley-delay`, or `auto`: of both the one for what is told; or
    `adaptive`: `stanley-delay` that finds dead time and ratio by itself (`Adaptive`)."""
    speed: str = "wander"
    """`wander`: a human between v_min and v_max, slower in bends (3 m/s^2); `recorded`: as driven on a recorded
    course; `limit`: as fast as a course from a map allows, slower in bends; or a CSV file with the columns s [m] along
    the course and v [m/s]; all within v_min and v_max."""
    v_min: float = 4.0
    """Slowest speed of the human [m/s]; equal to v_max: a steady one."""
    v_max: float = 7.5
    """Fastest speed of the human [m/s]."""
    rounds: float = 1.0
    """Rounds that a test drive takes; an open course is driven without END_MARGIN at either end."""
    a_y_human: float = A_Y_MAX
    """Lateral acceleration in bends for which the wandering human slows down [m/s^2]."""
    steering: str = "angle"
    """`angle`: a motor that turns the wheel; `torque`: as lane keeping steers most cars (`TorqueSteering`)."""
    start: float = 0.0
    """Where on the course a drive begins [m]: at rest relative to it, so that a tight bend there is no fair start."""
    lag: float = 0.12
    """First-order lag of the steering actuator [s]."""
    delay: float = 0.0
    """Pure delay of the steering actuator [s], a multiple of 0.01."""
    rate_limit_deg: float = 550.0
    """Fastest steering wheel [deg/s]."""
    offset_deg: float = 0.0
    """Offset of the steering wheel [deg]."""
    slew: float = 5.0
    """Steered by torque: fastest change of the lateral acceleration [m/s^3]."""
    a_y_limit: float = 3.0
    """Steered by torque: largest lateral acceleration [m/s^2]."""
    gain: float = 1.0
    """Steered by torque: lateral acceleration reached over what was asked for [1]; controllers are told 1."""
    play_deg: float = 0.0
    """Free play between steering wheel and road wheels, from end to end, at the steering wheel [deg]."""
    friction_deg: float = 0.0
    """Twist of the column that its friction holds, to either side [deg]; see `SteeringColumn`."""
    dead_band_deg: float = 0.0
    """Change of a command that the motor leaves [deg]."""
    quantum_deg: float = 0.0
    """Resolution of a command [deg]."""
    wheel_zero_deg: float = 0.0
    """What the steering wheel's sensor shows while that is straight [deg]; controllers and estimators see it."""
    gyro_zero_deg: float = 0.0
    """What the gyro shows while the car does not turn [deg/s]."""
    delay_jitter: float = 0.0
    """Longest time that a command takes beyond `delay` [s], each its own, a multiple of 0.01."""
    tyres: float = 1.0
    """Cornering stiffness over the nominal one [1]."""
    friction: float = 1.0
    """Friction coefficient over the nominal one [1]."""
    ratio: float = 1.0
    """Steering ratio over the nominal one [1]."""
    wind: float = 0.0
    """Lateral acceleration by steady crosswind [m/s^2], acting 0.3 m ahead of the centre of gravity."""
    gust: float = 0.0
    """Standard deviation of the gusts' [m/s^2]."""
    bank_deg: float = 0.0
    """Bank of the road, + = low on the left [deg]."""
    noise: float = 0.0
    """Pose and rate noise: 1 is 1 cm and 0.1 deg of drift and 0.2 deg/s of white noise (`Sensors.hard`)."""
    sensing: str = "hard"
    """Which errors `noise` scales: those of `hard` sensors, with or with `no sideslip`, or of `real` ones
    (`DegradedSensors.real`), which have no sideslip and up to 20 ms of jitter even without noise."""
    estimator: str = "none"
    """What stands between sensors and controllers: `none`, or `vehicle-state`, an estimator that is given the sensors'
    data sheet and the nominal car, needs no sideslip and predicts to now (`VehicleState`); or `adaptive-state`, the
    same with ratio, understeer and zeros as they are found (its `steering`)."""
    latency: float = 0.0
    """Age of what the controllers see [s], a multiple of 0.05."""
    told: str = "data sheet"
    """What controllers are told of the car: the nominal one, as its `data sheet` has it; or the `truth`: tyres,
    friction and ratio, and the steering's offset and gain."""
    believed_delay: float | None = None
    """What controllers that ask are told of the delay, latency included [s]; None: the truth."""
    believed_lag: float | None = None
    """The same of the lag [s]."""
    files: tuple[tuple[str, str], ...] = ()
    """Name and text of every file that course and vehicle name; filled in when the scenario is made."""

    def __post_init__(self) -> None:
        where = f"scenario '{self.name}'"
        require(isinstance(self.name, str) and "--" not in self.name, where, "the name holds '--', which parts names")
        for name, unit, least, largest in _RANGES:
            value = getattr(self, name)
            if value is None and name.startswith("believed_"):
                continue
            number = isinstance(value, int | float) and not isinstance(value, bool)
            require(number, where, f"{name} = {value!r}, expected a number [{unit}]")
            require_within(where, name, value, unit, least, largest)
            object.__setattr__(self, name, float(value))
        require(self.v_min <= self.v_max, where, f"v_min = {self.v_min}, v_max = {self.v_max} [m/s]")
        profile = isinstance(self.speed, str) and self.speed.endswith(".csv")
        speeds = f"speed {self.speed!r}; valid: {', '.join(SPEEDS)}, FILE.csv; a steady one: v_min = v_max"
        require(self.speed in SPEEDS or profile, where, speeds)
        for name, valid in (
            ("reference", REFERENCES),
            ("recovery", RECOVERIES),
            ("sensing", SENSING),
            ("estimator", ESTIMATORS),
            ("steering", STEERING),
            ("told", TOLD),
        ):
            require(getattr(self, name) in valid, where, f"{name} {getattr(self, name)!r}; valid: {', '.join(valid)}")
        dead = self.believed_dead_time
        require(dead <= 2.0, where, f"delay and latency add up to {dead:g} [s], expected at most 2")
        self._keep_files(where)
        try:
            self._check_parts()
        except ValueError as error:
            text = str(error)
            raise ValueError(text if text.startswith(where) else f"{where}: {text}") from error

    def _keep_files(self, where: str) -> None:
        """Read the files that course, vehicle and speed name, and keep them under their names without folders."""
        kept = {str(name): str(text) for name, text in self.files}
        texts = {}
        for field, suffix in (("course", ".csv"), ("vehicle", ".toml"), ("speed", ".csv")):
            given = str(getattr(self, field))
            road = field == "course" and given not in kept and is_road(given)
            if not (given.endswith(suffix) or road):
                continue
            file = FilePath(f"{Address.parsed(given).name}.csv" if road else given)
            try:
                if road:
                    texts[file.name] = read_course(given, tightest=_TIGHTEST, closed=self.closed).text()
                else:
                    texts[file.name] = kept[given] if given in kept else read_text(file, f"{where}: {field}")
            except OSError as error:
                raise ValueError(f"{where}: {field} {given} cannot be read ({error.strerror})") from error
            require(field != "speed" or self.course != file.name, where, f"course and speed are both {file.name}")
            object.__setattr__(self, field, file.name)
        object.__setattr__(self, "files", tuple(sorted(texts.items())))

    def _check_parts(self) -> None:
        """Make what can be made at once: each part checks itself."""
        valid = [*names(), "random-7", "sweeping-7"]
        if self._text(self.course) is not None:
            check_bends(self.path(), self.nominal.tightest)
        elif drawn_course(self.course) is None:
            known(self.course, valid, "course", also=f"FILE{', '.join(KINDS)}")
        chosen = self.closed is None or self._text(self.course) is not None
        require(chosen, f"closed = {self.closed}", "only a course from a file is told so")
        if self.start:
            require_within("scenario", "start", self.start, "m", 0.0, self.path().length, "the course's length")
        if self.speed in ("recorded", "limit"):
            self._profile()
        elif self.speed != "wander":
            _, v = self._profile()
            told = f"{v.min():g} to {v.max():g} m/s, expected v_min to v_max, {self.v_min:g} to {self.v_max:g}"
            within = self.v_min - 1e-9 <= v.min() and v.max() <= self.v_max + 1e-9
            require(within, f"speed {self.speed}", f"{told}; change v_min, v_max")
        car = plant_kind(self.plant)(vehicle=self.true_vehicle, v0=self.v_min)  # type: ignore[call-arg]
        pushes = isinstance(car, SingleTrack) or not self.pushed
        require(pushes, "wind, gust, bank_deg", f"only single-track cars are pushed, not '{self.plant}'")
        _ = self.link(), self.actuator(), self.column(), self.sensors(0), self.estimator_block()
        _ = SpeedDriver(v_min=self.v_min, v_max=self.v_max)

    @classmethod
    def under(cls, conditions: str = "clean", **changes: Any) -> Scenario:
        """The scenario of the named conditions, `clean` or `hard`, with these fields.

        Where `vehicle` names a file with a table [steering], delay, lag and offset_deg are taken from it, also instead
        of the conditions' lag, but for those given in `changes`.
        Raises ValueError for unknown conditions or fields, with the valid ones.
        """
        disturbed = CONDITIONS[known(conditions, CONDITIONS, "conditions")]
        valid = [field.name for field in fields(cls)]
        for key in changes:
            require(key in valid, "scenario", f"no field '{key}'; valid: {', '.join(valid)}")
        steering = cls(**(disturbed | changes)).steering_told()
        return cls(**(disturbed | steering | changes))

    # ---- what it says ---------------------------------------------------------------------------------------

    def steering_told(self) -> dict[str, float]:
        """Delay, lag and offset_deg of the table [steering] of the vehicle's file; empty where there is none."""
        text = self._text(self.vehicle)
        if text is None or "steering" not in tables_of(text, self.vehicle):
            return {}
        motor = steering_in(text, self.vehicle)
        return {"delay": motor.delay, "lag": motor.lag, "offset_deg": degrees_of(motor.offset)}

    def _text(self, name: str) -> str | None:
        return dict(self.files).get(name)

    @property
    def random(self) -> bool:
        """Does anything depend on the seed (but for a learner's net)?"""
        wanders = self.speed == "wander" and self.v_min < self.v_max
        return wanders or self.sensing == "real" or max(self.noise, self.gust, self.delay_jitter) > 0.0

    @property
    def pushed(self) -> bool:
        """Is there wind or bank?"""
        return (self.wind, self.gust, self.bank_deg) != (0.0, 0.0, 0.0)

    @property
    def nominal(self) -> Vehicle:
        """The car as the controllers know it."""
        text = self._text(self.vehicle)
        return vehicle(self.vehicle) if text is None else car_of(text, self.vehicle)

    @property
    def true_vehicle(self) -> Vehicle:
        """The car as it is."""
        p = self.nominal
        if (self.tyres, self.friction, self.ratio) == (1.0, 1.0, 1.0):
            return p
        return replace(
            p,
            c_f=self.tyres * p.c_f,
            c_r=self.tyres * p.c_r,
            mu=self.friction * p.mu,
            steer_ratio=self.ratio * p.steer_ratio,
        )

    @property
    def ahead(self) -> float:
        """The reference point's distance ahead of the centre of gravity [m], for a controller without its own."""
        return 0.0 if self.reference == "cg" else float(self.nominal.l_f)

    @property
    def believed_dead_time(self) -> float:
        """Delay of the steering and age of what is seen, as controllers are told [s]; the mean of what varies.

        Behind an estimator nothing that is seen is old.
        """
        age = self.latency if self.estimator == "none" else 0.0
        dead = self.delay + age + 0.5 * self.delay_jitter
        return dead if self.believed_delay is None else self.believed_delay

    def path(self) -> Path:
        """The course's path."""
        return path_of(self.course, self.closed, self._text(self.course), self.v_max)

    @property
    def round_length(self) -> float:
        """What counts as a round [m]: an open course is driven without END_MARGIN at either end."""
        path = self.path()
        return path.length - (0.0 if path.closed else 2.0 * END_MARGIN)

    @property
    def length(self) -> float:
        """How far a test drive goes [m]."""
        return self.rounds * self.round_length

    def _profile(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """s [m] along the course, and the speed there [m/s], as recorded or from a file."""
        text, course = self._text(self.speed), self._text(self.course)
        if text is not None:
            return profile_on(self.path(), text, self.speed)
        if course is not None:
            return carried_speed(self, course)
        require(self.speed == "recorded", f"speed {self.speed}", f"course '{self.course}' has none; a map's file has")
        return recorded_speed(self.course)

    @property
    def seconds(self) -> float:
        """How long that takes the slowest human, and some more [s]."""
        if self.speed != "wander":
            s, v = self._profile()
            pace = 1.0 / np.clip(v, self.v_min, self.v_max)
            return math.ceil(self.rounds * float(np.trapezoid(pace, s)) + _TIME_TO_SPARE)
        return math.ceil(self.length / min(self.v_min, _SLOWEST) + _TIME_TO_SPARE)

    def design_model(self, *, clock: Callable[[], float] | None = None) -> DesignModel:
        """What controllers are told: the nominal car or the true one, as `told` says, and the steering's delay and lag.

        clock: seconds, for the times that predictive controllers show; None: no time is taken.
        """
        truth = self.told == "truth"
        torque, gain = self.steering == "torque", self.gain if truth else 1.0
        return DesignModel(
            vehicle=self.true_vehicle if truth else self.nominal,
            path=self.path(),
            delay=self.believed_dead_time,
            lag=self.lag if self.believed_lag is None else self.believed_lag,
            hold=SteeringActuator.dt,
            rate_limit=radians_of(self.rate_limit_deg),
            slew=gain * self.slew if torque else None,
            a_y_limit=gain * self.a_y_limit if torque else None,
            offset=radians_of(self.offset_deg) if truth else 0.0,
            gain=gain if torque else 1.0,
            clock=clock,
        )

    # ---- what it is made of ---------------------------------------------------------------------------------

    def car(self, path: Path, s: float = 0.0, seed: int = 0) -> Block:
        """The plant, on the path at arc length s [m]; `seed` is that of the gusts."""
        kind = plant_kind(self.plant)
        car: Any = placed(kind(vehicle=self.true_vehicle, v0=self.v_min), path, s=s)  # type: ignore[call-arg]
        if not self.pushed:
            return car
        bank = G * math.sin(radians_of(self.bank_deg))
        return DisturbedPlant(block=car, wind=self.wind, gust=self.gust, bank=bank, seed=seed)

    def driver(self, seed: int) -> Block:
        """The human who sets the speed, and slows down for bends."""
        if self.speed != "wander":
            s, v = self._profile()
            v, closed = np.clip(v, self.v_min, self.v_max), self.path().closed
            return SpeedProfile.from_samples(s, v, spacing=2.0, repeat=closed)
        driver = SpeedDriver(v_min=self.v_min, v_max=self.v_max, seed=seed)
        return CurveSpeedDriver(path=self.path(), driver=driver, a_y_max=self.a_y_human)

    def link(self, seed: int = 0) -> Block | None:
        """The way of a command to the motor; None if it is perfect. `seed` is that of its delays."""
        return link_of(self, seed)

    def actuator(self) -> Block:
        """The motor at the steering wheel."""
        return actuator_of(self)

    def column(self) -> Block | None:
        """What is between the motor and the road wheels; None if it is rigid."""
        return column_of(self)

    def sensors(self, seed: int) -> Block | None:
        """What the controllers see; None for the truth."""
        return sensors_of(self, seed)

    def estimator_block(self) -> Block | None:
        """What makes of that where the car is; None if controllers see the sensors themselves."""
        return estimator_of(self)

    def recovery_controller(self) -> Block:
        """The analytic controller that catches a learned one."""
        return make_recovery(self.recovery, self.design_model())
