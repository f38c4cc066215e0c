"""Where a learner drives: course, car, driver, actuator, sensors, recovery, as one small configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from steerkit.assembly import placed
from steerkit.block import Block
from steerkit.catalogue import PLANTS, Belief, make_recovery
from steerkit.courses import course, random_course
from steerkit.errors import require
from steerkit.path import Path
from steerkit.plants.careful_driver import CarefulDriver
from steerkit.plants.human_driver import HumanDriver
from steerkit.plants.sensors import Sensors
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.units import radians_of
from steerkit.vehicles import Vehicle, vehicle

END_MARGIN = 5.0
"""How far from the end of an open course a learner is carried back to its start [m]."""


@dataclass(frozen=True, kw_only=True)
class World:
    """Course, car and disturbances. Two named conditions follow the design's measurements: `clean` and `hard`."""

    course: str = "paper"
    """Name of a course: see `steerkit.courses`; or `random-7` and the like, a random course by its seed: 500 m, radii
    of 10 m and more."""
    vehicle_name: str = "vw-passat"
    """Name of a car: see `steerkit.vehicles`."""
    plant: str = "nonlinear"
    """`nonlinear` or `linear` single-track."""
    reference: str = "front"
    """Where e is measured, learned and judged: `front` axle (as Stanley does) or centre of gravity, `cg`."""
    lag: float = 0.12
    """First-order lag of the steering actuator [s]."""
    delay: float = 0.0
    """Pure delay of the steering actuator [s]."""
    rate_limit_deg: float = 550.0
    """Fastest steering wheel [deg/s]."""
    noise: bool = False
    """Sensors with 1 cm correlated pose noise, rate noise and 50 ms latency instead of the truth."""
    v_min: float = 4.0
    """Slowest speed of the human driver [m/s]."""
    v_max: float = 7.5
    """Fastest speed of the human driver [m/s]."""

    def __post_init__(self) -> None:
        require(self.plant in PLANTS, "World", f"plant '{self.plant}'; valid: {', '.join(PLANTS)}")
        require(self.reference in ("front", "cg"), "World", f"reference '{self.reference}'; valid: front, cg")
        require(0.0 < self.v_min <= self.v_max, "World", f"v_min = {self.v_min}, v_max = {self.v_max} m/s")

    @classmethod
    def under(cls, conditions: str, *, course: str = "paper") -> World:
        """The world of the named conditions: `clean`, or `hard` (noise, 50 ms sensor delay, 0.15 s lag)."""
        known = {"clean": cls(), "hard": cls(lag=0.15, noise=True)}
        if conditions not in known:
            raise ValueError(f"conditions '{conditions}' are not known; valid: {', '.join(known)}")
        return replace(known[conditions], course=course)

    @property
    def vehicle(self) -> Vehicle:
        """The car's parameters."""
        return vehicle(self.vehicle_name)

    @property
    def ahead(self) -> float:
        """The reference point's distance ahead of the centre of gravity [m]."""
        return self.vehicle.l_f if self.reference == "front" else 0.0

    @property
    def dead_time(self) -> float:
        """Pure delay from what a controller does to what it sees of that [s]: actuator and sensors."""
        sensors = self.sensors(0)
        return self.delay + (0.0 if sensors is None else sensors.latency)

    def path(self) -> Path:
        """The course's path."""
        kind, _, number = self.course.partition("-")
        return random_course(int(number)) if kind == "random" and number.isdigit() else course(self.course)

    @property
    def round_length(self) -> float:
        """What counts as a round [m]: an open course is driven without END_MARGIN at either end."""
        path = self.path()
        return path.length - (0.0 if path.closed else 2.0 * END_MARGIN)

    def car(self, path: Path, s: float = 0.0) -> Block:
        """The plant, on the path at arc length s [m]."""
        return placed(PLANTS[self.plant](vehicle=self.vehicle, v0=self.v_min), path, s=s)

    def driver(self, seed: int) -> Block:
        """The human who sets the speed, and slows down for bends."""
        return CarefulDriver(path=self.path(), driver=HumanDriver(v_min=self.v_min, v_max=self.v_max, seed=seed))

    def actuator(self) -> SteeringActuator:
        """The motor at the steering wheel."""
        rate_limit, limit = radians_of(self.rate_limit_deg), self.vehicle.delta_sw_max
        return SteeringActuator(lag=self.lag, delay=self.delay, rate_limit=rate_limit, limit=limit)

    def sensors(self, seed: int) -> Sensors | None:
        """What the controllers see; None for the truth."""
        return Sensors.hard(seed) if self.noise else None

    def belief(self, *, clock: Callable[[], float] | None = None) -> Belief:
        """What controllers are told: here the truth. clock: for the times that predictive ones show."""
        return Belief(
            vehicle=self.vehicle,
            path=self.path(),
            delay=self.dead_time,
            lag=self.lag,
            hold=self.actuator().dt,
            rate_limit=radians_of(self.rate_limit_deg),
            clock=clock,
        )

    def recovery(self) -> Block:
        """The analytic controller that catches the car."""
        return make_recovery("stanley", self.belief())
