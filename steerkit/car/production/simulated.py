"""A simulated production car: the car of `SimulatedCar`, behind its maker's frames instead of a kit's."""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from steerkit.car.config import CarConfig
from steerkit.car.production.car_frames import CarFrames, Said
from steerkit.car.production.platforms import platform
from steerkit.car.production.port import REJECTED_BUS, SILENCE, Frame
from steerkit.car.simulated import BENDS, STEP, Fault, SimulatedCar, corrupted
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.estimators.torque_map import LateralMap
from steerkit.paths.path import Path

_SPEED_NOISE = 0.01  # m/s
_SLOWEST = 1.0  # m/s: below, torque turns the wheel as at this speed
CRUISE_AFTER = 0.5  # s after the ignition, or after braking: to be allowed to steer takes an edge of cruise control


@dataclass
class Counts:
    """What has passed: frames of the car, frames to it, and those of them that the judge rejected."""

    received: int = 0
    not_in_order: int = 0
    sent: int = 0
    rejected: int = 0


def speeds_of(config: CarConfig) -> tuple[float, float]:
    """The speeds between which the simulated human drives [m/s]: those that the port steers at, and the file allows."""
    slowest = max(12.0, platform(config.port).slowest + 1.5, config.states.v_engage_min)
    fastest = min(config.states.v_engage_max, config.states.v_max - 1.0)
    return min(slowest, fastest), min(max(slowest + 1.0, 16.0), fastest)


class ProductionCar:
    """A production car with its human; `receive` what the port sends, `advance` it in time.

    config: the car server's. path: where the human drives. lateral: what a torque truly does, where it is steered by
    one (default: as opendbc has it). judge: a panda's safety code, with `tick(t)`, `receive(t, frame_id, data, bus)` of
    the car's frames (is it in order?) and `may_pass` of those to it; the port gets back what may not. more: what
    `SimulatedCar` takes, its delay by default that of opendbc.
    """

    def __init__(
        self, config: CarConfig, path: Path, *, lateral: LateralMap | None = None, judge: Any = None, **more: Any
    ):
        self.platform = platform(config.port)
        v_min, v_max = speeds_of(config)
        more.setdefault("v_min", v_min)
        more.setdefault("v_max", v_max)
        more.setdefault("delay", self.platform.delay)
        bends = min(BENDS, 0.7 * config.gate.a_y_max)
        self.car = SimulatedCar(config, path, bends=bends, **more)
        self.frames, self.judge, self.counts = CarFrames(self.platform), judge, Counts()
        self.lateral = lateral or self.platform.lateral
        self.torque, self._a_y = 0.0, 0.0
        self._asked, self._heard = math.nan, -math.inf
        self._last: list[Frame] = []
        self._stuck: Said | None = None
        self._out: deque[tuple[float, Frame]] = deque()
        self._dice = random.Random(int(more.get("seed", 0)))
        self._waiting: list[Frame] = []
        self._cruise_from = CRUISE_AFTER

    def receive(self, t: float, frame: Frame) -> None:
        """A frame of the computer at time t [s]."""
        self.counts.sent += 1
        if self.judge and not self.judge.may_pass(t, *frame):
            self.counts.rejected += 1
            self._waiting.append(frame._replace(bus=frame.bus + REJECTED_BUS))
            return
        if self.car.fault("deaf", t):
            return
        command = self.frames.command(frame.frame_id, frame.data, float(self.car.now.v))
        if command is None:
            return
        self._heard = t
        self._asked = command.value if command.active else math.nan

    def advance(self, t: float) -> tuple[list[tuple[float, int, bytes]], list[Frame]]:
        """Until time t [s]: the frames of the pose (when, id, data), and those of the car's buses."""
        poses: list[tuple[float, int, bytes]] = []
        buses = self._waiting
        self._waiting = []
        while self.car.t + STEP <= t + 1e-9:
            self._steer(self.car.t)
            poses += self.car.advance(self.car.t + STEP)
            buses += self._say(self.car.t)
        reports = self.car.config.report_frames
        return [pose for pose in poses if pose[1] not in reports], buses

    def _steer(self, t: float) -> None:
        """What the steering makes of the last command: an angle, for the motor at the wheel."""
        writer, car = self.car.config.writer, self.car.config.vehicle
        v = max(float(self.car.now.v), _SLOWEST)
        asked = self._asked if t - self._heard < SILENCE else math.nan
        active = math.isfinite(asked) and not self.car.fault("kit_fault", t)
        if not active:
            self.torque, self._a_y = 0.0, float(v * self.car.now.r)
            self.car.receive(t, writer.frame_id, writer.write(0.0, enable=False))
            return
        length = car.wheelbase + car.understeer_gradient * v * v
        match self.platform.steered_by:
            case "angle":
                angle = radians_of(asked)
            case "curvature":
                angle = car.steer_ratio * math.atan(length * asked)
            case _:
                self.torque = max(-1.0, min(1.0, asked))
                centre = self.lateral.gain * self.torque + self.lateral.offset
                half = self.lateral.gain * self.lateral.friction  # so far friction keeps a_y from following
                self._a_y = max(centre - half, min(centre + half, self._a_y))
                angle = car.steer_ratio * math.atan(length * self._a_y / (v * v))
        limit = self.car.config.gate.delta_sw_max
        angle = round(max(-limit, min(limit, angle)) / writer.quantum) * writer.quantum
        self.car.receive(t, writer.frame_id, writer.write(angle, enable=True))

    def _say(self, t: float) -> list[Frame]:
        fault: Callable[..., Fault | None] = self.car.fault
        brake = fault("brake", t) is not None
        if brake:
            self._cruise_from = t + CRUISE_AFTER
        said = Said(
            angle_deg=float(degrees_of(self.car.turned)),
            v=max(0.0, float(self.car.now.v) + self._dice.gauss(0.0, _SPEED_NOISE)),
            r=float(self.car.now.r),
            hand=bool(fault("override", t) or fault("torque", t)),
            brake=brake,
            gas=fault("accelerator", t) is not None,
            cruise=fault("disabled", t) is None and t >= self._cruise_from,
            door=fault("door", t) is not None,
            fault=fault("kit_fault", t) is not None,
            motor=self.torque,
        )
        if fault("wheel_sign", t):
            said = replace(said, angle_deg=-said.angle_deg)
        if off := fault("speed", t, "report"):
            said = replace(said, v=said.v + (off.amount or 3.0))
        self._stuck = (self._stuck or said) if fault("stuck", t, "report") else None
        frames = [Frame(*frame) for frame in self.frames.send(self._stuck or said)]
        if fault("freeze", t, "report"):
            frames = self._last
        self._last = frames
        if fault("corrupt", t, "report"):
            frames = [frame._replace(data=corrupted(frame.data, self._dice)) for frame in frames]
        if fault("drop", t, "report"):
            frames = []
        late = fault("delay", t, "report")
        self._out += [(t + (late.amount or 0.2 if late else 0.0), frame) for frame in frames]
        due = []
        while self._out and self._out[0][0] <= t + 1e-9:
            due.append(self._out.popleft()[1])
        self.counts.received += len(due)
        if self.judge:
            self.judge.tick(t)
            self.counts.not_in_order += sum([not self.judge.receive(t, *frame) for frame in due])
        return due
