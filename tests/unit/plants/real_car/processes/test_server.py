"""The car server's socket: whose file it is, how many may come, and that nobody keeps the others waiting."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from steerkit.courses import course
from steerkit.plants.real_car.file.reading import load
from steerkit.plants.real_car.processes import client as clients
from steerkit.plants.real_car.processes import protocol, server
from steerkit.plants.real_car.processes.client import CarClient, CarLost
from steerkit.plants.real_car.processes.server import CarServer


def made(place: Path) -> CarServer:
    config = replace(load("dbw-kit.toml"), bus={"interface": "virtual", "channel": str(place)})
    return CarServer(config, course("paper"), str(place))


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


def test_a_car_server_of_another_user_is_not_obeyed(
    car_server: CarServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clients.os, "getuid", lambda: 12345)
    monkeypatch.setattr(clients.struct, "unpack", lambda form, data: (1, 4711, 4711))
    with pytest.raises(CarLost, match="the process there is another user's; it is not obeyed"):
        CarClient(str(tmp_path / "socket"))
