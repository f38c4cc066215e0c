"""A calibration in one process: a car whose true numbers are unknown to it, its server's core, its guided drive."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter

from steerkit.car import recording as recordings
from steerkit.car.calibration import Guided
from steerkit.car.config import CarConfig
from steerkit.car.estimates import Watched
from steerkit.car.protocol import Snapshot
from steerkit.car.state_machine import Order
from steerkit.diagram import realtime
from steerkit.diagram.units import radians_of
from steerkit.paths.courses import course
from tests.support.car_world import CONFIG as SHIPPED
from tests.support.car_world import World

Timed = Sequence[tuple[float, float]]
"""Times [s] and angles [rad]."""
_TEXT = SHIPPED.texts["config.toml"].replace('name = "paper"', 'name = "calibration"')
CONFIG = replace(SHIPPED, course=course("calibration"), texts={**SHIPPED.texts, "config.toml": _TEXT})
RATIO, DELAY, LAG, OFFSET, RATE_ZERO = 1.1, 0.2, 0.15, radians_of(1.5), 0.003
UNTOLD: dict[str, Any] = {
    "vehicle": replace(CONFIG.vehicle, steer_ratio=RATIO * CONFIG.vehicle.steer_ratio),
    "delay": DELAY,
    "lag": LAG,
    "offset": OFFSET,
    "rate_zero": RATE_ZERO,
}


class CalibratedWorld(World):
    """The car server's core, a simulated car on the course for it, and a guided drive."""

    def __init__(self, *, minutes: float = 0.5, config: CarConfig = CONFIG, v: Any = (4.5, 5.0), **more: Any):
        self.guided: Guided | None = None
        self.seen: list[Snapshot] = []
        self.said: list[str] = []
        """What the operator was told, a text a sample."""
        super().__init__(s=0.0, v=v, config=config, **(UNTOLD | more))
        self.watched = Watched(config, self.packet)
        self.due = math.inf  # the human drives alone
        self.until(5.0)
        link: Any = self
        self.guided = Guided(config=config, link=link, minutes=minutes)
        resting = self.guided.follow.resting
        self.run = realtime.Run(resting, resting.init(), realtime.Timing(period=resting.dt))
        self.over = False
        self.due = self.t + 0.05

    def stepped(self, run: realtime.Run) -> None:
        if self.guided is None:
            return super().stepped(run)
        assert self.last is not None
        self.seen.append(self.last)
        self.over = self.over or self.guided.step(run)
        self.said.append(self.guided.status())
        self.watched.sample(self.last)
        return None

    def drive(self, longest: float = 300.0) -> None:
        """Engage, and drive until all is driven."""
        self.order(Order.ARM, then=0.2)
        self.order(Order.ENGAGE)
        end = self.t + longest
        while not self.over and self.t < end:
            self.until(self.t + 0.05)

    def late(self) -> float:
        """By how much commands come to the bus later than the samples that they are of [s], as a motor feels it."""
        asked, sent = [(s.t, s.command) for s in self.seen], [(s.t, s.delta_sw) for s in self.sent]
        return lateness(asked, sent, self.seen[40].t, self.seen[-2].t, LAG)


def lateness(asked: Timed, sent: Timed, begin: float, end: float, lag: float) -> float:
    """By how much angles (t, angle) are sent later than the samples of which they were asked [s], as a motor of that
    lag feels it between `begin` and `end`: to 1 ms, 60 ms at most."""
    t = np.arange(begin, end, 0.001)
    keep = np.exp(-0.001 / lag)

    def felt(x: Any) -> Any:
        return lfilter([1.0 - keep], [1.0, -keep], x - x[0])

    (times, angles), (acting, moved) = np.array(asked).T, np.array(sent).T
    held = felt(angles[np.searchsorted(times, t, side="right")])
    acted = felt(moved[np.searchsorted(acting, t, side="right") - 1])
    start = 2000
    return 0.001 * min(range(60), key=lambda ms: float(np.mean((acted[start:] - held[start - ms : len(t) - ms]) ** 2)))


class Made(NamedTuple):
    """A drive that has ended."""

    world: CalibratedWorld
    record: Path


def made(folder: Path, **more: Any) -> Made:
    """A guided drive from its beginning to its end, recorded."""
    file = folder / "drive.mcap"
    config = more.get("config", CONFIG)
    record = recordings.Recording(file, recordings.described(config))
    world = CalibratedWorld(recorder=record, **more)
    world.drive()
    record.close()
    return Made(world, file)
