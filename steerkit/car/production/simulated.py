"""A simulated production car: the car of `SimulatedCar`, behind its maker's frames instead of a kit's."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

from steerkit.car.config import CarConfig
from steerkit.car.production.car_frames import CarFrames, Said
from steerkit.car.production.platforms import platform
from steerkit.car.production.port import REJECTED_BUS, SILENCE, Frame
from steerkit.car.simulated import BENDS, FAULTS, SimulatedCar
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.estimators.torque_map import LateralMap

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


class ProductionCar(SimulatedCar):
    """A production car with its human; it is told what the port sends by `hear`, and says the rest by `said`.

    config: the car server's. lateral: what a torque truly does, where it is steered by one (default: as opendbc has
    it). judge: a panda's safety code, with `tick(t)`, `receive(t, frame_id, data, bus)` of the car's frames (is it in
    order?) and `may_pass` of those to it; the port gets back what may not. more: what `SimulatedCar` takes, its delay
    by default that of opendbc.
    """

    def __init__(self, config: CarConfig, *, lateral: LateralMap | None = None, judge: Any = None, **more: Any):
        self.platform = platform(config.port)
        fastest = min(config.states.v_engage_max, config.states.v_max - 1.0)  # between what port and file allow
        v_min = min(max(12.0, self.platform.slowest + 1.5, config.states.v_engage_min), fastest)
        v_max = min(max(v_min + 1.0, 16.0), fastest)
        usual = {"v_min": v_min, "v_max": v_max, "delay": self.platform.delay}
        super().__init__(config, bends=min(BENDS, 0.7 * config.gate.a_y_max), **{**usual, **more})
        self.readers = tuple([r for r in config.readers if r.frame_id in config.pose_frames])
        self.frames, self.judge, self.counts = CarFrames(self.platform), judge, Counts()
        self.lateral = lateral or self.platform.lateral
        self.torque, self._a_y = 0.0, 0.0
        self._asked, self._asked_at = math.nan, -math.inf
        self._as_before: Said | None = None
        self._out: deque[tuple[float, tuple[int, int], bytes]] = deque()
        self._buses: list[Frame] = []
        self._cruise_from = CRUISE_AFTER

    def hear(self, t: float, frame: Frame) -> None:
        """A frame of the computer at time t [s]."""
        self.counts.sent += 1
        if self.judge and not self.judge.may_pass(t, *frame):
            self.counts.rejected += 1
            self._buses.append(frame._replace(bus=frame.bus + REJECTED_BUS))
            return
        if self.fault("deaf", t):
            return
        command = self.frames.command(frame.frame_id, frame.data, float(self.now.v))
        if command is not None and command.active:
            self._asked, self._asked_at = command.value, t
        elif command is not None:  # without a request in the frame, a torque of 0 is still one for SILENCE
            self._asked = math.nan if self.frames.asks[frame.frame_id][2] else 0.0

    def said(self) -> list[Frame]:
        """The frames of the car's buses since it was asked last."""
        said, self._buses = self._buses, []
        return said

    def _step(self) -> None:
        self._steer(self.t)
        super()._step()
        self._say(self.t)

    def _steer(self, t: float) -> None:
        """What the steering makes of the last command: an angle, for the motor at the wheel."""
        writer, car = self.config.writer, self.config.vehicle
        v = max(float(self.now.v), _SLOWEST)
        asked = self._asked if t - self._asked_at < SILENCE else math.nan
        active = math.isfinite(asked) and not self.fault("kit_fault", t)
        if not active:
            self.torque, self._a_y = 0.0, float(v * self.now.r)
            self.receive(t, writer.message.frame_id, writer.write(0.0, enable=False))
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
        limit = self.config.gate.delta_sw_max
        angle = round(max(-limit, min(limit, angle)) / writer.quantum) * writer.quantum
        self.receive(t, writer.message.frame_id, writer.write(angle, enable=True))

    def _say(self, t: float) -> None:
        up = {kind: self.fault(kind, t) is not None for kind in FAULTS}
        if up["brake"]:
            self._cruise_from = t + CRUISE_AFTER
        off = self.fault("speed", t, "report")
        said = Said(
            angle_deg=float(degrees_of(self.turned)) * (-1.0 if up["wheel_sign"] else 1.0),
            v=max(0.0, float(self.now.v) + self._dice.gauss(0.0, _SPEED_NOISE)) + (off.amount or 3.0 if off else 0.0),
            r=float(self.now.r),
            hand=up["override"] or up["torque"],
            brake=up["brake"],
            gas=up["accelerator"],
            cruise=not up["disabled"] and t >= self._cruise_from,
            door=up["door"],
            fault=up["kit_fault"],
            motor=self.torque,
        )
        self._as_before = (self._as_before or said) if self.fault("stuck", t, "report") else None
        for frame_id, data, bus in self.frames.send(self._as_before or said):
            self._on_its_way(self._out, (frame_id, bus), data, "report")
        due = []
        while self._out and self._out[0][0] <= t + 1e-9:
            _, (frame_id, bus), data = self._out.popleft()
            due.append(Frame(frame_id, data, bus))
        self._buses += due
        self.counts.received += len(due)
        if self.judge:
            self.judge.tick(t)
            self.counts.not_in_order += sum([not self.judge.receive(t, *frame) for frame in due])
