"""The line between a port and the buses of its car: a panda, adapters of python-can, or a simulated car's socket."""

import contextlib
import socket
import struct
from collections.abc import Iterator, Sequence
from typing import Any

from steerkit._support.errors import known
from steerkit.car.ports import lost, open_bus, python_can
from steerkit.car.production.platforms import Platform
from steerkit.car.production.port import Frame

LINES = ("panda", "python-can", "socket")
"""What a port may reach its car by: `[port] line`."""
_HEAD = struct.Struct("<IBB")
"""Of a frame in a socket: id, bus, length of the data."""
_TOGETHER = 500
"""Frames in a datagram, at most: whatever their length, they fit."""
_KIND = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
_BEAT = 0.3  # s between two heartbeats; a panda without one for seconds no longer lets steer


def line_of(table: dict[str, Any], platform: Platform) -> "Line":
    """The line that `[port]` describes, open; raises ValueError for a kind that is none, OSError where it is not there.

    table: `line`, `channel` (a panda's serial number, "" for the only one; HOST:PORT of a simulated car), `channels`
    (of python-can, by the number of the car's bus), `interface` and `bitrate` of python-can.
    """
    match known(str(table.get("line", "panda")), LINES, "[port] line"):
        case "panda":
            return PandaLine(platform, str(table.get("channel", "")))
        case "socket":
            return SocketLine(str(table.get("channel", "")))
        case _:
            return CanLine(table)


class PandaLine:
    """A panda, by its own library: USB, and the safety code of the platform inside it. Its harness has a relay that
    puts the computer in the camera's place. The other lines have the same methods."""

    def __init__(self, platform: Platform, serial: str):
        try:
            from panda import Panda
        except ImportError as error:
            raise OSError(
                "[port] line = 'panda': its library is not installed (github.com/commaai/panda); "
                "or give line = 'python-can'"
            ) from error
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


class CanLine(contextlib.ExitStack):
    """Adapters of python-can, one for each bus of the car. No safety code stands between: the gate and the port are
    the last word, and the maker's camera must be disconnected by other means."""

    def __init__(self, table: dict[str, Any]):
        super().__init__()
        self._buses: dict[int, Any] = {}
        more: dict[str, Any] = {key: table[key] for key in ("interface", "bitrate") if key in table}
        for number, channel in enumerate(table.get("channels", ())):
            if channel != "":
                self._buses[number] = open_bus({**more, "channel": channel})
                self.callback(self._buses[number].shutdown)

    def receive(self) -> list[Frame]:
        frames = []
        for number, bus in self._buses.items():
            try:
                while (message := bus.recv(0.0)) is not None:
                    if not (message.is_error_frame or message.is_remote_frame):
                        frames.append(Frame(message.arbitration_id, bytes(message.data), number))
            except Exception as error:
                raise lost(error) from error
        return frames

    def send(self, frames: Sequence[Frame], *, steering: bool, t: float) -> None:
        can = python_can()
        for frame_id, data, number in frames:
            if number in self._buses:
                message = can.Message(
                    arbitration_id=frame_id, data=data, is_extended_id=frame_id >= 0x800, is_fd=len(data) > 8
                )
                try:
                    self._buses[number].send(message)
                except Exception as error:
                    raise lost(error) from error


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


Line = PandaLine | CanLine | SocketLine
