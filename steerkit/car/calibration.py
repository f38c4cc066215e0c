"""The guided drive that ends in a vehicle file: one wave after the other on top of a controller."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.errors import known, require
from steerkit.car import calibrated
from steerkit.car import loop as loops
from steerkit.car import session as sessions
from steerkit.car.client import CarClient
from steerkit.car.config.config import CarConfig
from steerkit.car.estimates import Watched
from steerkit.car.follow import Follow
from steerkit.car.state_machine import Mode
from steerkit.diagram import realtime
from steerkit.paths.path import Path
from steerkit.scenario.catalogue import CONTROLLERS
from steerkit.task import DT

SHARES = {"sine": 0.25, "steps": 0.25, "bends": 0.5}
"""Of the driving time, by wave, in this order."""
SLOWEST = 3.0
"""Speed from which on time counts, as estimators learn nothing below [m/s]."""
WARNING = 5.0
"""How long before its end the operator is told that the drive ends [s]."""
_ABOUT = {"sine": "the wheel swings slowly", "steps": "it steps to and fro", "bends": "the course alone moves it"}


@dataclass(kw_only=True)
class Guided:
    """Which wave is on top while a car is calibrated: each for its share of the time that the car is driven engaged.

    Whoever takes the wheel stops the clock; the wave begins anew when the car is engaged again. Everything else is an
    ordinary drive: gate, checks, watchdogs and keys are those of any controller. Raises ValueError for minutes out of
    range and a controller that is not known.
    """

    config: CarConfig
    path: Path
    link: CarClient
    line: Watched
    base: str = "stanley"
    """The controller that keeps the car on its course."""
    minutes: float = 4.0
    """Of driving, engaged."""
    say: bool = False
    """Print a line at each wave's beginning."""
    driven: float = 0.0
    """Of this wave [s]."""
    place: int = 0
    """Number of the wave; one more than the last when all are over."""
    follow: Follow = field(init=False)

    def __post_init__(self) -> None:
        check(self.base, self.minutes)
        first = loops.controller_named(f"{self.base}+{self.wave}", self.config)
        self.follow = Follow.of(self._loop(first), self.line)
        self._tell(first)

    @property
    def wave(self) -> str:
        """The wave of now; "" when all are over."""
        return [*SHARES, ""][self.place]

    @property
    def left(self) -> float:
        """Driving that is left of this wave [s]."""
        return 60.0 * self.minutes * SHARES.get(self.wave, 0.0) - self.driven

    def step(self, run: realtime.Run) -> bool:
        """After every sample; True when all waves are over."""
        self.follow.begin(run)
        if self.follow.engaged and run.sample["car.v"] >= SLOWEST:
            self.driven += DT
        if self.left < 0.5 * DT:
            self.place, self.driven = self.place + 1, 0.0
            if not self.wave:
                return True
            controller = loops.controller_named(f"{self.base}+{self.wave}", self.config)
            self.follow.exchange(run, self._loop(controller))
            self._tell(controller)
        self.follow.choose(run)
        return False

    def _loop(self, controller: loops.Controller) -> Any:
        return loops.car_loop(self.config, self.path, self.line, controller.block)

    def _tell(self, controller: loops.Controller) -> None:
        self.link.remark(controller.steers.text())
        if self.say:
            print(self.status(), flush=True)

    def status(self) -> str:
        """One line for the panel: what comes, and what stands against it."""
        if not self.wave:
            return "all is driven: take the wheel"
        after = [*SHARES, "the end"][self.place + 1]
        text = f"{self.wave}, {_ABOUT[self.wave]}: {self.left:.0f} s of driving left, then {after}"
        last = self.line.last
        if last is None or last.mode is not Mode.ENGAGED:
            return f"{text}; the clock stands until you engage"
        if not last.v >= SLOWEST:
            return f"{text}; the clock stands below {SLOWEST:g} m/s: nothing is learned there"
        return f"{text}: HANDS ON THE WHEEL" if after == "the end" and self.left < WARNING else text


def check(base: str, minutes: float) -> None:
    """Raise ValueError unless a car can be calibrated like that."""
    require(0.1 <= minutes <= 60.0, "calibrate", f"minutes = {minutes:g}, expected 0.1 to 60 of driving")
    known(base, CONTROLLERS, "calibrate: controller")


def calibrate(options: sessions.Options, out: FilePath, *, base: str, minutes: float) -> dict[str, Any]:
    """`steerkit car calibrate`: drive, then write the vehicle file `out`; returns figures and estimates.

    Nothing is lost when a drive is cut short: the file can be made from its recording. Raises ValueError, before
    anything starts, for an `out` that is no vehicle file and for what `Guided` refuses.
    """
    check(base, minutes)
    calibrated.check_place(out)
    with sessions.session(options) as here:
        here.link.wait(timeout=10.0)
        guided = Guided(
            config=here.config,
            path=here.path,
            link=here.link,
            line=here.watched,
            base=base,
            minutes=minutes,
            say=not here.live,
        )
        with here.panel(f"calibration, {base}", guided.status, "guide"):
            run = realtime.run(
                guided.follow.resting,
                timer=here.clock,
                watch=lambda live: guided.step(live) or here.watch(live),
                on_miss=lambda live: loops.count_misses(live, here.link),
            )
    figures = sessions.told(here, run)
    if not here.recording:
        print(f"when the car server that was there has ended: steerkit car calibrate --from RECORDING --out {out}")
        return figures
    return figures | calibrated.from_recording(FilePath(here.recording), out, say=not options.quiet)
