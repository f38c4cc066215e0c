"""The port of a production car: the car server's commands as the maker's frames, and the maker's frames as its reports.

What the car server sees is a kit: a command with an angle, and a report. Between it and the car stands opendbc's
interface for the platform, which reads the car's frames and writes those that steer it, within its own limits.
"""

import contextlib
import math
import socket
import struct
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from steerkit.car.config import CarConfig
from steerkit.car.production.car_frames import steering_messages
from steerkit.car.production.platforms import Platform, platform
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.estimators.torque_map import TorqueMap

STEP = 0.01
"""Period at which a port works [s]."""
WATCHDOG = 0.1
"""Age of a command from which the port no longer steers [s]."""
SILENCE = 0.1
"""Without any frame of the car for so long, nothing is sent [s]."""
FROZEN = 0.15
"""A moving car all of whose frames are the same for so long does not say how it moves [s]."""
RELEASED = 0.1
"""After a frame that the safety code rejected, steering rests so long [s]: port and safety code begin anew from the
wheel as it is."""
REJECTIONS = 3
"""So many of them within a second are a fault."""
OTHER = 1.0
"""For so long after a frame that steers and that the port did not send, another computer steers too [s]."""
REJECTED_BUS = 192
"""A panda gives a frame back with its bus and this added when its safety code has rejected it."""
SENT_BUS = 128
"""And with this added when it was sent."""
GEARS = ("drive", "eco", "sport", "low", "brake", "manumatic")
P_GAIN, I_GAIN = 0.3, 0.3
"""Of the torque: share of the missing lateral acceleration [1], and what it grows by in a second [1/s]."""
_FRICTION_WIDTH = 0.05  # m/s^2: a change of what is wanted after which friction is believed to act the other way
_LARGEST_INTEGRAL = 0.5  # m/s^2
_SMOOTH = 0.1  # s: of the rate at which the car turns in, as an angle comes in steps


class Frame(NamedTuple):
    """A frame of the car's buses."""

    frame_id: int
    data: bytes
    bus: int


class Step(NamedTuple):
    """What a step of the port gives."""

    to_car: list[Frame]
    reports: list[tuple[int, bytes]]
    """(id, data) for the car server."""


class Port:
    """The port of `config`'s platform; `step` it every 10 ms. Equal frames at equal times give equal frames.

    What goes to the car: for an angle the command, for a curvature kappa = tan(delta)/(L + K v^2) of it, for a torque
    what the car's lateral-acceleration map says of a_y = v^2 kappa: friction acts against the way in which that changed
    last; and a proportional and integral share of what a_y, as the wheel stands, lacks of what was wanted so long ago
    as the steering takes. It steers while a command with `enable` is younger than
    `WATCHDOG`, cruise control is engaged and nothing is wrong; else its frames ask for nothing, and without frames of
    the car it sends none. Raises ValueError without opendbc.
    Source: opendbc 0.3.1 (MIT), `car/interfaces.py`; the controller is that of openpilot's latcontrol_torque.
    """

    def __init__(self, config: CarConfig):
        from opendbc.car import structs
        from opendbc.car.can_definitions import CanData

        self.config, self.platform = config, platform(config.port)
        self.interface = self.platform.interface()
        self._control, self._can_data = structs.CarControl, CanData
        self._readers = [r for r in config.readers if r.name.startswith("PORT_")]
        self._pending: list[tuple[int, bytes, int]] = []
        self._heard = self._received = self._released = self._other = -math.inf
        self._steers = steering_messages(self.platform, self.interface)
        self._own: set[tuple[int, int]] = set()  # (id, bus) of the frames that steer
        self._command, self._enable = math.nan, False
        self._rejected: deque[float] = deque()
        self._data: dict[tuple[int, int], bytes] = {}
        self._changed = -math.inf
        self._k = self._count = 0
        lateral = self.platform.lateral
        self._map = TorqueMap(gain=lateral.gain, friction=min(1.0, lateral.friction))
        self._fit, self._integral, self._a_y, self._turning = self._map.init(), 0.0, 0.0, 0.0
        self._rubs, self._goal, self._goals = (
            0.0,
            math.nan,
            deque([math.nan], maxlen=1 + round((config.delay + config.lag) / STEP)),
        )
        self._torques = deque([0.0], maxlen=1 + round((config.delay + config.lag) / STEP))
        self.steering = False
        """Did the last frames ask for steering?"""
        self.state: Any = None
        """What the library read last of the car, its `CarState`."""
        self.flags: dict[str, bool] = {}
        """What must not be, by the names of the report's signals."""

    def receive(self, t: float, frame: Frame) -> None:
        """A frame of the car's buses at time t [s]; those that a panda gives back are told from them by their bus."""
        if frame.bus >= REJECTED_BUS:
            self._rejected.append(t)
            self._released = t
            return
        if frame.bus < SENT_BUS:
            self._received, of = t, (frame.frame_id, frame.bus)
            if of in self._own:
                self._other = t
            if self._data.get(of) != frame.data:
                self._data[of], self._changed = frame.data, t
        self._pending.append(frame)

    def command(self, t: float, data: bytes) -> None:
        """The car server's command frame at time t [s]."""
        self._command, self._enable, _ = self.config.writer.read(data)
        self._heard = t

    def step(self, t: float) -> Step:
        """Read what has come since the last step, and write the frames of this one; t [s]."""
        nanos = round(t * 1e9)
        frames = [self._can_data(*frame) for frame in self._pending]
        self._pending.clear()
        state = self.interface.update([(nanos, frames)])
        while self._rejected and self._rejected[0] <= t - 1.0:
            self._rejected.popleft()
        silent = not t - self._received < SILENCE
        self.state, self.flags = state, self._flags(t, state, silent=silent)
        self._k += 1
        self.steering = self._may_steer(t, state)
        sends: list[Frame] = []
        if not silent:
            request = self._request(state, self.steering)
            _, frames_out = self.interface.apply(request.as_reader(), nanos)
            sends = [Frame(a, bytes(d), b) for a, d, b in frames_out if b < SENT_BUS]
            self._own.update((frame.frame_id, frame.bus) for frame in sends if frame.frame_id in self._steers)
        reports = self._reports(t, state)
        now = self._k % 2 == 0 and self._received > -math.inf
        return Step(sends, reports if now else [])

    def _flags(self, t: float, state: Any, *, silent: bool) -> dict[str, bool]:
        numbers = state.steeringAngleDeg + state.vEgoRaw
        unheard = silent or (state.vEgoRaw > 1.0 and not t - self._changed < FROZEN)
        return {
            "CAN_INVALID": unheard or not state.canValid or state.canTimeout or not math.isfinite(numbers),
            "STEERING_FAULT": state.steerFaultTemporary or state.steerFaultPermanent,
            "SENSOR_FAULT": state.vehicleSensorsInvalid,
            "FRAMES_REJECTED": len(self._rejected) >= REJECTIONS,
            "CRUISE_OFF": not state.cruiseState.enabled,
            "NOT_IN_DRIVE": str(state.gearShifter) not in GEARS,
            "DOOR_OPEN": state.doorOpen,
            "BELT_OPEN": state.seatbeltUnlatched,
            "TOO_SLOW": state.vEgoRaw < self.platform.slowest,
            "OTHER_SENDER": t - self._other < OTHER,
        }

    def _may_steer(self, t: float, state: Any) -> bool:
        commanded = self._enable and t - self._heard < WATCHDOG and math.isfinite(self._command)
        human = state.steeringPressed or state.steeringDisengage or state.brakePressed
        rests = t - self._released < RELEASED  # a frame was rejected
        return commanded and not (human or rests or any(self.flags.values()))

    def _request(self, state: Any, active: bool) -> Any:
        control = self._control()
        control.enabled = control.latActive = active
        v, to = max(float(state.vEgoRaw), 0.0), control.actuators
        wanted = self._command if active else radians_of(state.steeringAngleDeg)
        match self.platform.steered_by:
            case "angle":
                to.steeringAngleDeg = float(degrees_of(wanted))
            case "curvature":
                a_y = v * v * self._kappa(wanted, v)
                self._rubs, self._goal = (self._way(a_y), a_y) if active else (0.0, math.nan)
                played = self.platform.play * self._rubs / max(v * v, 1.0)
                to.curvature = -float(self._kappa(wanted, v) + played)  # opendbc counts it to the right
            case _:
                to.torque = self._torque(state, wanted, v, active)
        return control

    def _kappa(self, delta_sw: float, v: float) -> float:
        car = self.config.vehicle
        return math.tan(delta_sw / car.steer_ratio) / (car.wheelbase + car.understeer_gradient * v * v)

    def _way(self, goal: float) -> float:
        """Which way friction or play acts once this is wanted [m/s^2], from -1 to 1: against how that changed last."""
        changed = 0.0 if math.isnan(self._goal) else goal - self._goal
        return max(-1.0, min(1.0, self._rubs + changed / _FRICTION_WIDTH))

    def _torque(self, state: Any, wanted: float, v: float, active: bool) -> float:
        a_y = v * v * self._kappa(radians_of(state.steeringAngleDeg), v)
        self._turning += (STEP / _SMOOTH) * ((a_y - self._a_y) / STEP - self._turning) if active else -self._turning
        self._a_y = a_y
        if not active:
            self._integral = self._rubs = 0.0
            self._goal = math.nan
            self._torques.append(0.0)
            self._goals.clear()
            return 0.0
        self._fit = self._map.update(self._fit, u=self._torques[0], a_y=a_y, turning=self._turning, dt=STEP)
        known = self._map.found(self._fit)
        goal = v * v * self._kappa(wanted, v)
        self._rubs, self._goal = self._way(goal), goal
        self._goals.append(goal)
        missing = self._goals[0] - a_y
        asked = goal - known.offset + P_GAIN * missing + self._integral
        torque = asked / known.gain + known.friction * self._rubs
        if abs(torque) < 1.0:
            reached = self._integral + I_GAIN * missing * STEP
            self._integral = max(-_LARGEST_INTEGRAL, min(_LARGEST_INTEGRAL, reached))
        torque = max(-1.0, min(1.0, torque))
        self._torques.append(torque)
        return torque

    def _reports(self, t: float, state: Any) -> list[tuple[int, bytes]]:
        self._count += self._k % 2 == 0
        values = {
            "delta_sw": radians_of(state.steeringAngleDeg),
            "echo": self._command if math.isfinite(self._command) else 0.0,
            "v_kit": float(state.vEgoRaw),
            "torque": 0.0,  # in units of its maker's: what it means is in `override`
            "enabled": float(self.steering or (self._enable and t - self._released < RELEASED)),
            "override": float(state.steeringPressed or state.steeringDisengage),
            "timeout": float(self._enable and not t - self._heard < WATCHDOG),
            "brake": float(state.brakePressed),
            "accelerator": float(state.gasPressed),
            **{f"fault:{name}": float(up) for name, up in self.flags.items()},
        }
        return [(reader.frame_id, reader.write(values, count=self._count)) for reader in self._readers]


_HEAD = struct.Struct("<IBB")
"""Of a frame in a socket: id, bus, length of the data."""
_TOGETHER = 500
"""Frames in a datagram, at most: whatever their length, they fit."""
_KIND = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
_BEAT = 0.3  # s between two heartbeats; a panda without one for seconds no longer lets steer


def line_of(table: dict[str, Any], platform: Platform) -> "Line":
    """The line that `[port]` describes, open; raises ValueError for a channel that is none, OSError where none answers.

    table: `line`, `channel` (a panda's serial number, "" for the only one; HOST:PORT of a simulated car).
    """
    channel = str(table.get("channel", ""))
    return SocketLine(channel) if table.get("line") == "socket" else PandaLine(platform, channel)


class PandaLine:
    """A panda, by its own library: USB, and the safety code of the platform inside it. Its harness has a relay that
    puts the computer in the camera's place. The other lines have the same methods."""

    def __init__(self, platform: Platform, serial: str):
        try:
            from panda import Panda
        except ImportError as error:
            raise OSError("[port] line = 'panda': its library is not installed (github.com/commaai/panda)") from error
        try:
            self._panda = Panda(serial or None)
            safety = platform.params.safetyConfigs[-1]
            self._panda.set_safety_mode(safety.safetyModel.raw, safety.safetyParam)
        except Exception as error:  # whatever its library raises of USB
            raise OSError(f"panda {serial or '(the only one)'}: cannot be opened ({error})") from error
        self._beaten = -1e9

    def receive(self) -> list[Frame]:
        """All that has come; at once. Raises OSError when the line is lost."""
        return [Frame(a, bytes(d), b) for a, d, b in self._panda.can_recv()]

    def send(self, frames: Sequence[Frame], *, steering: bool, t: float) -> None:
        """Frames to the car; steering: do they ask for it?"""
        if frames:
            self._panda.can_send_many([(f.frame_id, f.data, f.bus) for f in frames])
        if t - self._beaten >= _BEAT:
            self._beaten = t
            self._panda.send_heartbeat(steering)

    def close(self) -> None:
        """Let go of it."""
        with contextlib.suppress(Exception):
            self._panda.set_safety_mode(0)  # silent: the car is its maker's again
            self._panda.close()


def _heard(end: socket.socket) -> Iterator[tuple[bytes, Any]]:
    """The datagrams that have come, and whose they are; raises OSError where the other end is known and gone."""
    with contextlib.suppress(BlockingIOError):
        while True:
            yield end.recvfrom(65536)


def _datagrams(frames: Sequence[Frame]) -> Iterator[bytes]:
    for at in range(0, len(frames), _TOGETHER):
        yield b"".join([_HEAD.pack(f.frame_id, f.bus, len(f.data)) + f.data for f in frames[at : at + _TOGETHER]])


def _frames(text: bytes) -> Iterator[Frame]:
    at = 0
    while at + _HEAD.size <= len(text):
        frame_id, bus, length = _HEAD.unpack_from(text, at)
        at += _HEAD.size + length
        if at <= len(text):  # whole ones only
            yield Frame(frame_id, text[at - length : at], bus)


class SocketLine(contextlib.ExitStack):
    """A simulated car in another process, at 127.0.0.1:PORT. What does not fit is dropped, as a full adapter does."""

    def __init__(self, address: str):
        host, _, port = address.removeprefix("socket://").rpartition(":")
        if host not in ("127.0.0.1", "localhost") or not port.isdigit():
            raise ValueError(f"[port] channel {address!r}: expected 127.0.0.1:PORT, of a simulated car")
        super().__init__()
        self._end = self.enter_context(socket.socket(socket.AF_INET, _KIND))
        self._end.connect(("127.0.0.1", int(port)))
        for _ in range(2):  # so that the car knows where its port is; the second one fails if none was there to hear
            self._end.send(b"")

    def receive(self) -> list[Frame]:
        try:
            return [frame for text, _ in _heard(self._end) for frame in _frames(text)]
        except ConnectionRefusedError as error:
            raise OSError("the simulated car is gone") from error

    def send(self, frames: Sequence[Frame], *, steering: bool, t: float) -> None:
        with contextlib.suppress(BlockingIOError):
            for text in _datagrams(frames):
                self._end.send(text)


class SocketServer(contextlib.ExitStack):
    """The simulated car's end: serves the port that came last."""

    def __init__(self) -> None:
        super().__init__()
        self._end = self.enter_context(socket.socket(socket.AF_INET, _KIND))
        self._end.bind(("127.0.0.1", 0))
        self.channel = f"127.0.0.1:{self._end.getsockname()[1]}"
        self._port: Any = None

    def receive(self) -> list[Frame]:
        """What the port sent."""
        frames: list[Frame] = []
        for text, port in _heard(self._end):
            self._port = self._port if text else port
            frames += _frames(text) if port == self._port else ()
        return frames

    def send(self, frames: Sequence[Frame]) -> None:
        """Frames to the port, if there is one."""
        with contextlib.suppress(OSError):
            for text in _datagrams(frames) if self._port else ():
                self._end.sendto(text, self._port)


Line = PandaLine | SocketLine
