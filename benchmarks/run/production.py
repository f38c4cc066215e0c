"""Drives behind the bus in one process: controller, car server's core, a port, its judge and its car."""

import time
from collections.abc import Callable
from functools import cache
from typing import Any

from benchmarks.judges.opendbc_safety import SafetyJudge
from steerkit._support.files import toml_of
from steerkit.car import core, protocol
from steerkit.car.config import CarConfig, Reading, shipped
from steerkit.car.core import Core, Event, Link, Note, Packet, Reply, Send, Tick
from steerkit.car.production.car_frames import CarFrames
from steerkit.car.production.platforms import platform
from steerkit.car.production.port import STEP, Frame, Port
from steerkit.car.production.simulated import ProductionCar
from steerkit.car.state_machine import Mode, Order
from steerkit.task import DT

BEAT = 0.1


@cache
def config_of(name: str, **limits: float) -> CarConfig:
    """The shipped file of a production car, for another platform, with other limits."""
    file = shipped("production-car.toml")
    text = file.read_text(encoding="utf-8")
    data = toml_of(text, "car")
    data["port"]["opendbc"] = name
    data["limits"] |= limits
    return Reading(name, data, {"config.toml": text}, file.parent).config(None)


class _Timed:
    """The library behind a port, and what its two calls took together [s]."""

    def __init__(self, interface: Any):
        self._interface = interface
        self.update_s = self.apply_s = 0.0

    def update(self, *given: Any) -> Any:
        began = time.perf_counter()
        state = self._interface.update(*given)
        self.update_s += time.perf_counter() - began
        return state

    def apply(self, *given: Any) -> Any:
        began = time.perf_counter()
        frames = self._interface.apply(*given)
        self.apply_s += time.perf_counter() - began
        return frames


class PortedCar:
    """A production car behind its port, for whoever speaks to a kit: `receive` commands, `advance` it in time."""

    def __init__(self, config: CarConfig, *, judge: SafetyJudge | None = None, **more: Any):
        self.config, self.judge = config, judge
        self.car, self.port = ProductionCar(config, judge=judge, **more), Port(config)
        self.due = self.car.t + STEP
        self.port.interface = self.library = _Timed(self.port.interface)
        self.steps = 0
        self.listen: Callable[[Frame], None] = lambda frame: None
        """Is given every frame to the car."""

    @property
    def next(self) -> float:
        """When the next frame may come [s]."""
        return min(self.car.next, self.due)

    faults: Any = property(lambda self: self.car.faults)
    on_path: Any = property(lambda self: self.car.on_path)
    now: Any = property(lambda self: self.car.now)

    def receive(self, t: float, frame_id: int, data: bytes) -> None:
        """A command of the car server."""
        self.port.command(t, data)

    def advance(self, t: float) -> list[tuple[float, int, bytes]]:
        """The frames (when, id, data) for the car server until time t [s]."""
        out: list[tuple[float, int, bytes]] = []
        while self.due <= t + 1e-9:
            out += self.car.advance(self.due)
            for frame in self.car.said():
                self.port.receive(self.due, frame)
            step = self.port.step(self.due)
            self.steps += 1
            for frame in step.to_car:
                self.listen(frame)
                self.car.hear(self.due, frame)
            out += [(self.due, frame_id, data) for frame_id, data in step.reports]
            self.due += STEP
        return out


class ProductionWorld:
    """A line to the car, as a `CarClient` is one: each `query` moves time on by a sample. The panel's keys are read.

    config: of a production car. more: as the car takes it.
    """

    def __init__(self, config: CarConfig, *, judged: bool = True, **more: Any):
        self.config = config
        self.judge = SafetyJudge(platform(config.port)) if judged else None
        self.car = PortedCar(config, judge=self.judge, **more)
        self.core = Core(config)
        self.t, self.misses = 0.0, 0
        self.last: protocol.Snapshot | None = None
        self.modes: list[tuple[float, Mode, str]] = []
        self.beat_due = 0.01
        self.handle(Link(0.0, 1, True))
        self.packet(protocol.Hello(True))
        self.handle(Link(0.0, 2, True))
        self.handle(Packet(0.0, 2, protocol.encode(protocol.Hello(False))))
        self.until(1.2)

    # a line to the car
    def query(self) -> protocol.Snapshot:
        """A sample later; what is known then."""
        self.until(self.t + DT)
        self.packet(protocol.Query())
        assert self.last is not None
        return self.last

    def request(self, delta_sw: float) -> None:
        """Ask for an angle [rad]."""
        assert self.last is not None
        self.packet(protocol.Request(self.last.t, delta_sw, self.misses))

    def note(self, message: protocol.Message) -> None:
        """Note what is believed."""
        self.packet(message)

    def order(self, order: Order) -> None:
        """An order of the human at the panel."""
        self.packet(protocol.Command(order))

    def until(self, end: float) -> None:
        """Let time pass."""
        while True:
            t = max(self.t, min(self.car.next, self.core.wake, self.beat_due, end))
            self.t = t
            if t >= self.beat_due:
                self.beat_due = t + BEAT
                self.handle(Packet(t, 2, protocol.encode(protocol.Beat())))
            for when, frame_id, data in self.car.advance(t):
                self.handle(core.Frame(t, when, frame_id, data))
            self.handle(Tick(t))
            if t >= end:
                return

    def packet(self, message: protocol.Message) -> None:
        """A packet of the controller."""
        self.handle(Packet(self.t, 1, protocol.encode(message)))

    def handle(self, event: Event) -> None:
        """What the core makes of an event."""
        for out in self.core.handle(event):
            match out:
                case Send():
                    self.car.receive(self.t, out.frame_id, out.data)
                case Note(topic="state", values=v):
                    self.modes.append((v["t"], v["to"], v["cause"]))
                case Reply(data=data):
                    answer = protocol.decode(data)
                    if isinstance(answer, protocol.Snapshot):
                        self.last = answer

    @property
    def mode(self) -> Mode:
        """Who steers."""
        return self.core.machine.mode


def altered(frames: CarFrames, frame_id: int, data: bytes, *, by: float = 0.0, active: bool | None = None) -> bytes:
    """A frame that steers, with another value (by so much, in units of its `Command`) or request; for tests.

    Its check sum stays as it was. Raises KeyError for a frame that does not steer.
    """
    from opendbc.can.packer import set_value
    from opendbc.can.parser import get_raw_value

    message, value, request, sign = frames.asks[frame_id]
    changed, signal = bytearray(data), message.sigs[value]
    if by:
        full = frames.platform.full if frames.platform.steered_by == "torque" else 1.0
        command = frames.command(frame_id, data, 0.0)
        assert command is not None
        wanted = sign * (command.value * frames.platform.full_at(0.0) + by * full)
        if frames.platform.maker == "volkswagen":
            side = message.sigs["HCA_01_LM_OffSign" if "HCA_01_LM_OffSign" in message.sigs else "LM_OffSign"]
            set_value(changed, side, int(wanted < 0.0))
            wanted = abs(wanted)
        code = round((wanted - signal.offset) / signal.factor)
        low, high = (
            (-(1 << signal.size - 1), (1 << signal.size - 1) - 1) if signal.is_signed else (0, (1 << signal.size) - 1)
        )
        set_value(changed, signal, max(low, min(high, code)))
    if active is not None and request:
        old = get_raw_value(data, message.sigs[request])
        set_value(changed, message.sigs[request], (old or 1) if active else 0)
    return bytes(changed)
