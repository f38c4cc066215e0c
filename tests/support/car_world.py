"""A simulated car, the car server's core and a controller in one process, on a clock that the test moves."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Self

from steerkit.car import loop as loops
from steerkit.car import protocol
from steerkit.car.config import CarConfig, load
from steerkit.car.core import Core, Event, Frame, Link, Note, Packet, Reply, Send, Tick
from steerkit.car.loop import Follow
from steerkit.car.recording import Recording
from steerkit.car.simulated import Fault, SimulatedCar
from steerkit.car.state_machine import Mode, Order
from steerkit.controllers.stanley import Stanley
from steerkit.diagram import realtime
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.doe import OutputElement

BEND = 147.0
"""Arc length just before a bend of the course [m]: there the wheel has to move."""
CONFIG = load("dbw-kit.toml")


class Sent(NamedTuple):
    t: float
    delta_sw: float
    enable: bool
    mode: Mode
    v: float
    """The faster of the two speeds that are known [m/s]."""


class World:
    """Car, server core and controller in one process; time jumps from event to event."""

    def __init__(
        self,
        *,
        s: float = BEND,
        v: tuple[float, float] = (5.0, 5.5),
        seed: int = 0,
        controller: Block | None = None,
        doe: OutputElement | None = None,
        recorder: Recording | None = None,
        config: CarConfig = CONFIG,
        **untold: Any,
    ):
        self.config = config
        self.car: Any = self.simulated(config, s=s, v_min=v[0], v_max=v[1], seed=seed, **untold)
        self.recorder = recorder
        self.core = Core(config)
        self.t = 0.0
        self.sent: list[Sent] = []
        self.modes: list[tuple[float, Mode, str]] = [(0.0, Mode.OFF, "start")]
        self.events: list[tuple[Event, list[Any]]] = []
        self.last: protocol.Snapshot | None = None
        self.misses = 0
        self.tampered: Callable[[float, float], tuple[float, float] | None] = lambda basis, delta_sw: (basis, delta_sw)
        self.asleep_until = 0.0
        self.beat_due, self.beats_until = 0.01, math.inf
        self.handle(Link(0.0, 1, True))
        self.packet(protocol.Hello(True))
        self.handle(Link(0.0, 2, True))
        self.handle(Packet(0.0, 2, protocol.encode(protocol.Hello(False))))
        self.until(0.03)
        loop = self.build(controller or Stanley.of(config.vehicle), doe)
        self.follow = Follow.of(loop, self)
        self.run = realtime.Run(self.follow.resting, self.follow.resting.init(), realtime.Timing(period=loop.dt))
        self.due = 0.05

    def simulated(self, config: CarConfig, **told: Any) -> Any:
        """The car."""
        return SimulatedCar(config, **told)

    def build(self, controller: Block, doe: OutputElement | None) -> Loop:
        """The loop of a controller, or of a policy."""
        return loops.car_loop(self.config, self, controller, doe=doe)

    # a line to the car, as a CarClient
    def query(self) -> protocol.Snapshot:
        self.packet(protocol.Query())
        assert self.last is not None
        return self.last

    def request(self, delta_sw: float) -> None:
        assert self.last is not None
        asked = self.tampered(self.last.t, delta_sw)
        if asked is not None:
            self.packet(protocol.Request(*asked, self.misses))

    def note(self, message: protocol.Message) -> None:
        self.packet(message)

    def stepped(self, run: realtime.Run) -> None:
        """After every control sample."""
        self.follow.begin(run)
        self.follow.choose(run)

    # time
    def until(self, end: float) -> None:
        while True:
            due = getattr(self, "due", math.inf)
            t = max(self.t, min(self.car.next, max(self.core.wake, self.asleep_until), due, self.beat_due, end))
            self.t = t
            if t >= self.beat_due:
                self.beat_due = t + 0.1
                if t < self.beats_until:
                    self.handle(Packet(t, 2, protocol.encode(protocol.Beat())))
            for when, frame_id, data in self.car.advance(t):
                self.handle(Frame(t, when, frame_id, data))
            if t >= due:
                self.due += 0.05
                self.run.loop.advance(self.run.k, self.run.x, self.run.y)
                self.run.k += 1
                self.stepped(self.run)
            if t >= self.asleep_until:
                self.handle(Tick(t))
            if t >= end:
                return

    def worst_e(self, seconds: float) -> float:
        """Largest |e| while it is engaged, for so long at the most; a learner that trips does not steer again."""
        worst, end = 0.0, self.t + seconds
        while self.t < end and self.mode is Mode.ENGAGED:
            self.until(self.t + 0.05)
            worst = max(worst, abs(self.core.senses.e))
            if "supervisor.tripped" in self.run.sample and self.run.sample["supervisor.tripped"] > 0.5:
                self.follow.trusted = False
        return worst

    def packet(self, message: protocol.Message) -> None:
        self.handle(Packet(self.t, 1, protocol.encode(message)))

    def order(self, order: Order, then: float | None = None) -> None:
        """Give it, and go on for so long [s]."""
        self.packet(protocol.Command(order))
        self.go_on_for(then)

    def fault(self, kind: str, target: str = "report", *, then: float | None = None, **more: float) -> None:
        """Of the car, from now on; and go on for so long [s]."""
        self.car.faults.append(Fault(kind=kind, target=target, start=self.t, **more))
        self.go_on_for(then)

    def go_on_for(self, seconds: float | None) -> None:
        if seconds is not None:
            self.until(self.t + seconds)

    def handle(self, event: Event) -> None:
        if event.t < self.asleep_until:
            return
        outputs = self.core.handle(event)
        self.events.append((event, outputs))
        if self.recorder:
            self.recorder.event(event, outputs)
        for out in outputs:
            match out:
                case Send():
                    self.car.receive(self.t, out.frame_id, out.data)
                    angle, enable, _ = self.config.writer.read(out.data)
                    known = self.core.senses.values
                    v = max(abs(known["v"]), abs(known["v_kit"]))
                    self.sent.append(Sent(self.t, angle, enable, self.core.machine.mode, v))
                case Note(topic="state", values=v):
                    self.modes.append((v["t"], v["to"], v["cause"]))
                case Reply(data=data):
                    answer = protocol.decode(data)
                    if isinstance(answer, protocol.Snapshot):
                        self.last = answer

    @property
    def mode(self) -> Mode:
        return self.core.machine.mode

    def bring_to(self, mode: Mode) -> Self:
        """Into a state, by the way that an operator would go."""
        if mode is Mode.OFF:
            self.until(0.2)
            return self
        self.order(Order.ARM)
        self.until(0.2)
        assert self.mode is Mode.READY, self.core.obstacles()
        if mode is Mode.STANDBY:
            self.fault("torque")  # a hand on the wheel
            self.until(0.3)
        elif mode is not Mode.READY:
            self.order(Order.ENGAGE)
            self.until(0.55)
            assert self.mode is Mode.ENGAGED
            if mode is not Mode.ENGAGED:
                kind, target = ("override", "report") if mode is Mode.OVERRIDE else ("quality", "pose")
                self.fault(kind, target, length=0.1)
                self.until(0.75)
        assert self.mode is mode
        return self

    def check_bus(self) -> None:
        """Nothing out of limits, nothing enabled outside ENGAGED, never faster than the cap, on the whole bus."""
        gate = self.config.gate
        for s in self.sent:
            assert abs(s.delta_sw) <= gate.delta_sw_max + 1e-9
            assert s.enable is (s.mode is Mode.ENGAGED)
        for a, b in zip(self.sent, self.sent[1:]):
            assert b.t - a.t >= gate.dt_min - 1e-6
            if a.enable and b.enable:
                v, dt = max(b.v, gate.v_floor), min(b.t - a.t, gate.dt_max)
                length = gate.length(v)
                kappa = [math.tan(s.delta_sw / gate.steer_ratio) / length for s in (a, b)]
                step = 1.01 * gate.quantum / gate.steer_ratio / length
                assert abs(b.delta_sw - a.delta_sw) / dt <= gate.rate_max * (1.0 + 1e-6)
                assert abs(b.delta_sw - a.delta_sw) <= gate.rate(v) * dt + 1.01 * gate.quantum
                assert abs(kappa[1] - kappa[0]) <= gate.jerk_max / v**2 * dt + step
                assert abs(kappa[1]) <= max(abs(kappa[0]), gate.a_y_max / v**2 + step)
