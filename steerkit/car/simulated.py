"""A car to test against: the nonlinear plant behind the same DBC, with its kit, its human, and faults on demand."""

import math
import random
from collections import deque
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path as File
from typing import Any

from steerkit._support.files import read_toml
from steerkit.car.config import CarConfig
from steerkit.car.ports import FrameReader
from steerkit.controllers.stanley import Stanley
from steerkit.paths.tracker import PathTracker
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.plants.speed_driver import CurveSpeedDriver, SpeedDriver
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.vehicles import Vehicle

STEP = 0.01
"""Step of the plant, and period of the pose [s] where the configuration gives none; the kit's is twice as long."""
WATCHDOG = 0.1
"""Silence after which the kit lets go of the wheel [s]."""
HUMAN_EVERY = 5
BENDS = 2.3
"""Largest a_y that the human drives at [m/s^2]."""
HANDS = 0.1
"""Lag of the human's hands at the wheel [s]."""
_TABLES = read_toml(File(__file__).with_suffix(".toml"), "faults")
FAULTS, _SAID = _TABLES["faults"], _TABLES["said"]
"""What can go wrong on demand, by kind; and of some, the quantity that says what it then says."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something that goes wrong from `start` [s] for `length` [s]."""

    kind: str
    target: str
    start: float
    length: float = math.inf
    amount: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in FAULTS or self.target not in ("pose", "report"):
            raise ValueError(f"Fault: {self.kind!r} of {self.target!r}; valid: {', '.join(FAULTS)}; of pose, report")

    def active(self, t: float) -> bool:
        """Does it act at time t [s]?"""
        return self.start <= t < self.start + self.length


class SimulatedCar:
    """Car, kit, sensors and human; `advance` it in time, `receive` what the bus brings.

    config: the same as the car server's: the frames it reads are sent, the one it writes is understood, and its
    course is where the human drives, by Stanley's law while the kit is off, at v_min to v_max [m/s], less in bends (a_y
    within bends [m/s^2]). s [m], e [m]: where it starts. t0 [s]: when.

    What controllers do not know: vehicle, the car that it is (default: the configuration's); lag and delay [s] from a
    command to the wheel, which the human's hands do not have; offset [rad], which the road wheels see and the wheel's
    sensor does not; rate_zero [rad/s], of its gyro.
    """

    def __init__(
        self,
        config: CarConfig,
        *,
        v_min: float = 4.0,
        v_max: float = 6.0,
        seed: int = 0,
        s: float = 0.0,
        e: float = 0.0,
        t0: float = 0.0,
        vehicle: Vehicle | None = None,
        lag: float = 0.1,
        delay: float = 0.0,
        offset: float = 0.0,
        rate_zero: float = 0.0,
        bends: float = BENDS,
    ):
        path = config.course
        self.config, self.readers, self.faults = config, config.readers, list[Fault]()
        self.driver = Stanley.of(config.vehicle)
        self.t, self.k = t0, 0
        self.tracker = PathTracker(path=path, reference=config.vehicle.l_f, dt=STEP)
        speed = SpeedDriver(v_min=v_min, v_max=v_max, seed=seed, dt=STEP)
        self.pedals = CurveSpeedDriver(path=path, driver=speed, a_y_max=bends, dt=STEP)
        self.hands, self.motor = SteeringActuator(lag=HANDS, dt=STEP), SteeringActuator(lag=lag, dt=STEP)
        self.delay, self.offset, self.rate_zero, self.turned = delay, offset, rate_zero, 0.0
        (x, y), psi = path.point(s), float(path.psi(s))
        pose: dict[str, Any] = {"x0": float(x) - e * math.sin(psi), "y0": float(y) + e * math.cos(psi), "psi0": psi}
        self.plant = NonlinearSingleTrack(vehicle=vehicle or config.vehicle, v0=v_min, dt=STEP, **pose)
        self.x: dict[str, Any] = {"plant": self.plant.init(), "motor": self.motor.init(), "pedals": self.pedals.init()}
        self.now = self.plant.output(0.0, self.x["plant"], ())
        seen = self._seen()
        place = self.tracker.settle(0.0, self.tracker.init(), seen)
        self.x |= {"tracker": place, "driver": self.driver.init()}
        self.on_path = self.tracker.output(0.0, place, seen)
        self.steered = self._reached = 0.0
        # the kit
        self.enabled = self.timeout = self.overridden = False
        self.command, self.heard = 0.0, -math.inf
        self._coming: deque[tuple[float, float]] = deque()  # commands that have not got to the motor yet
        self._waiting: list[tuple[float, int, bytes]] = []  # on the way to the bus: (when, id, data)
        self._count = dict.fromkeys((reader.frame_id for reader in config.readers), 0)
        self._last: dict[Any, bytes] = {}
        self._stuck: dict[int, dict[str, float]] = {}
        self._dice = random.Random(seed)

    def receive(self, t: float, frame_id: int, data: bytes) -> None:
        """A frame from the bus at time t [s]."""
        writer = self.config.writer
        if frame_id != writer.message.frame_id or self.fault("deaf", t):
            return
        angle, enable, clear = writer.read(data)
        self.heard = t
        if clear or not enable:
            self.overridden = False
        if clear:
            self.timeout = False
        ok = enable and not (self.timeout or self.overridden or self.fault("kit_fault", t))
        if ok:
            self.command = angle
            if not self.enabled:  # it goes on from the wheel as it is
                self._coming.clear()
                self._reached = self.turned if self.delay else angle
            self._coming.append((t + self.delay, angle))
        self.enabled = ok

    def advance(self, t: float) -> list[tuple[float, int, bytes]]:
        """The frames (when, id, data) that the car sends until time t [s]."""
        while self.t + STEP <= t + 1e-9:
            self._step()
        due = sorted([frame for frame in self._waiting if frame[0] <= t + 1e-9], key=itemgetter(0))
        self._waiting = [frame for frame in self._waiting if frame[0] > t + 1e-9]
        return due

    @property
    def next(self) -> float:
        """When the next frame may come [s]."""
        return min([self.t + STEP, *[when for when, _, _ in self._waiting]])

    def _seen(self) -> Any:
        y = self.now
        return self.tracker.U(x=y.x, y=y.y, psi=y.psi, v=y.v, beta=y.beta, r=y.r)

    def _step(self) -> None:
        """One step of car, human and kit, then the frames of its end."""
        t, x = self.t, self.x
        seen = self._seen()
        place = self.tracker.output(t, x["tracker"], seen)
        v = self.pedals.output(t, x["pedals"], self.pedals.U(s=place.s)).v
        motor = self.motor.output(t, x["motor"], ())
        if self.k % HUMAN_EVERY == 0:
            known = {**place._asdict(), **self.now._asdict(), "delta_sw_meas": motor.delta_sw}
            u = self.driver.U(*[known[name] for name in self.driver.U._fields])
            y = self.driver.output(t, x["driver"], u)
            self.steered, x["driver"] = y.delta_sw, self.driver.update(t, x["driver"], u, y)
        self.overridden |= self.fault("override", t) is not None
        self.timeout |= self.enabled and t - self.heard >= WATCHDOG
        self.enabled &= not (self.timeout or self.overridden or self.fault("kit_fault", t))
        while self._coming and self._coming[0][0] <= t + 1e-9:
            self._reached = self._coming.popleft()[1]
        target = self._reached if self.enabled else self.steered
        if self.enabled and self.fault("loose", t):
            target = motor.delta_sw
        if self.enabled and self.fault("motor_sign", t):
            target = -target
        x["tracker"] = self.tracker.update(t, x["tracker"], seen, place)
        x["pedals"] = self.pedals.update(t, x["pedals"], self.pedals.U(s=place.s), ())
        turns = self.motor if self.enabled else self.hands
        x["motor"] = turns.update(t, x["motor"], turns.U(delta_sw_cmd=target), motor)
        self.turned = self.motor.output(t, x["motor"], ()).delta_sw
        x["plant"] = self.plant.update(t, x["plant"], self.plant.U(delta_sw_cmd=self.turned + self.offset, v_cmd=v), ())
        self.k += 1
        self.t += STEP
        self.now = self.plant.output(self.t, x["plant"], ())
        self.on_path = place
        self._send()

    def _values(self) -> dict[str, float]:
        y, t = self.now, self.t
        values = {
            **y._asdict(),
            "delta_sw": self.turned,
            "v_kit": y.v,
            "torque": 0.2,
            "echo": self.command if self.enabled else self.turned,
            "enabled": float(self.enabled),
            "override": float(self.overridden),
            "timeout": float(self.timeout),
            "psi": math.remainder(y.psi, 2.0 * math.pi),
            "r": y.r + self.rate_zero,
            "quality": 4.0,
            "stamp": round(t * 1e3) % 65536 * 1e-3,
            "brake": 0.0,
            "accelerator": 0.0,
        }
        values |= {quantity: value for kind, (quantity, value) in _SAID.items() if self.fault(kind, t)}
        if self.fault("kit_fault", t):
            values[self.config.fault_flags[0]] = 1.0
        if torque := self.fault("torque", t):
            values["torque"] = torque.amount or 5.0
        for kind, quantity in (("wheel_sign", "delta_sw"), ("gyro_sign", "r")):
            if self.fault(kind, t):
                values[quantity] = -values[quantity]
        for kind, target, quantity in (("jump", "", "x"), ("speed", "pose", "v"), ("speed", "report", "v_kit")):
            if off := self.fault(kind, t, target):
                values[quantity] += off.amount or 3.0
        return values

    def fault(self, kind: str, t: float, target: str = "") -> Fault | None:
        """The fault of that kind that acts at time t [s], if there is one."""
        if not self.faults:
            return None
        acting = (f for f in self.faults if f.kind == kind and f.target in (target or f.target) and f.active(t))
        return next(acting, None)

    def _send(self) -> None:
        values = self._values()
        for reader in self.readers:
            pose = reader.frame_id in self.config.pose_frames
            period = reader.period or (STEP if pose else 2.0 * STEP)
            due, before = (math.floor(k * STEP / period + 1e-6) for k in (self.k, self.k - 1))
            for _ in range(due - before):
                self._send_one(reader, values, "pose" if pose else "report")

    def _send_one(self, reader: FrameReader, values: dict[str, float], target: str) -> None:
        t, frame_id = self.t, reader.frame_id
        if self.fault("stuck", t, target):
            values = self._stuck.setdefault(frame_id, values)
        else:
            self._stuck.pop(frame_id, None)
        if self.fault("nan", t, target):
            flags = ("enabled", "override", "timeout", "brake", "accelerator", *self.config.fault_flags)
            values = {q: v if q in flags else math.nan for q, v in values.items()}
        self._count[frame_id] += 6 if self.fault("counter", t, target) else 1
        self._on_its_way(self._waiting, frame_id, reader.write(values, count=self._count[frame_id]), target)

    def _on_its_way(self, waiting: Any, frame: Any, data: bytes, target: str) -> None:
        """Have a frame, its id or what else names it, wait with its data until it is there, as the faults have it."""
        if self.fault("freeze", self.t, target):
            data = self._last.get(frame, data)
        self._last[frame] = data
        if self.fault("corrupt", self.t, target):
            broken = bytearray(data)
            broken[self._dice.randrange(len(data))] ^= 1 << self._dice.randrange(8)
            data = bytes(broken)
        if not self.fault("drop", self.t, target):
            late = self.fault("delay", self.t, target)
            waiting.append((self.t + (late.amount or 0.2 if late else 0.0), frame, data))
