"""The real car as a block, and its line to the car server."""

import contextlib
import math
import os
import socket
import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number
from steerkit.car import protocol
from steerkit.car.protocol import Adapted, Filtered, Snapshot
from steerkit.car.state_machine import Mode, Order
from steerkit.diagram import maths as m
from steerkit.diagram.block import Out
from steerkit.plants.single_track import Car
from steerkit.task import DT


class CarLost(ConnectionError):
    """The car server is gone or does not answer: there is no car any more."""


class CarClient(contextlib.ExitStack):
    """A line to the car server over its Unix socket.

    socket_path: as given to the car server. controller: may it ask for angles? Others may look, and give orders.
    course: `protocol.digest` of the course that it drives. name: what panels call it.
    timeout [s]: longest wait for an answer; of a car server that ends, one hears at once, and one that stands still
    lets go of the wheel by itself. Raises CarLost when no car server answers, now or later. `close` hangs up; the car
    server disengages if this was its controller.
    """

    def __init__(
        self,
        socket_path: str,
        *,
        controller: bool = True,
        timeout: float = 1.0,
        course: str = protocol.NO_COURSE,
        name: str = "",
    ):
        super().__init__()
        self.path, self.misses = socket_path, 0
        self.last: Snapshot | None = None
        self.refused: list[str] = []
        """What the car server refused, and why; whoever shows it may clear it."""
        self._socket = self.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        self._socket.settimeout(timeout)
        try:
            self._socket.connect(socket_path)
        except OSError as error:
            raise CarLost(
                f"{socket_path}: no car server answers there ({error.strerror}); start one with "
                "`steerkit car server`, or see its log"
            ) from error
        if not _ours(self._socket):
            raise CarLost(f"{socket_path}: the process there is another user's; it is not trusted")
        self._send(protocol.Hello(controller, course=course, name=name))
        self.query()
        if self.refused:
            raise CarLost(f"{socket_path}: {self.refused[0]}")

    def query(self) -> Snapshot:
        """What the car server knows now."""
        self._send(protocol.Query())
        while True:
            try:
                packet = self._socket.recv(protocol.MAX_PACKET)
            except OSError as error:
                raise CarLost(f"{self.path}: the car server does not answer ({error})") from error
            if not packet:
                raise CarLost(f"{self.path}: the car server has ended")
            try:
                message = protocol.decode(packet)
            except ValueError as error:
                other = f"the car server speaks another version of the protocol than {protocol.VERSION}"
                raise CarLost(f"{self.path}: {other}: end it and start it anew ({error})") from error
            if isinstance(message, protocol.Refused):
                self.refused.append(message.why)
            elif isinstance(message, Snapshot):
                self.last = message
                return message

    def request(self, delta_sw: float) -> None:
        """Ask for an angle [rad], computed from the last snapshot; `misses` goes with it."""
        basis = math.nan if self.last is None else self.last.t
        self._send(protocol.Request(basis, delta_sw, self.misses))

    def note(self, message: protocol.Beat | protocol.Remark | protocol.Estimates | Adapted | Filtered) -> None:
        """Say what moves nothing: that the operator's keys were just read, or what is for the recording."""
        self._send(message)

    def order(self, order: Order) -> None:
        """Give an order; what comes of it shows in later snapshots and in `refused`."""
        self._send(protocol.Command(order))

    def wait(self, *modes: Mode, timeout: float, wall: float = 0.01) -> Snapshot:
        """The first snapshot in one of `modes` (none given: with a pose); raises CarLost after `timeout` [s]."""
        end = time.monotonic() + timeout
        while True:
            snapshot = self.query()
            if snapshot.mode in modes or (not modes and math.isfinite(snapshot.x + snapshot.psi + snapshot.delta_sw)):
                return snapshot
            if time.monotonic() > end:
                wanted = " or ".join(modes) or "a pose and a report"
                raise CarLost(f"{self.path}: no {wanted} within {timeout:g} s; {snapshot.mode}: {snapshot.text}")
            time.sleep(wall)

    def _send(self, message: protocol.Message) -> None:
        try:
            self._socket.send(protocol.encode(message))
        except OSError as error:
            raise CarLost(f"{self.path}: the car server is gone ({error.strerror})") from error


def _ours(line: socket.socket) -> bool:
    """Does the process at the other end belong to this user, or to root?"""
    _, uid, _ = struct.unpack("3i", line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
    return uid in (os.getuid(), 0)


class ReplayLink:
    """A recorded run in the place of a car: snapshots come from the recording, requests are collected."""

    def __init__(self, snapshots: Sequence[Snapshot]):
        self._snapshots = iter(snapshots)
        self.count = 0
        """Snapshots given."""
        self.last: Snapshot | None = None
        self.requests: list[tuple[float, float]] = []
        """(basis, delta_sw) asked for."""

    def query(self) -> Snapshot:
        """The next recorded snapshot; raises CarLost at the recording's end."""
        self.last = next(self._snapshots, None)
        if self.last is None:
            raise CarLost("the recording has ended")
        self.count += 1
        return self.last

    def request(self, delta_sw: float) -> None:
        """Keep what was asked for."""
        assert self.last is not None
        self.requests.append((self.last.t, delta_sw))

    def note(self, message: Adapted) -> None:
        """Nothing: what a controller believes is in the recording."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RealCar(Car):
    """A car on a CAN bus, with the ports of the simulated plants; the only block that is not pure.

    Its outputs are the car server's last good readings at the moment of the sample; its input is sent on, and
    moves the wheel only while the car server is ENGAGED, after its checks and its gate.

    inputs: delta_sw_cmd [rad]; v_cmd [m/s], not used: the human keeps the speed. outputs: x, y [m] of the centre of
    gravity; psi [rad]; v [m/s]; beta [rad]; r [rad/s]; a_y [m/s^2]; delta_sw [rad], measured; engaged [1];
    applied [rad], the angle that the gate let through last, or while not engaged the measured one.
    state: none. Raises CarLost when the car server is gone; TypeError when it is batched or traced.

    link: a `CarClient`, `ReplayLink`, or what else has `last`, `query`, `request` and `note`. dt [s]: sample time.
    """

    engaged = Out("1", direct=())
    applied = Out("rad", direct=())

    pure = False
    link: Any
    dt: float = number(DT, "s", above=0.0, high=1.0)

    def init(self, batch: tuple[int, ...] = ()) -> tuple[Any, ...]:
        if batch:
            raise TypeError("RealCar: there is one car, it cannot be batched; simulate with NonlinearSingleTrack")
        return ()

    def output(self, t: Any, x: Any, u: Any) -> Any:
        if m.is_symbol(t):
            raise TypeError("RealCar: a real car cannot be traced; put NonlinearSingleTrack in its place")
        s = self.link.query()
        engaged = 1.0 if s.mode is Mode.ENGAGED else 0.0
        applied = s.command if engaged else s.delta_sw
        return self.Y(s.x, s.y, s.psi, s.v, s.beta, s.r, s.a_y, s.delta_sw, engaged, applied)

    def update(self, t: Any, x: Any, u: Any, y: Any) -> tuple[Any, ...]:
        self.link.request(float(u.delta_sw_cmd))
        return ()
