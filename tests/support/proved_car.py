"""Manoeuvres on a simulated car in one process: car, server core, and the human who consents or does not."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from steerkit.car.config import CarConfig, load, shipped
from steerkit.car.production.platforms import platform
from steerkit.car.protocol import Snapshot
from steerkit.car.prove import Proving
from steerkit.car.state_machine import Mode, Order
from steerkit.diagram import realtime
from steerkit.paths.courses import bends
from steerkit.paths.path import Path as Course
from steerkit.proving.manoeuvre import Manoeuvre, manoeuvre
from tests.support.car_world import World

V = 8.0
KIT = "dbw-kit.toml"


@cache
def oval(straight: float = 400.0, radius: float = 40.0) -> Course:
    """A closed course with two long straights [m]."""
    ramp = 0.4 * radius
    return bends([(straight, 90.0, radius, ramp), (10.0, 90.0, radius, ramp)] * 2, name="oval")


def config_on(course: Course, folder: Path, name: str = KIT) -> CarConfig:
    """The file of a kit or of a production car on that course, in a folder so that a recording holds all of it."""
    course.to_csv(folder / "course.csv")
    text = shipped(name if name == KIT else "production-car.toml").read_text(encoding="utf-8")
    for known in ("paper", "highway"):
        text = text.replace(f'[course]\nname = "{known}"', '[course]\nfile = "course.csv"\nclosed = true')
    (folder / "car.toml").write_text(text.replace("TESLA_MODEL_3", name), encoding="utf-8")
    return load(str(folder / "car.toml"))


def small(name: str = "step-steer", v: float = V, a_y: float = 0.15, **more: Any) -> Manoeuvre:
    """A shipped manoeuvre at a size that fits the kit's limits."""
    made: Manoeuvre = manoeuvre(name).at(v, a_y)
    return replace(made, **{"conditions": replace(made.conditions, settle=1.0)} | more)


class ProvingWorld(World):
    """The car server's core, a simulated car that drives at the manoeuvre's speed, and the runs.

    A production car is behind its port, and opendbc's safety code judges each of its frames.
    """

    def __init__(self, wanted: Manoeuvre, config: CarConfig, *, s: float = 20.0, **more: Any):
        self.proving: Proving | None = None
        self.seen: list[Snapshot] = []
        how = {key: more.pop(key) for key in ("base", "minutes", "yes") if key in more}
        v = more.pop("v", (wanted.conditions.v - 0.1, wanted.conditions.v + 0.1))
        super().__init__(s=s, v=v, config=config, **more)
        self.due = math.inf  # the human drives alone
        self.until(1.5)
        link: Any = self
        self.proving = Proving(config=config, link=link, manoeuvre=wanted, **how)
        resting = self.proving.follow.resting
        self.run = realtime.Run(resting, resting.init(), realtime.Timing(period=resting.dt))
        self.over = False
        self.due = self.t + 0.05
        if how.get("yes"):
            self.order(Order.ARM)  # as the panel does

    def simulated(self, config: CarConfig, **told: Any) -> Any:
        if not config.port:
            return super().simulated(config, **told)
        from benchmarks.judges.opendbc_safety import SafetyJudge
        from benchmarks.run.production import PortedCar

        return PortedCar(config, judge=SafetyJudge(platform(config.port)), **told)

    @property
    def runs(self) -> list[dict[str, Any]]:
        assert self.proving is not None
        return self.proving.runs

    @property
    def status(self) -> str:
        assert self.proving is not None
        return self.proving.status()

    def stepped(self, run: realtime.Run) -> None:
        if self.proving is None:
            return super().stepped(run)
        assert self.last is not None
        self.seen.append(self.last)
        self.over = self.over or self.proving.step(run)
        return None

    def engage(self) -> None:
        """As the operator does."""
        if self.mode is Mode.OFF:
            self.order(Order.ARM, then=0.3)
        if self.mode in (Mode.FAULT, Mode.OVERRIDE):
            self.order(Order.ACKNOWLEDGE, then=0.3)
        assert self.mode is Mode.READY, self.core.obstacles()
        self.order(Order.ENGAGE, then=0.1)
        assert self.mode is Mode.ENGAGED, self.core.obstacles()

    def go_on(self, until: Any, longest: float = 200.0) -> None:
        """Drive until that is true."""
        end = self.t + longest
        while not until():
            assert self.t < end, (self.status, self.mode, self.core.machine.cause, self.runs[-3:])
            self.until(self.t + 0.05)

    def begin(self) -> dict[str, Any]:
        """Engage, consent, and wait for the run."""
        assert self.proving is not None
        proving, before = self.proving, len(self.runs)
        if self.mode is not Mode.ENGAGED:
            self.engage()
        while len(self.runs) == before:
            self.go_on(lambda: "READY" in self.status or len(self.runs) > before)
            proving.consent()
            self.until(self.t + 0.05)
        return self.runs[-1]
