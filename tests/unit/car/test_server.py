"""The car server's socket: whose file it is, how many may come, and that nobody keeps the others waiting."""

import contextlib
import os
import signal
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest

from steerkit.car import client as clients
from steerkit.car import protocol, server
from steerkit.car import recording as recordings
from steerkit.car.client import CarClient, CarLost
from steerkit.car.config import load
from steerkit.car.recording import Recording
from steerkit.car.server import CarServer
from steerkit.car.state_machine import Machine, Mode
from steerkit.diagram.units import radians_of
from tests.support.command_lines import run


def made(place: Path) -> CarServer:
    config = replace(load("dbw-kit.toml"), bus={"interface": "virtual", "channel": str(place)})
    return CarServer(config, str(place))


@pytest.fixture
def car_server(tmp_path: Path) -> Iterator[CarServer]:
    running = made(tmp_path / "socket")
    yield running
    running.close()


def connected(car_server: CarServer, tmp_path: Path) -> socket.socket:
    line = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    line.settimeout(5.0)
    line.connect(str(tmp_path / "socket"))
    car_server._turn()
    return line


def answer(car_server: CarServer, line: socket.socket) -> protocol.Message:
    line.send(protocol.encode(protocol.Query()))
    car_server._turn()
    return protocol.decode(line.recv(protocol.MAX_PACKET))


def test_a_file_where_the_socket_should_be_is_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "precious"
    file.write_text("a thesis")
    with pytest.raises(OSError, match="is a file, not a socket; it stays as it is: choose another --socket"):
        made(file)
    assert file.read_text() == "a thesis"


def test_a_client_is_told_that_nothing_is_recorded(car_server: CarServer, tmp_path: Path) -> None:
    told = answer(car_server, connected(car_server, tmp_path))
    assert isinstance(told, protocol.Snapshot)
    assert "not recorded: the car server has no --recording" in told.text.split("\n")


def test_a_recording_that_stops_and_goes_on_is_said_once(
    car_server: CarServer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    recording = SimpleNamespace(event=lambda *_: None)
    monkeypatch.setattr(car_server, "recording", recording)
    for recording.failed in ("", "disk full", "disk full", ""):
        car_server._look_at_recording()
    assert caplog.messages == ["THE RECORDING HAS STOPPED: disk full", "the recording goes on"]


def test_closed_it_leaves_no_thread_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However it ended: whoever made one and never ran it goes on without it."""
    before = set(threading.enumerate())
    running = driving(tmp_path, monkeypatch, Bus())
    started = set(threading.enumerate()) - before
    assert {thread.name for thread in started} >= {"bus"}
    running.close()
    for thread in started:
        thread.join(10.0)
        assert not thread.is_alive(), thread.name


def test_a_second_car_server_is_refused_and_one_that_was_killed_makes_room(
    car_server: CarServer, tmp_path: Path
) -> None:
    with pytest.raises(OSError, match="a car server is running already; stop it first"):
        made(tmp_path / "socket")
    assert (tmp_path / "socket").stat().st_mode & 0o077 == 0  # for this user only
    dead = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    dead.bind(str(tmp_path / "dead"))
    dead.close()
    made(tmp_path / "dead").close()


def test_there_is_room_for_so_many_clients_and_those_who_are_here_notice_nothing(
    car_server: CarServer, tmp_path: Path
) -> None:
    lines = [connected(car_server, tmp_path) for _ in range(server.MAX_CLIENTS)]
    more = connected(car_server, tmp_path)
    assert protocol.decode(more.recv(protocol.MAX_PACKET)) == protocol.Refused("16 clients are here already")
    assert more.recv(protocol.MAX_PACKET) == b""  # hung up
    assert all(isinstance(answer(car_server, line), protocol.Snapshot) for line in lines)
    lines.pop().close()
    car_server._turn()
    assert isinstance(answer(car_server, connected(car_server, tmp_path)), protocol.Snapshot)


def test_a_calibration_beside_a_car_server_that_runs_says_why_there_is_none(
    car_server: CarServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """At once: it is not driven for minutes first."""
    monkeypatch.chdir(tmp_path)
    over, words = threading.Event(), ("--socket", str(tmp_path / "socket"), "--recording", "mine.mcap")

    def serve() -> None:
        while not over.is_set():
            car_server._turn()

    serving = threading.Thread(target=serve)
    serving.start()
    try:
        assert run("car", "calibrate", "dbw-kit.toml", *words, monkeypatch=monkeypatch) == 1
    finally:
        over.set()
        serving.join(30.0)
    printed, error = capsys.readouterr()
    assert "no vehicle file: the car server there was not ours; end it, or drive with it and use its recording" in error
    assert "--recording mine.mcap is NOT written" in printed
    assert [file.name for file in tmp_path.iterdir()] == ["socket"]


def test_a_client_that_floods_keeps_nobody_waiting_and_is_hung_up_on(
    car_server: CarServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "MAX_RATE", 100)
    flood, other = connected(car_server, tmp_path), connected(car_server, tmp_path)
    flood.setblocking(False)
    try:
        for _ in range(300):
            flood.send(protocol.encode(protocol.Query()))
    except BlockingIOError:
        pass
    assert isinstance(answer(car_server, other), protocol.Snapshot)  # within one turn
    assert len(car_server._clients) == 2
    for _ in range(10):
        for _ in range(4):  # it goes on while its answers are read
            try:
                flood.recv(protocol.MAX_PACKET)
                flood.send(protocol.encode(protocol.Query()))
            except OSError:
                break
        car_server._turn()
    assert len(car_server._clients) == 1
    assert isinstance(answer(car_server, other), protocol.Snapshot)


class Bus:
    """A bus whose `recv` gives, one after the other, what it is told: messages, errors to raise, functions to call."""

    def __init__(self, *received: Any, broken: bool = False):
        self.received, self.broken = list(received), broken
        self.sent: list[Any] = []

    def recv(self, timeout: float) -> Any:
        time.sleep(0.001)
        item = self.received.pop(0) if self.received else None
        if isinstance(item, Exception):
            raise item
        return item() if callable(item) else item

    def send(self, message: Any) -> None:
        if self.broken:
            raise OSError("no such device")
        self.sent.append(message)

    def shutdown(self) -> None:
        """Nothing to free."""


@pytest.fixture
def signals() -> Iterator[None]:
    """`run` takes the signals; they are given back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def driving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bus: Bus) -> CarServer:
    """A car server on that bus, with a recording, ENGAGED by force."""
    monkeypatch.setattr(server, "_open", lambda *words: bus)
    config = replace(load("dbw-kit.toml"), bus={"interface": "virtual", "channel": "x"})
    recorder = Recording(tmp_path / "drive.mcap", {})
    running = CarServer(config, str(tmp_path / "socket"), recording=recorder)
    running.core.machine = Machine(Mode.ENGAGED, "by force", running.clock.now())
    return running


def ended(tmp_path: Path) -> tuple[str, list[bool]]:
    """What the recording says of the end: its cause, and of each frame sent whether it enables the kit."""
    recorded = recordings.read(tmp_path / "drive.mcap")
    assert recorded.whole
    (end,), last = recorded.of("/end"), recorded.of("/state")[-1]
    assert (last["to"], last["cause"]) == ("OFF", end["cause"])
    return end["cause"], [bool(bytes.fromhex(v["data"])[2] & 1) for v in recorded.of("/can/tx")]


ENDS: dict[str, tuple[Callable[[CarServer], None], str | BaseException]] = {
    "the bus is lost": (lambda it: it._frames.put(OSError("unplugged")), OSError("unplugged")),
    "the adapter is unplugged": (
        lambda it: vars(it._bus).update(received=[can.CanOperationError("no serial device")], broken=False),
        OSError("the bus is lost: no serial device"),
    ),
    "a mistake in the program": (
        lambda it: setattr(it, "_look_at_recording", lambda: 1 / 0),
        ZeroDivisionError("division by zero"),
    ),
    "the keyboard": (lambda it: it._frames.put(KeyboardInterrupt("Ctrl-C")), KeyboardInterrupt("Ctrl-C")),
    "a signal": (lambda it: os.kill(os.getpid(), signal.SIGTERM), "the car server got SIGTERM"),
    "nobody is there": (lambda it: setattr(it, "linger", -1.0), "no client for -1 s"),
    "an order to stop": (lambda it: it.stop(), "the car server was stopped"),
}
"""What ends it, and the cause that is recorded, or what it fails of."""


@pytest.mark.usefixtures("signals")
@pytest.mark.parametrize("broken", [False, True])
@pytest.mark.parametrize("name", ENDS)
def test_every_end_has_its_cause_on_the_recording_and_neutral_frames_before_it(
    name: str, broken: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also on a bus that takes no frames any more."""
    act, end = ENDS[name]
    if broken and name == "nobody is there":  # it lets go before that, in vain
        end = OSError("no such device")
    bus = Bus(broken=broken)
    running = driving(tmp_path, monkeypatch, bus)
    turn = running._turn

    def first() -> None:
        monkeypatch.setattr(running, "_turn", turn)
        act(running)
        if not running.stopping:
            turn()

    monkeypatch.setattr(running, "_turn", first)
    with contextlib.nullcontext() if isinstance(end, str) else pytest.raises(type(end)):
        running.run()
    said, enabled = ended(tmp_path)
    assert said == (end if isinstance(end, str) else f"the car server failed: {type(end).__name__}: {end}")
    assert next(v["from"] for v in recordings.read(tmp_path / "drive.mcap").of("/state")) == "ENGAGED"
    assert enabled[-5:] == [False] * 5
    assert not any(enabled)
    assert broken or [bool(message.data[2] & 1) for message in bus.sent] == enabled


@pytest.mark.usefixtures("signals")
@pytest.mark.parametrize(("lines", "fails"), [(1, False), (19, False), (20, True)])
def test_a_line_that_is_no_frame_is_counted_and_many_are_a_broken_adapter(
    lines: int, fails: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = Bus(*[ValueError("invalid literal for int() with base 16: '?'")] * lines)
    running = driving(tmp_path, monkeypatch, bus)
    monkeypatch.setattr(server, "time", SimpleNamespace(monotonic=lambda: 7.0))  # all within a second
    seen = running.core.senses

    def done() -> None:
        while seen.error_count < lines:
            time.sleep(0.001)
        running.stop()

    bus.received.append(done)
    with pytest.raises(ValueError, match="invalid literal") if fails else contextlib.nullcontext():
        running.run()
    assert seen.error_count == min(lines, 19)
    assert ended(tmp_path)[0].startswith("the car server failed: ValueError" if fails else "the car server was stopped")


NOISE = (b"T0", b"t1", b"\xff\xfe\x80", b"t123ZZ", b"t1239000000", b"d123F00", b"\x00", b"t\xff652AABB", b"r", b"")
"""Lines as noise on a serial line makes them; more than half cannot be read."""


def test_noise_on_a_real_slcan_line_is_counted_and_the_frames_between_are_read(tmp_path: Path) -> None:
    """Bytes that are no text, too: python-can keeps those, and would find them before every later line."""
    master, slave = os.openpty()
    tty.setraw(slave)
    bus = {"interface": "slcan", "channel": os.ttyname(slave), "bitrate": 500000, "sleep_after_open": 0.0}
    running = CarServer(replace(load("dbw-kit.toml"), bus=bus), str(tmp_path / "socket"))
    senses, end = running.core.senses, time.monotonic() + 60.0
    try:
        for k, noise in enumerate(NOISE, 1):
            os.write(master, noise + b"\r")
            while running.core.senses.arrived[0x65] < 0.0 or senses.values["delta_sw"] != pytest.approx(radians_of(k)):
                os.write(master, b"t0658%04x000000000000\r" % int.from_bytes((10 * k).to_bytes(2, "little"), "big"))
                running._turn()
                assert time.monotonic() < end
        assert len(NOISE) / 2 < senses.error_count <= len(NOISE)
        assert not running._clients
    finally:
        running.close()
        os.close(master)
        os.close(slave)


def test_a_car_server_of_another_user_is_not_obeyed(
    car_server: CarServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clients.os, "getuid", lambda: 12345)
    monkeypatch.setattr(clients.struct, "unpack", lambda form, data: (1, 4711, 4711))
    with pytest.raises(CarLost, match="the process there is another user's; it is not trusted"):
        CarClient(str(tmp_path / "socket"))
