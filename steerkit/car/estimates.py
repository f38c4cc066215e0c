"""The estimators that run in every drive of a car, behind its line to the car server, and their results in words."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path as File
from typing import Any, NamedTuple

from steerkit._support.files import read_toml
from steerkit.car.config import CarConfig
from steerkit.car.protocol import ESTIMATES, Estimates, Snapshot
from steerkit.car.state_machine import Mode
from steerkit.diagram.block import Block
from steerkit.diagram.units import degrees_of
from steerkit.estimators.estimate import NORMAL_95, Estimated, estimated
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import WheelDelay
from steerkit.estimators.steering_hysteresis import SteeringFriction
from steerkit.task import DT
from steerkit.vehicles import tables_of

EVERY = 20
"""Samples from one message of estimates to the next."""
_RAGGED = 0.4
"""A sample that comes later or earlier by more than this share of the period is not used [1]."""
_MOST = {"v": 150.0, "r": 10.0, "psi": 1e3, "delta_sw": 100.0, "command": 100.0, "report_age": 1.0}
"""What no car exceeds, in SI: such a reading is none."""
_ARITHMETIC = (ArithmeticError, ValueError)
"""What floats raise: a division by 0, an overflow, the root of a negative number. None of it may end a drive."""
_LAGS = {"short lag": 0.08, "middle lag": 0.16, "long lag": 0.32}
"""Priors of the lag [s]: each block finds lags from half of its own to 1.4 times that."""
_UPPER = 1.3
"""A lag that is longer than so many times the prior is the next block's [1]."""
_OTHERS = ("filter", "friction")
_SPREAD = 0.004
"""Deviation of when a command acts, which the gate spreads over the frames of its sample [s]."""
_MOTION_UNKNOWN = 0.01
"""Deviation of the time between what is measured of wheel and of motion [s]."""


class Quantity(NamedTuple):
    """How a quantity is called, its unit, and how it is printed."""

    text: str
    si: str
    unit: str
    digits: int


_FOUND = read_toml(File(__file__).with_name("quantities.toml"), "quantities")["found"]
QUANTITIES = {name: Quantity(*row) for name, row in _FOUND.items()}
"""By the names of `protocol.ESTIMATES`."""
DOUBTED = "a FAULT ended this drive: what was estimated before it is not to be used, and is begun anew"
DROVE, EARLIER = "drive", "an earlier drive"
"""Sources of an estimate in a vehicle file."""


class CarEstimators:
    """The estimators for a car that measures its steering wheel; fed with its car server's snapshots, one a sample.

    Dead time and lag are those from the sample that a command was computed from to the wheel: the age of the wheel's
    report is taken off, the time that controller and car server take is in them. They and friction are learned while
    the car is ENGAGED, the others at all times. What is late or lost makes them wait, and nothing that a sample
    holds raises: an error of arithmetic resets them, and `faults` counts it. After a FAULT they begin anew: what was
    wrong then may have been so for long. `doubted`: is there one now?
    """

    def __init__(self, config: CarConfig):
        self.config = config
        car = config.vehicle
        delay = min(config.delay, WheelDelay.longest)
        self.blocks: dict[str, Block] = {
            **{name: WheelDelay(prior_delay=delay, prior_lag=lag) for name, lag in _LAGS.items()},
            "filter": SingleTrackFilter(vehicle=car, held=False),
            "friction": SteeringFriction(),
        }
        self.faults, self.doubted = 0, False
        self._begin()

    def _begin(self) -> None:
        self.x: dict[str, Any] = {name: block.init() for name, block in self.blocks.items()}
        self._before: Snapshot | None = None
        self._ages, self._engaged = 0.0, 0

    def sample(self, now: Snapshot) -> None:
        """Take note of the next sample, 50 ms after the one before."""
        self.doubted = now.mode is Mode.FAULT
        if self.doubted:
            self._begin()
            return
        wild: Any = {name: math.nan for name, most in _MOST.items() if not abs(getattr(now, name)) <= most}
        now = now._replace(**wild)
        before, self._before = self._before, now
        if before is None:
            return
        try:
            self._update(before, now)
        except _ARITHMETIC:
            self._fail()

    def _fail(self) -> None:
        self.faults += 1
        self._begin()

    def _update(self, before: Snapshot, now: Snapshot) -> None:
        """A sample is complete with the next one, which holds the command that acted from it on."""
        even = abs(now.t - before.t - DT) <= _RAGGED * DT
        engaged = even and before.mode is Mode.ENGAGED and now.mode is Mode.ENGAGED
        if engaged and math.isfinite(before.report_age):
            self._ages, self._engaged = self._ages + before.report_age, self._engaged + 1
        steers = 1.0 if engaged else 0.0
        command = now.command if engaged else math.nan
        wheel, psi = (now.delta_sw, before.psi) if even else (math.nan, math.nan)
        measured = {"v": before.v, "r": before.r, "psi": psi, "delta_sw_meas": before.delta_sw}
        steered = {"delta_sw_cmd": command, "angle": command, "active": steers, **self._wheel()._asdict()}
        # of the motion the wheel comes a sample late
        moved = {"delta_sw": wheel, "active": 1.0, "delay": DT, "delay_deviation": _MOTION_UNKNOWN}
        moved |= {"lag": 0.0, "lag_deviation": 0.0}
        for name in self.blocks:
            self._feed(name, measured | (moved if name == "filter" else steered))

    def _feed(self, name: str, given: dict[str, float]) -> None:
        block = self.blocks[name]
        u = block.U(*[given[port.name] for port in block.inputs])
        self.x[name] = block.update(0.0, self.x[name], u, ())

    def _wheel(self) -> Any:
        """Dead time and lag, of the block with the shortest prior whose lag is not at its upper end."""
        for name, prior in _LAGS.items():
            said: Any = self.blocks[name].output(0.0, self.x[name], ())
            if said.lag < _UPPER * prior:
                break
        return said

    def found(self) -> dict[str, Estimated]:
        """All quantities of `protocol.ESTIMATES`: SI and radians."""
        try:
            return self._found()
        except _ARITHMETIC:
            self._fail()
            return self._found()

    def _found(self) -> dict[str, Estimated]:
        y: dict[str, Any] = {name: self.blocks[name].output(0.0, self.x[name], ()) for name in _OTHERS}
        y["wheel"] = self._wheel()
        age = self._ages / self._engaged if self._engaged else 0.0
        n = self.config.vehicle.steer_ratio
        share = estimated(y["filter"], "ratio")
        every = {
            "lag": estimated(y["wheel"], "lag"),
            "steer_ratio": Estimated(n * share.value, n * share.deviation, share.valid),
            "friction": estimated(y["friction"], "friction"),
        }
        for name in ("delay", "delay_lag"):
            late = estimated(y["wheel"], name)
            every[name] = Estimated(late.value - age, math.hypot(late.deviation, _SPREAD), late.valid)
        for name in ("understeer", "offset", "rate_zero"):
            every[name] = estimated(y["filter"], name)
        return {name: every[name] for name in ESTIMATES}


class Watched:
    """The estimators of a drive, given each of its samples once the request that it led to is sent.

    config: the car; `before`: what an earlier drive found, in its vehicle file. note: takes findings, once a second.
    """

    def __init__(self, config: CarConfig, note: Callable[[Estimates], None]):
        self.note, self.estimators, self.before = note, CarEstimators(config), earlier(config)
        self.found: dict[str, Estimated] = {}
        """What was sent last."""
        self._count = 0

    def sample(self, now: Snapshot | None) -> None:
        """Take note of the next sample."""
        assert now is not None
        self.estimators.sample(now)
        self._count += 1
        if self.estimators.doubted:
            self.found = {}
        if self._count % EVERY == 0:
            self.found = self.estimators.found()
            self.note(message_of(self.found))

    def report(self) -> list[str]:
        """What is known, and what has changed since an earlier drive, a line each."""
        anew = f"the estimators were reset {self.estimators.faults} times: errors of arithmetic"
        more = [DOUBTED] if self.estimators.doubted else []
        return [*report(self.found, self.before), *more, *([anew] if self.estimators.faults else [])]

    def rows(self) -> list[tuple[str, str]]:
        """The same in few rows, for a screen: what is known with its interval, what is not by its name."""
        known = [in_words(name, *q[:2]) for name, q in self.found.items() if q.valid > 0.5]
        rest = [QUANTITIES[name].text for name, q in self.found.items() if not q.valid > 0.5]
        rows = [("found", " · ".join(known)), ("not yet", ", ".join(rest))]
        return [row for row in rows if row[1]] + [("", line) for line in self.report()[len(self.found) :]]


def message_of(found: Mapping[str, Estimated]) -> Estimates:
    """What was found, for the recording."""
    return Estimates(tuple(float(number) for name in ESTIMATES for number in found[name]))


def report(found: Mapping[str, Estimated], before: Mapping[str, Estimated]) -> list[str]:
    """What is known, what is not yet, and what is another than an earlier drive found, a line each."""
    lines = [f"{in_words(name, *q[:2])}{'' if q.valid > 0.5 else ', not known yet'}" for name, q in found.items()]
    return [*lines, *changes(before, found)]


def in_words(name: str, value: float, deviation: float) -> str:
    """A quantity with its 95 % interval, in words: `steering ratio 15.71 [15.42, 16.00]`."""
    text, _, unit, digits = QUANTITIES[name]
    factor = degrees_of(1.0) if unit.startswith("deg") else 1.0
    ends = Estimated(value, deviation, 1.0)
    numbers = [f"{factor * number:.{digits}f}" for number in (value, ends.low, ends.high)]
    return f"{text} {numbers[0]} [{numbers[1]}, {numbers[2]}]{f' {unit}' if unit else ''}"


def earlier(config: CarConfig) -> dict[str, Estimated]:
    """What an earlier drive found, by the vehicle file that a car's file names; nothing without one."""
    return known_in(config.texts[config.vehicle_file]) if config.vehicle_file else {}


def known_in(text: str, where: str = "vehicle file") -> dict[str, Estimated]:
    """The estimates in a vehicle file's text that a drive found; raises ValueError for what is no such file."""
    rows = tables_of(text, where).get("estimates", {})
    found = {}
    for name, row in rows.items() if isinstance(rows, dict) else ():
        numbers = [row.get(key) for key in ("value", "low", "high")] if isinstance(row, dict) else []
        drove = name in QUANTITIES and isinstance(row, dict) and row.get("source") in (DROVE, EARLIER)
        if drove and all(isinstance(number, float) and math.isfinite(number) for number in numbers):
            found[name] = Estimated(row["value"], (row["high"] - row["low"]) / (2.0 * NORMAL_95), 1.0)
    return found


def changes(before: Mapping[str, Estimated], found: Mapping[str, Estimated]) -> list[str]:
    """What is another than an earlier drive found, in words: two 95 % intervals and chance do not explain it.

    That is |difference| > 1.96 sqrt(deviation^2 + deviation before^2), valid in both.
    """
    said = []
    for name, old in before.items():
        new = found.get(name)
        if new is None or new.valid < 0.5:
            continue
        apart = abs(new.value - old.value) / max(math.hypot(new.deviation, old.deviation), 1e-12)
        if apart > NORMAL_95:
            was, now = in_words(name, *old[:2]), in_words(name, *new[:2]).removeprefix(QUANTITIES[name].text)
            said.append(f"changed since the last calibration: {was} then,{now} now")
    return said
