"""What is driven: course, speed, plant and disturbances, as one frozen configuration a scenario."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.peers.commonroad import CommonRoadMultiBody
from steerkit.assembly import placed, steering_loop
from steerkit.block import Block
from steerkit.catalogue import PLANTS, Belief, make_recovery
from steerkit.controllers.network_policy import PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.courses import course, lane_change, names, random_course, recorded_speed
from steerkit.errors import require
from steerkit.loop import Loop
from steerkit.path import Path
from steerkit.plants.careful_driver import CarefulDriver
from steerkit.plants.human_driver import HumanDriver, SpeedProfile
from steerkit.plants.pushed import Pushed
from steerkit.plants.sensors import Sensors
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.world import END_MARGIN
from steerkit.units import radians_of
from steerkit.vehicles import G, Vehicle, vehicle

MULTI_BODY = "commonroad-mb"
SPEEDS = ("wander", "recorded")
_SLOWEST = 4.0  # m/s: the careful driver's speed in the tightest bend of all courses, 5.9 m
_TIME_TO_SPARE = 10.0  # s


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A drive: where, how fast, with which car, and what is wrong with it. Controllers know the nominal car."""

    name: str
    """What it is called in results."""
    course: str = "paper"
    """Name of a course (`steerkit.courses`), `random-7` and the like; lane changes are as long as v_max asks."""
    speed: str = "wander"
    """`wander`: a human between v_min and v_max, slower in bends (3 m/s^2); `recorded`: as driven on the recorded
    course, within v_min and v_max."""
    v_min: float = 4.0
    """Slowest speed [m/s]; equal to v_max: a steady one."""
    v_max: float = 7.5
    """Fastest speed [m/s]."""
    rounds: float = 1.0
    """Rounds to drive; an open course is driven without 5 m at either end."""
    plant: str = "nonlinear"
    """`nonlinear`, `linear` or `commonroad-mb`."""
    vehicle_name: str = "vw-passat"
    """The car; `commonroad-mb` has `bmw-320i` and `ford-escort`."""
    delay: float = 0.0
    """Pure delay of the steering [s]."""
    lag: float = 0.12
    """Time constant of the steering [s]."""
    told_delay: float | None = None
    """What controllers that ask are told of the delay, latency included [s]; None: the truth."""
    told_lag: float | None = None
    """The same of the lag [s]."""
    rate_limit_deg: float = 550.0
    """Fastest steering wheel [deg/s]."""
    tyres: float = 1.0
    """Cornering stiffness over the nominal one [1]."""
    friction: float = 1.0
    """Friction coefficient over the nominal one [1]."""
    ratio: float = 1.0
    """Steering ratio over the nominal one [1]."""
    offset_deg: float = 0.0
    """Offset of the steering wheel [deg]."""
    wind: float = 0.0
    """Lateral acceleration by steady crosswind [m/s^2], acting 0.3 m ahead of the centre of gravity."""
    gust: float = 0.0
    """Standard deviation of the gusts' [m/s^2]."""
    bank_deg: float = 0.0
    """Bank of the road, + = low on the left [deg]."""
    noise: float = 0.0
    """Pose and rate noise: 1 is 1 cm and 0.1 deg of drift and 0.2 deg/s of white noise (`Sensors.hard`)."""
    latency: float = 0.0
    """Age of what the controllers see [s]."""

    def __post_init__(self) -> None:
        where = f"scenario '{self.name}'"
        known = (*PLANTS, MULTI_BODY)
        require(self.plant in known, where, f"plant '{self.plant}'; valid: {', '.join(known)}")
        require(self.speed in SPEEDS, where, f"speed '{self.speed}'; valid: {', '.join(SPEEDS)}")
        require(0.0 < self.v_min <= self.v_max, where, f"v_min = {self.v_min}, v_max = {self.v_max} [m/s]")
        require(self.rounds > 0.0, where, f"rounds = {self.rounds}, expected > 0")
        for name in ("tyres", "friction", "ratio"):
            require(
                0.1 <= getattr(self, name) <= 10.0, where, f"{name} = {getattr(self, name)} [1], expected 0.1 to 10"
            )
        require(self.noise >= 0.0 and self.gust >= 0.0, where, f"noise {self.noise}, gust {self.gust}, expected >= 0")
        require("--" not in self.name, where, "the name holds '--', which parts names in results")
        changed = (self.tyres, self.friction, self.ratio) != (1.0, 1.0, 1.0) or self.pushed
        require(self.plant != MULTI_BODY or not changed, where, "the multi-body car has no other tyres, ratio or wind")
        if not (self.course.startswith("random-") or self.course in names()):
            course(self.course)  # raises with the nearest name

    @property
    def random(self) -> bool:
        """Does anything depend on the seed (but for a learner's net)?"""
        wanders = self.speed == "wander" and self.v_min < self.v_max
        return wanders or self.noise > 0.0 or self.gust > 0.0

    @property
    def pushed(self) -> bool:
        """Is there wind or bank?"""
        return (self.wind, self.gust, self.bank_deg) != (0.0, 0.0, 0.0)

    @property
    def nominal(self) -> Vehicle:
        """The car as the controllers know it."""
        return vehicle(self.vehicle_name)

    @property
    def true_vehicle(self) -> Vehicle:
        """The car as it is."""
        p = self.nominal
        return replace(
            p,
            c_f=self.tyres * p.c_f,
            c_r=self.tyres * p.c_r,
            mu=self.friction * p.mu,
            steer_ratio=self.ratio * p.steer_ratio,
        )

    def path(self) -> Path:
        """The course's path."""
        if self.course.startswith("iso3888-"):
            return lane_change(int(self.course[-1]), speed=self.v_max)
        kind, _, number = self.course.partition("-")
        return random_course(int(number)) if kind == "random" and number.isdigit() else course(self.course)

    def length(self, path: Path) -> float:
        """How far is driven [m]."""
        return self.rounds * (path.length - (0.0 if path.closed else 2.0 * END_MARGIN))

    def seconds(self, path: Path) -> float:
        """How long that takes the slowest driver, and some more [s]."""
        if self.speed == "recorded":
            s, v = recorded_speed(self.course)
            pace = 1.0 / np.clip(v, self.v_min, self.v_max)
            return math.ceil(self.rounds * float(np.trapezoid(pace, s)) + _TIME_TO_SPARE)
        return math.ceil(self.length(path) / min(self.v_min, _SLOWEST) + _TIME_TO_SPARE)

    @property
    def told_dead_time(self) -> float:
        """Delay of the steering and age of what is seen, as controllers that ask are told [s]."""
        return self.delay + self.latency if self.told_delay is None else self.told_delay

    def belief(self, path: Path) -> Belief:
        """What controllers are told: the nominal car, and the steering as it is or as the scenario says."""
        return Belief(
            vehicle=self.nominal,
            path=path,
            delay=self.told_dead_time,
            lag=self.lag if self.told_lag is None else self.told_lag,
            hold=SteeringActuator.dt,
            rate_limit=radians_of(self.rate_limit_deg),
        )

    def loop(self, path: Path, controller: Block, *, doe: Block | None = None, seed: int = 0) -> Loop:
        """The loop of the drive; a learned controller (with its doe) is caught by Stanley."""
        learned = isinstance(controller, NfqPolicy | PolicyBlock)
        steers = replace(controller, ready_from=0.0) if isinstance(controller, NfqPolicy) else controller
        return steering_loop(
            car=self._car(path, seed),
            path=path,
            driver=self._driver(path, seed),
            controller=steers,
            doe=doe,
            recovery=make_recovery("stanley", self.belief(path)) if learned else None,
            actuator=SteeringActuator(
                delay=self.delay,
                lag=self.lag,
                rate_limit=radians_of(self.rate_limit_deg),
                offset=radians_of(self.offset_deg),
            ),
            sensors=self._sensors(seed),
            reference=self.reference(controller),
        )

    def reference(self, controller: Block) -> float:
        """Where e is judged: where the controller has it measured, else the front axle [m ahead of the c. of g.]."""
        asks = getattr(controller, "reference", None) if "reference" in vars(controller) else None
        if asks is None and isinstance(controller, NfqPolicy | PolicyBlock):
            return float(self.nominal.l_f)
        return 0.0 if asks is None else float(asks)

    def _car(self, path: Path, seed: int) -> Block:
        s = 0.0 if path.closed else END_MARGIN
        if self.plant == MULTI_BODY:
            return placed(CommonRoadMultiBody(name=self.vehicle_name, v0=self.v_min), path, s=s)
        car = placed(PLANTS[self.plant](vehicle=self.true_vehicle, v0=self.v_min), path, s=s)
        if not self.pushed:
            return car
        bank = G * math.sin(radians_of(self.bank_deg))
        return Pushed(block=car, wind=self.wind, gust=self.gust, bank=bank, seed=seed)

    def _driver(self, path: Path, seed: int) -> Block:
        if self.speed == "recorded":
            s, v = recorded_speed(self.course)
            return SpeedProfile.from_samples(s, np.clip(v, self.v_min, self.v_max), spacing=2.0)
        return CarefulDriver(path=path, driver=HumanDriver(v_min=self.v_min, v_max=self.v_max, seed=seed))

    def _sensors(self, seed: int) -> Block | None:
        if self.noise == 0.0 and self.latency == 0.0:
            return None
        full = Sensors.hard(seed)
        return replace(
            full,
            position_drift=self.noise * full.position_drift,
            psi_drift=self.noise * full.psi_drift,
            r_noise=self.noise * full.r_noise,
            latency=self.latency,
        )


OPEN = {
    "tyres": ("vehicle.c_f", "vehicle.c_r"),
    "friction": ("vehicle.mu",),
    "ratio": ("vehicle.steer_ratio",),
    "offset_deg": ("actuator.offset",),
    "lag": ("actuator.lag",),
    "wind": ("car.wind",),
    "gust": ("car.gust",),
    "bank_deg": ("car.bank",),
}
"""Fields that a compiled drive leaves open, so that one program serves many scenarios, and what they are in a loop."""


def shape(scenario: Scenario) -> Scenario:
    """What a compiled drive depends on: the scenario with all that is left open put to one value."""
    if scenario.plant == MULTI_BODY:
        return replace(scenario, name="shape")
    lag = scenario.lag if scenario.told_lag is None else scenario.told_lag
    plain = dict(
        name="shape",
        told_delay=scenario.told_dead_time,
        told_lag=lag,
        tyres=1.0,
        friction=1.0,
        ratio=1.0,
        offset_deg=0.0,
        lag=0.1,
    )
    if scenario.pushed:
        plain |= dict(wind=0.1, gust=0.1, bank_deg=0.1)
    if "v_min" in _open_speeds(scenario):
        plain |= dict(v_min=4.0, v_max=8.0)
    return replace(scenario, **plain)  # type: ignore[arg-type]


def open_parameters(scenario: Scenario) -> tuple[str, ...]:
    """Names of the loop's parameters that are left open."""
    if scenario.plant == MULTI_BODY:
        return ()
    car = "car.block." if scenario.pushed else "car."
    names = [car + name if name.startswith("vehicle.") else name for fields in OPEN.values() for name in fields]
    kept = [name for name in names if scenario.pushed or name not in ("car.wind", "car.gust", "car.bank")]
    return (*kept, *_open_speeds(scenario).values())


def _open_speeds(scenario: Scenario) -> dict[str, str]:
    """The driver's speeds, unless the course's own length or a record hangs on them."""
    if scenario.speed == "recorded" or scenario.course.startswith("iso3888-"):
        return {}
    return {"v_min": "driver.driver.v_min", "v_max": "driver.driver.v_max"}
