"""The line between a port and its car."""

import socket

import pytest

pytest.importorskip("opendbc")

from steerkit.car.production.platforms import platform
from steerkit.car.production.port import Frame, SocketLine, SocketServer, line_of


def test_frames_cross_a_socket_whole() -> None:
    server = SocketServer()
    line = SocketLine(server.channel)
    frames = 400 * [Frame(0x488, b"\x01\x02\x03\x04", 0), Frame(0x18DAB0F1, bytes(64), 2)]
    line.send(frames, steering=True, t=0.0)
    for _ in range(100):
        if got := server.receive():
            break
    assert got == frames
    server.send(frames[::-1])
    for _ in range(1000):
        if back := line.receive():
            break
    assert back == frames[::-1]
    other = SocketLine(server.channel)
    other.send(frames[:1], steering=True, t=0.0)
    line.send(frames[:2], steering=True, t=0.0)
    assert server.receive() == frames[:1], "the port that came last has the car to itself"
    other.close()
    server.close()
    line.send(frames[:1], steering=True, t=0.0)
    with pytest.raises(OSError, match="gone"):
        line.receive()
    line.close()


def test_a_line_that_is_none_or_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected 127\.0\.0\.1:PORT"):
        line_of({"line": "socket", "channel": "10.0.0.1:99"}, platform("TESLA_MODEL_3"))
    with pytest.raises(OSError, match="panda"):
        line_of({}, platform("TESLA_MODEL_3"))


def test_a_simulated_car_that_is_not_there_is_told_when_its_line_is_opened() -> None:
    server = SocketServer()
    server.close()
    with pytest.raises(OSError, match="refused"):
        SocketLine(server.channel)


def test_a_frame_that_is_cut_off_is_no_frame() -> None:
    """Whoever sends it: another program on this machine."""
    server = SocketServer()
    host, port = server.channel.split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.connect((host, int(port)))
        for text in (b"", b"\x01\x02\x03", b"\x01\0\0\0\0\x08\x01\x02"):
            other.send(text)
        assert server.receive() == []
    server.close()
