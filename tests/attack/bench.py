"""A drive under attack: the true car, its sensors, its kit, a client and an operator around the product's core.

Time is simulated; the core is given nothing but frames, packets and times, and is judged by the true car and the bus.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

from steerkit.car import protocol
from steerkit.car.calibration import Calibrated
from steerkit.car.config import CarConfig, load
from steerkit.car.core import Core, Event, Frame, Link, Note, Output, Packet, Reply, Send, Tick
from steerkit.car.estimates import CarEstimators
from steerkit.car.production.car_frames import CarFrames, Said
from steerkit.car.production.platforms import platform
from steerkit.car.production.port import Frame as PortFrame
from steerkit.car.production.port import Port
from tests.attack import wire
from tests.attack.car import FRONT, Car, Course, road, stadium, stanley

SPEEDS = (2.0, 5.0, 7.0)
"""At which attacks are tried [m/s]."""
STEP = 0.005
WATCHDOG = 0.1
SETTLE = 2.5
"""When the operator has engaged and the car has settled: no attack begins before [s]."""


AFTER = 0.3
"""So long it is watched after the product has let go [s]: five neutral frames, and the kit's watchdog."""


@cache
def courses() -> dict[str, Course]:
    return {"stadium": stadium(), "road": road(), "careful": stadium()}


@cache
def configuration(name: str, vehicle: str = "", port: str = "") -> CarConfig:
    """The product's configuration for one of them, as a user would write it; vehicle: text of a vehicle file.

    port: the platform of opendbc through which the car is steered, which has the kit's limits besides its own."""
    course = courses()[name]
    with TemporaryDirectory() as folder:
        Path(folder, "track.csv").write_text(course.csv())
        shipped = load("dbw-kit.toml").texts["config.toml"]
        if port:
            kit = shipped.partition("[limits]")
            shipped = load("production-car.toml").texts["config.toml"].partition("[limits]")[0] + "".join(kit[1:])
            shipped = shipped.replace("TESLA_MODEL_3", port).replace('name = "highway"', 'name = "paper"')
            shipped += '\n[vehicle]\nname = "vw-passat"\n[kit]\nlag = 0.1\n'
        closed = "true" if course.closed else "false"
        text = shipped.replace('name = "paper"', f'file = "track.csv"\nclosed = {closed}', 1)
        if name == "careful":  # what docs/real-car.md recommends for controllers that do not learn
            text = text.replace("e_max = 2.0", "e_max = 0.45\ne_growth = 0.4\ne_engage = 0.3")
        if vehicle:
            text = text.replace('"vw-passat"', '"calibrated.toml"')
            Path(folder, "calibrated.toml").write_text(vehicle)
        Path(folder, "car.toml").write_text(text)
        return load(Path(folder, "car.toml"))


@cache
def calibrated(kinematic: bool, seconds: float = 60.0) -> str:
    """The vehicle file of a drive of so long, the wheel swinging to and fro as the guided drive has it."""
    swing = Attack("none", request=lambda drive, a, t: a + math.radians(25.0) * math.sin(1.9 * t), seconds=seconds)
    drive = Drive(swing, kinematic=kinematic)
    estimators = CarEstimators(drive.config)
    drive.attack.act = lambda d, t: estimators.sample(protocol.decode(d.answer)) if d.k % 10 == 5 else None  # type: ignore[arg-type, func-returns-value]
    drive.settle().run()
    found = estimators.found()
    return Calibrated(config=drive.config, found=found, before={}, log="drive.mcap", digest="").text()


Sensed = SimpleNamespace
"""What the sensors say in one moment; an attack changes it. SI, flags of the kit by name."""


class OwnClient:
    """Finds its place on the attacker's course by itself."""

    def __init__(self, course: Course):
        self.course, self.near = course, None

    def __call__(self, drive: Drive, snapshot: dict[str, float]) -> float | None:
        psi = snapshot["psi"]
        x, y = snapshot["x"] + FRONT * math.cos(psi), snapshot["y"] + FRONT * math.sin(psi)
        if not math.isfinite(x + y + snapshot["v"] + snapshot["r"]):
            return None
        near, e, heading = self.course.at(x, y)
        psi_e = math.remainder(psi - heading, 2.0 * math.pi)
        return stanley(e, psi_e, snapshot["v"], snapshot["r"], float(self.course.kappa[near]))


@dataclass
class Attack:
    """Something wrong from an onset on. Each hook sees the drive and the time since the onset [s]."""

    name: str
    sense: Callable[[Drive, Sensed, float], None] | None = None
    """Changes what the sensors say."""
    frames: Callable[[Drive, list[tuple[int, bytes, str]], float], list[tuple[int, bytes, str]]] | None = None
    """Changes the frames of one moment: (id, data, kind)."""
    request: Callable[[Drive, float, float], float | None] | None = None
    """Changes the angle that the client asks for."""
    motor: Callable[[Drive, float, float], float] | None = None
    """Changes where the motor turns the wheel."""
    act: Callable[[Drive, float], None] | None = None
    """Whatever else, each step."""
    speed: Callable[[Drive, float, float], float] | None = None
    """Changes the speed that the human keeps [m/s]."""
    latency: Callable[[float], float] | None = None
    """Delay of all pose frames [s]."""
    course: str = "stadium"
    where: str = "bend"
    """Where it begins: in a `bend`, on a `straight`, or at the bend's `entry`."""
    seconds: float = 8.0
    """How long it is watched."""
    harmless: bool = False
    """Nothing has to happen: the car is steered as well as before."""
    physics: str = ""
    """Why the sensors cannot tell in time, where they cannot; then `excess_max` and `a_y_max` hold."""
    excess_max: float = 0.5
    a_y_max: float = 3.0


class Bench:
    """The product's core with a controller on line 1 and an operator on line 2, and what it said."""

    core: Core
    dice: random.Random
    noise: float
    t: float
    mode: str
    modes: list[tuple[float, str, str]]
    drift: list[float]

    def handle(self, event: Event) -> None:
        """Give the core an event, and take note of what it answers."""
        for out in self.core.handle(event):
            self.said(out)

    def said(self, out: Output) -> None:
        if isinstance(out, Note) and out.topic == "state":
            self.mode = str(out.values["to"])
            self.modes.append((self.t, self.mode, out.values["cause"]))

    def packet(self, link: int, data: bytes) -> None:
        self.handle(Packet(self.t, link, data))

    def order(self, name: str) -> None:
        self.packet(2, wire.ORDERS[name])

    def arm(self) -> None:
        """Both come, and the operator arms."""
        for link, controls in ((1, True), (2, False)):
            self.handle(Link(0.0, link, True))
            self.packet(link, wire.HELLO[controls])
        self.order("ARM")

    def noisy(self, x: float, y: float, psi: float, v: float, r: float) -> tuple[float, ...]:
        """Noise as under `hard` conditions: drifts of 1 cm and 0.1 degrees, 0.2 deg/s on the yaw rate."""
        gauss, noise = self.dice.gauss, self.noise
        for i, size in enumerate((0.01, 0.01, math.radians(0.1))):
            self.drift[i] += noise * (-self.drift[i] / 100.0 + gauss(0.0, size * math.sqrt(2.0 / 100.0)))
        near = [value + off for value, off in zip((x, y, psi), self.drift)]
        return (*near, v + noise * gauss(0.0, 0.02), r + noise * gauss(0.0, math.radians(0.2)))


@dataclass
class Drive(Bench):
    """One drive; `settle` and `run` it, then look at how it ended."""

    attack: Attack
    speed: float = 5.0
    seed: int = 0
    client: Any = None
    """From the last snapshot to the wheel that it asks for [rad], None for nothing; twenty times a second."""
    driver: Callable[[float, float, float, float, float], float] = stanley
    """Who steers while the product does not; as it may only be engaged where both want the same angle."""
    lead: float = 0.0
    """How much earlier on a closed course the product is engaged [m]: on the straight before the bend, if need be."""
    kinematic: bool = False
    """Is the car one that rolls where its wheels point?"""
    vehicle: str = ""
    """Text of its vehicle file; "" for the data sheet."""
    port: str = ""
    """The platform of opendbc that it is; "" for a car with a kit."""
    noise: float = 1.0
    t: float = 0.0
    mode: str = "OFF"
    sent: list[tuple[float, float, bool]] = field(default_factory=list)
    modes: list[tuple[float, str, str]] = field(default_factory=list)
    truth: list[tuple[float, float, float, bool]] = field(default_factory=list)
    """(t, true e, true a_y, does the kit steer?)"""

    def __post_init__(self) -> None:
        self.config = configuration(self.attack.course, self.vehicle, self.port)
        self.translator = Port(self.config) if self.port else None
        self.buses = CarFrames(platform(self.port)) if self.port else None
        self.core = Core(self.config)
        self.dice = random.Random(self.seed)
        course = courses()[self.attack.course]
        self.course = course
        self.onset = SETTLE + self.dice.random() * 0.3 + (self.lead / self.speed if course.closed else 0.0)
        at = {"bend": 70.0, "straight": 150.0, "entry": 33.0}[self.attack.where]
        start = (at - self.onset * self.speed) % course.length if course.closed else 2.0
        i = round(start / course.step) % len(course.x)
        psi = float(course.psi[i])
        self.car = Car(
            course,
            float(course.x[i]) - FRONT * math.cos(psi),
            float(course.y[i]) - FRONT * math.sin(psi),
            psi,
            v=self.speed,
            near=i,
            kinematic=self.kinematic,
        )
        self.car.wheel = 15.6 * 2.71 * float(course.kappa[i])
        self.client = self.client or OwnClient(course)
        self.kit_enabled = self.kit_timeout = self.overridden = False
        self.command, self.heard = 0.0, -math.inf
        self.snapshot: dict[str, float] = {}
        self.answer = b""
        self.count = self.k = 0
        self.drift = [0.0, 0.0, 0.0]
        self.waiting: list[tuple[float, int, bytes, str]] = []
        self.frozen: dict[str, Any] = {}
        self.beating = self.controlling = True
        self.astray = math.nan  # as the panel shows it until the onset
        self.misses = 0

    # ---- around the core --------------------------------------------------------------------------------------

    def said(self, out: Output) -> None:
        super().said(out)
        match out:
            case Send():
                angle, enable, clear = (self.config.writer.read if self.translator else wire.command)(out.data)
                self.sent.append((self.t, angle, enable))
                if self.translator:
                    self.translator.command(self.t, out.data)
                else:
                    self.hear(angle, enable, clear)
            case Reply(data=data) if known := wire.snapshot(data):
                self.snapshot, self.answer = known, data

    def hang_up(self, link: int) -> None:
        if link == 1:
            self.controlling = False
        else:
            self.beating = False
        self.handle(Link(self.t, link, False))

    def hear(self, angle: float, enable: bool, clear: bool) -> None:
        self.heard = self.t
        if clear:
            self.kit_timeout = self.overridden = False
        self.kit_enabled = enable and not (self.kit_timeout or self.overridden)
        if self.kit_enabled:
            self.command = angle

    def since(self) -> float | None:
        """Time since the onset [s], None before it."""
        return self.t - self.onset if self.t >= self.onset else None

    # ---- one step ---------------------------------------------------------------------------------------------

    def sensed(self) -> Sensed:
        """What they say without an attack."""
        car, flags = self.car, {"ENABLED": self.kit_enabled, "OVERRIDE": self.overridden, "TMOUT": self.kit_timeout}
        pose = zip(("x", "y", "psi", "v", "r"), self.noisy(car.x, car.y, car.psi, car.v, car.r))
        return Sensed(
            **dict(pose),
            beta=math.atan2(car.slide, max(abs(car.v), 0.5)),
            a_y=car.a_y,
            stamp=self.t,
            quality=4.0,
            angle=car.wheel,
            echo=self.command if self.kit_enabled else car.wheel,
            v_kit=car.v,
            torque=0.2 + self.noise * self.dice.gauss(0.0, 0.1),
            flags={name for name, up in flags.items() if up},
        )

    def transmit(self) -> None:
        """Pose frames at 100 Hz, the kit's report at 50 Hz; the attack has its way with each."""
        since, attack = self.since(), self.attack
        values = self.sensed()
        if since is not None and attack.sense:
            attack.sense(self, values, since)
        self.count += 1
        n = self.count
        pose = [
            (wire.POSITION, wire.position(values.x, values.y, quality=int(values.quality), count=n), ""),
            (wire.MOTION, wire.motion(values.psi, values.v, values.r, count=n), ""),
            (wire.DYNAMICS, wire.dynamics(values.beta, values.a_y, values.stamp, count=n), ""),
        ]
        kit = []
        if self.translator:
            kit = self.through_port(values)
        elif n % 2 == 0:
            angle, echo = math.degrees(values.angle), math.degrees(values.echo)
            kit = [(wire.REPORT, wire.report(angle, echo, values.v_kit, values.torque, values.flags), "")]
        late = attack.latency(since) if since is not None and attack.latency else 0.0
        frames = pose + kit
        if since is not None and attack.frames:
            frames = attack.frames(self, frames, since)
        for frame_id, data, kind in frames:
            when = self.t + (late if frame_id in (wire.POSITION, wire.MOTION, wire.DYNAMICS) else 0.0)
            self.waiting.append((when, frame_id, data, kind))
        due = [w for w in self.waiting if w[0] <= self.t + 1e-9]
        self.waiting = [w for w in self.waiting if w[0] > self.t + 1e-9]
        for when, frame_id, data, kind in due:
            self.handle(Frame(self.t, max(when, self.t - 0.01), frame_id, data, kind))

    def through_port(self, values: Sensed) -> list[tuple[int, bytes, str]]:
        """The same values in the maker's frames, and what the port makes of them; its frames reach the car."""
        assert self.translator is not None
        assert self.buses is not None
        said = Said(
            angle_deg=math.degrees(values.angle),
            v=max(0.0, values.v_kit + self.noise * self.dice.gauss(0.0, 0.01)),
            r=self.car.r,
            hand="OVERRIDE" in values.flags or abs(values.torque) > 2.5,
            fault=any(name.startswith("FLT") for name in values.flags),
        )
        for frame in self.buses.send(said):
            self.translator.receive(self.t, PortFrame(*frame))
        step = self.translator.step(self.t)
        for frame in step.to_car:
            command = self.buses.command(frame.frame_id, frame.data, self.car.v)
            if command is not None:
                self.hear(math.radians(command.value), command.active, not command.active)
        return [(frame_id, data, "") for frame_id, data in step.reports]

    def step(self) -> None:
        """5 ms."""
        since, attack, car = self.since(), self.attack, self.car
        if since is None and self.answer and self.k % 10 == 6:
            self.astray = protocol.decode(self.answer).astray  # type: ignore[union-attr]
        self.k += 1
        self.t = self.k * STEP
        if self.k % 2 == 0:
            self.transmit()
        if self.beating and self.k % 20 == 3:
            self.packet(2, wire.BEAT)
        if self.controlling and self.k % 10 == 5:
            self.packet(1, wire.QUERY)
            asked = self.client(self, self.snapshot) if self.snapshot else None
            if since is not None and attack.request and asked is not None:
                asked = attack.request(self, asked, since)
            if asked is not None:
                self.packet(1, wire.asked(self.snapshot["t"], asked, self.misses))
        if since is not None and attack.act:
            attack.act(self, since)
        while self.core.wake <= self.t:
            self.handle(Tick(self.t))
            if self.core.wake <= self.t:
                break
        if self.kit_enabled and self.t - self.heard >= WATCHDOG:
            self.kit_timeout, self.kit_enabled = True, False
        e, psi_e, kappa = car.error()
        target = self.command if self.kit_enabled else self.driver(e, psi_e, car.v, car.r, kappa)
        if since is not None and attack.motor:
            target = attack.motor(self, target, since)
        speed = self.speed
        if since is not None and attack.speed:
            speed = attack.speed(self, speed, since)
        car.steer(target, STEP)
        car.move(STEP, speed)
        self.truth.append((self.t, e, car.a_y, self.kit_enabled))

    def settle(self) -> Drive:
        """Engage, and drive until just before the onset."""
        self.arm()
        while self.t + 2.0 * STEP < self.onset:
            self.step()
            if self.mode == "READY" and 0.8 < self.t < self.onset - 1.0:
                self.order("ENGAGE")
        return self

    def under(self, attack: Attack) -> Drive:
        """How a settled drive, which stays as it is, goes on under an attack."""
        senses = self.core.senses
        fixed = (self.config, self.course, senses._readers, senses._tracker)
        past = (self.sent, self.truth, self.modes)  # of what never changes
        drive = deepcopy(self, {**{id(one): one for one in fixed}, **{id(many): many[:] for many in past}})
        drive.attack = attack
        return drive.run()

    def run(self) -> Drive:
        """Let the attack have its way on a settled drive, and go on for a while after the product has let go."""
        end = self.onset + self.attack.seconds
        while self.t < end or self.t - AFTER < self.ended() < math.inf:  # what it lets go with is seen whole
            self.step()
            if self.t > self.onset and self.mode != "ENGAGED" and self.ended() < self.t - AFTER:
                break
        return self

    # ---- judging ----------------------------------------------------------------------------------------------

    def engaged_at_onset(self) -> bool:
        """Was the product driving when the attack began?"""
        before = [mode for t, mode, _ in self.modes if t < self.onset]
        return bool(before) and before[-1] == "ENGAGED"

    def ended(self) -> float:
        """When it let go after the onset [s]; infinite if it did not."""
        return next((t for t, mode, _ in self.modes if t >= self.onset and mode != "ENGAGED"), math.inf)

    def cause(self) -> str:
        return next((cause for t, mode, cause in self.modes if t >= self.onset and mode != "ENGAGED"), "")

    def silence(self) -> float:
        """From the onset to the last frame with enable = 1 [s]."""
        return max((t for t, _, enable in self.sent if enable), default=self.onset) - self.onset

    def before(self) -> float:
        """How far off the true car was in the last half second before the onset [m]."""
        return max((abs(e) for t, e, _, _ in self.truth if self.onset - 0.5 <= t <= self.onset), default=0.0)

    def excess(self) -> float:
        """How much further off it got while the product steered it [m]."""
        during = [abs(e) for t, e, _, steered in self.truth if t >= self.onset and steered]
        return max(during, default=0.0) - self.before()

    def reached(self, off: float) -> float:
        """When it was further off by so much [s], from the onset; inf: never."""
        most = self.before() + off
        return next((t for t, e, _, _ in self.truth if t > self.onset and abs(e) > most), math.inf) - self.onset

    def a_y(self) -> float:
        """Largest true lateral acceleration while the product steered [m/s^2]."""
        return max((abs(a) for t, _, a, steered in self.truth if steered), default=0.0)

    def bus_faults(self) -> list[str]:
        """What was wrong on the bus: enabled frames after the end, too few neutral ones, too fast a wheel."""
        found = []
        ended = self.ended()
        engaged_anew = any(t > ended and mode == "ENGAGED" for t, mode, _ in self.modes)
        if any(enable for t, _, enable in self.sent if t > ended + 1e-9) and not engaged_anew:
            found.append("enabled frames after the end")
        neutral = [t for t, _, enable in self.sent if t >= ended and not enable]
        if math.isfinite(ended) and len(neutral) < 5:
            found.append(f"{len(neutral)} neutral frames")
        enabled: Sequence[tuple[float, float, bool]] = [s for s in self.sent if s[2]]
        for a, b in pairwise(enabled):
            if b[0] - a[0] < 0.5 and abs(b[1] - a[1]) > 9.6 * min(b[0] - a[0], 0.06) + 2e-3:
                found.append(f"the wheel was to turn by {b[1] - a[1]:.3f} rad in {b[0] - a[0]:.3f} s")
        return found

    def complaints(self, harmless: float = 0.25) -> list[str]:
        """What was not as it should be; nothing, if all was.

        harmless: how much further off the path an attack may bring the car that needs no answer [m].
        """
        attack, found = self.attack, self.bus_faults()
        if not self.engaged_at_onset():
            found.append(f"not engaged at the onset: {self.core.obstacles()}")
        if not self.excess() <= attack.excess_max:
            found.append(f"{self.excess():.2f} m further off the path ({self.cause()})")
        if not self.a_y() <= attack.a_y_max:
            found.append(f"a_y {self.a_y():.2f} m/s^2")
        unnoticed = math.isinf(self.ended())
        if unnoticed and not (attack.harmless or attack.physics):
            found.append("went unnoticed")
        if unnoticed and attack.harmless and not self.excess() < harmless:
            found.append(f"not as harmless as it was thought to be: {self.excess():.2f} m")
        return found


@cache
def settled(
    course: str, where: str, speed: float, kinematic: bool = False, vehicle: str = "", lead: float = 0.0
) -> Drive:
    """A drive as far as all attacks there have in common."""
    none = Attack("none", course=course, where=where)
    return Drive(none, speed, lead=lead, kinematic=kinematic, vehicle=vehicle).settle()


def through_port(port: str, attack: Attack, *, speed: float) -> Drive:
    return Drive(attack, speed, port=port).settle().run()


def driven(attack: Attack, *, speed: float) -> Drive:
    return settled(attack.course, attack.where, speed).under(attack)
