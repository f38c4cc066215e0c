"""The process that owns the bus: a `Core` between a CAN bus, a Unix socket and a recording."""

import contextlib
import fcntl
import logging
import os
import queue
import select
import signal
import socket
import stat
import threading
import time
from collections import deque
from pathlib import Path as File
from typing import Any

from steerkit._support.clock import Clock
from steerkit.car import protocol
from steerkit.car.config import CarConfig
from steerkit.car.core import Core, End, Event, Frame, Link, Note, Packet, RecordingFault, Reply, Send, Tick
from steerkit.car.ports import lost, open_bus, python_can
from steerkit.car.production import port
from steerkit.car.production.platforms import platform
from steerkit.car.recording import Recording

_log = logging.getLogger("steerkit.car")
MAX_CLIENTS = 16
"""Clients at once."""
MAX_TURN = 32
"""Packets of one client before the others have their turn."""
MAX_RATE = 2000
"""Packets of one client within a second; who sends more is hung up on."""
MAX_GARBLED = 20
"""Lines within a second that are no frames, from which the adapter counts as broken."""


class CarServer:
    """The program that owns a car's bus, while clients drive: `run()` ends when it is stopped.

    config: the car and its course. socket_path: where clients find it. recording: the file to write; None for none.
    clock: time. linger [s]: how long it stays without any client.
    Raises OSError for a socket in use, or a bus that cannot be opened.
    """

    def __init__(
        self,
        config: CarConfig,
        socket_path: str,
        *,
        recording: Recording | None = None,
        clock: Clock | None = None,
        linger: float = float("inf"),
    ):
        self.config, self.recording, self.linger = config, recording, linger
        self.clock = clock or Clock()
        self.core = Core(config)
        self.stopping, self.cause = False, "the car server was stopped"
        self._server = _listen(socket_path)
        self._socket_path = socket_path
        self._clients: dict[int, socket.socket] = {}
        self._links = 0
        self._alone_since: float | None = self.clock.now()
        self._unrecorded = ""
        self._packets: dict[int, deque[float]] = {}
        self._frames: queue.SimpleQueue[tuple[float, int, bytes, str] | BaseException] = queue.SimpleQueue()
        self._woken, self._wake = os.pipe()
        os.set_blocking(self._woken, False)
        os.set_blocking(self._wake, False)
        self._bus = _open(config.bus, config.listen_only)
        threading.Thread(target=self._listen_to_bus, name="bus", daemon=True).start()
        self._port: port.Port | None = None
        self._port_lock = threading.Lock()
        if config.port:
            self._port = port.Port(config)
            self._line = port.line_of(config.line, platform(config.port))
            threading.Thread(target=self._run_port, name="port", daemon=True).start()
        if recording is None:
            self._handle(RecordingFault(self.clock.now(), "the car server has no --recording"))

    def run(self) -> None:
        """Serve until `stop`, a signal, `linger`, or an error of the bus; then the kit gets neutral frames."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda n, _: self.stop(f"the car server got {signal.Signals(n).name}"))
        try:
            while not self.stopping:
                self._turn()
        except BaseException as error:
            self.cause = f"the car server failed: {type(error).__name__}: {error}"
            raise
        finally:
            try:
                self._let_go(self.cause)
            finally:
                self.close()

    def stop(self, cause: str = "the car server was stopped") -> None:
        """End `run` soon, for that cause; may be called from anywhere."""
        if not self.stopping:
            self.cause = cause
        self.stopping = True
        with contextlib.suppress(OSError):
            os.write(self._wake, b"!")

    def close(self) -> None:
        """Free bus, socket and file, and end the bus's thread."""
        self.stopping = True
        self._server.close()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._socket_path)
        for client in self._clients.values():
            client.close()
        if self.recording:
            self.recording.close()
            if self.recording.failed:
                _log.error("THE RECORDING IS NOT WHOLE: %s", self.recording.failed)
        with contextlib.suppress(Exception):
            self._bus.shutdown()
        if self._port:
            with contextlib.suppress(Exception):
                self._line.close()

    def _turn(self) -> None:
        clock = self.clock
        pause = clock.wall(self.core.wake - clock.now())
        by_socket = {client: link for link, client in self._clients.items()}
        watched: list[Any] = [self._server, self._woken, *by_socket]
        ready, _, _ = select.select(watched, [], [], min(pause, 1.0))
        if self._woken in ready:
            with contextlib.suppress(BlockingIOError):
                os.read(self._woken, 65536)
        while not self._frames.empty():
            item = self._frames.get()
            if isinstance(item, BaseException):
                raise item
            self._handle(Frame(clock.now(), *item))
        for source in ready:
            if source is self._server:
                self._accept()
            elif source in by_socket:
                self._receive(by_socket[source], source)
        self._look_at_recording()
        self._handle(Tick(clock.now()))
        if self._alone_since is not None and clock.now() - self._alone_since > self.linger:
            self.stop(f"no client for {self.linger:g} s")

    def _handle(self, event: Event) -> None:
        outputs, broken = self.core.handle(event), None
        for out in outputs:
            match out:
                case Send():
                    try:
                        self._transmit(out)
                    except Exception as error:
                        if isinstance(event, End) or self.core.ended:
                            _log.error("a neutral frame could not be sent: %s", error)
                        else:
                            broken = broken or error
                case Reply():
                    with contextlib.suppress(OSError, KeyError):  # it hung up, or does not read: its loss
                        self._clients[out.link].send(out.data)
                case Note(topic="state", values=v):
                    _log.info("%s -> %s: %s", v["from"], v["to"], v["cause"])
                case Note(topic="refused", values=v):
                    _log.warning("%s refused: %s", v["order"], v["why"])
        if self.recording:
            self.recording.event(event, outputs)
        if broken:
            raise lost(broken) from broken

    def _look_at_recording(self) -> None:
        """A recording that stops, or goes on, is reported at once: in the log, and to the core."""
        wrong = self.recording.failed if self.recording else ""
        if wrong != self._unrecorded:
            self._unrecorded = wrong
            if wrong:
                _log.error("THE RECORDING HAS STOPPED: %s", wrong)
            else:
                _log.warning("the recording goes on")
            self._handle(RecordingFault(self.clock.now(), wrong))

    def _transmit(self, frame: Send) -> None:
        if self._port:
            with self._port_lock:
                self._port.command(self.clock.now(), frame.data)
            return
        can = python_can()
        extended = self.config.writer.message.is_extended_frame
        self._bus.send(can.Message(arbitration_id=frame.frame_id, data=frame.data, is_extended_id=extended))

    def _accept(self) -> None:
        client, _ = self._server.accept()
        if len(self._clients) >= MAX_CLIENTS:
            with client, contextlib.suppress(OSError):
                client.send(protocol.encode(protocol.Refused(f"{MAX_CLIENTS} clients are here already")))
            return
        client.setblocking(False)
        self._links += 1
        self._clients[self._links] = client
        self._alone_since = None
        self._handle(Link(self.clock.now(), self._links, True))

    def _receive(self, link: int, client: socket.socket) -> None:
        times = self._packets.setdefault(link, deque(maxlen=MAX_RATE))
        for _ in range(MAX_TURN):
            try:
                packet = client.recv(protocol.MAX_PACKET)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            wall = time.monotonic()
            if len(times) == MAX_RATE and wall - times[0] < 1.0:
                _log.warning("client %d sent more than %d packets in a second: it is hung up on", link, MAX_RATE)
                packet = b""
            times.append(wall)
            if not packet:
                break
            self._handle(Packet(self.clock.now(), link, packet))
        else:
            return  # the others have their turn
        client.close()
        del self._packets[link]
        del self._clients[link]
        if not self._clients:
            self._alone_since = self.clock.now()
        self._handle(Link(self.clock.now(), link, False))

    def _let_go(self, cause: str) -> None:
        """Off for that cause, and the neutral frames that go with it."""
        self._handle(End(self.clock.now(), cause))
        for _ in range(20):
            if self.core.quiet:
                return
            self.clock.sleep_until(self.core.wake)
            self._handle(Tick(self.clock.now()))

    def _listen_to_bus(self) -> None:
        """The bus's thread: frames with their time of arrival into a queue; interfaces differ in how to wait."""
        garbled: deque[float] = deque(maxlen=MAX_GARBLED)
        while not self.stopping:
            try:
                message = self._bus.recv(0.1)
            except Exception as error:
                message = error
                if isinstance(error, (ValueError, IndexError)) or isinstance(error.__cause__, ValueError):
                    # a line that is no frame, which python-can cannot read: counted, not the end
                    garbled.append(time.monotonic())
                    if len(garbled) < MAX_GARBLED or garbled[-1] - garbled[0] > 1.0:
                        self._put((self.clock.now(), -1, str(error.__cause__ or error).encode()[:200], "bad"))
                        if error.__cause__:  # slcan would find what it cannot decode before every later line
                            with contextlib.suppress(Exception):
                                self._bus.flush()
                        continue
            if isinstance(message, Exception):
                if not self.stopping:
                    self._put(lost(message))
                return
            if message is None or message.is_error_frame or message.is_remote_frame:
                continue
            kind = "fd" if message.is_fd else "x" if message.is_extended_id else ""
            self._put((self.clock.now(), message.arbitration_id, bytes(message.data), kind))

    def _run_port(self) -> None:
        """The port's thread: a step every 10 ms; one that comes late is not made up for."""
        assert self._port is not None
        due = self.clock.now()
        try:
            while not self.stopping:
                frames, now = self._line.receive(), self.clock.now()
                with self._port_lock:
                    for frame in frames:
                        self._port.receive(now, frame)
                    step = self._port.step(now)
                if not self.config.listen_only:
                    self._line.send(step.to_car, steering=self._port.steering, t=now)
                if self.recording:
                    self.recording.frames(now, frames, step.to_car)
                for frame_id, data in step.reports:
                    self._put((now, frame_id, data, ""))
                due = max(due + port.STEP, now)
                self.clock.sleep_until(due)
        except Exception as error:
            if not self.stopping:
                self._put(lost(error))

    def _put(self, item: tuple[float, int, bytes, str] | Exception) -> None:
        self._frames.put(item)
        with contextlib.suppress(OSError):
            os.write(self._wake, b".")


def _open(arguments: dict[str, Any], listen_only: bool) -> Any:
    """The bus, with nothing old in its buffers."""
    options = dict(arguments)
    if listen_only and options.get("interface") == "slcan":
        options["listen_only"] = True
    lock = _locked(options)
    bus = open_bus(options)
    bus.steerkit_lock = lock  # as long as the bus is open
    for _ in range(10_000):
        if bus.recv(0.0) is None:
            break
    return bus


def _locked(options: dict[str, Any]) -> int | None:
    """A lock on the adapter's serial device: two processes on one would each read half of the frames."""
    channel = str(options.get("channel", "")).partition("@")[0]
    if options.get("interface") != "slcan" or not os.path.exists(channel):
        return None
    device = os.open(channel, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(device, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(device)
        raise OSError(f"{channel}: another process has the adapter; end it first ({error.strerror})") from error
    return device


def _listen(path: str) -> socket.socket:
    """The server socket, for this user only; the file of a car server that was killed is cleared away."""
    server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    if os.path.lexists(path) and not stat.S_ISSOCK(os.lstat(path).st_mode):
        raise OSError(f"{path}: is a file, not a socket; it stays as it is: choose another --socket")
    if os.path.exists(path):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
            try:
                probe.connect(path)
            except ConnectionRefusedError:
                os.unlink(path)
            else:
                raise OSError(f"{path}: a car server is running already; stop it first")
    File(path).parent.mkdir(parents=True, exist_ok=True)
    before = os.umask(0o177)
    try:
        server.bind(path)
    finally:
        os.umask(before)
    server.listen(8)
    server.setblocking(False)
    return server
