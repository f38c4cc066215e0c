"""The other end of python-can's `slcan`: a USB adapter's serial line, on a pseudo-terminal or on 127.0.0.1."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import tty
from typing import Any


class SlcanPort:
    """Serves one slcan client at a time: text frames `tIIILDD..` and a carriage return (Lawicel CAN232 manual).

    listen: "" for a pseudo-terminal, whose name is `channel`; "127.0.0.1:0" for TCP (`channel` is then a pyserial
    address such as socket://127.0.0.1:34567). What a client does not read in time is dropped, as an adapter does.
    """

    def __init__(self, listen: str = ""):
        self._text = b""
        self._server: socket.socket | None = None
        self._client: socket.socket | None = None
        self._pty: tuple[int, int] | None = None
        if listen:
            host, port = listen.rsplit(":", 1)
            if host not in ("127.0.0.1", "localhost"):
                raise ValueError(f"slcan port {listen!r}: only 127.0.0.1; a simulated car has no business on a network")
            self._server = socket.create_server((host, int(port)))
            self._server.setblocking(False)
            self.channel = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        else:
            master, slave = os.openpty()  # the slave stays open here, so that clients may come and go
            tty.setraw(slave)
            os.set_blocking(master, False)
            self._pty = master, slave
            self.channel = os.ttyname(slave)

    def bus(self) -> dict[str, Any]:
        """The arguments of `can.Bus` for a client."""
        return {"interface": "slcan", "channel": self.channel, "bitrate": 500000, "sleep_after_open": 0.0}

    def wait(self, timeout: float) -> list[tuple[int, bytes]]:
        """The frames (id, data) that clients sent, after at most `timeout` [s] without any."""
        watched: list[Any] = [self._pty[0]] if self._pty else [self._server]
        if self._client:
            watched.append(self._client)
        ready, _, _ = select.select(watched, [], [], max(0.0, timeout))
        for source in ready:
            if source is self._server:
                self._accept()
            else:
                self._text += self._read()
        *lines, self._text = self._text.split(b"\r")
        return [frame for line in lines if (frame := _frame(line))]

    def send(self, frame_id: int, data: bytes) -> None:
        """A frame to the client, if there is one and it has room."""
        line = b"t%03X%d%s\r" % (frame_id, len(data), data.hex().upper().encode())
        with contextlib.suppress(BlockingIOError, BrokenPipeError, ConnectionResetError, OSError):
            if self._pty:
                os.write(self._pty[0], line)
            elif self._client:
                self._client.send(line)

    def close(self) -> None:
        """Free the port."""
        for end in (self._server, self._client):
            if end:
                end.close()
        for fd in self._pty or ():
            os.close(fd)

    def _accept(self) -> None:
        assert self._server is not None
        if self._client:
            self._client.close()
        self._client, _ = self._server.accept()
        self._client.setblocking(False)
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._text = b""

    def _read(self) -> bytes:
        try:
            if self._pty:
                return os.read(self._pty[0], 65536)
            assert self._client is not None
            text = self._client.recv(65536)
        except (BlockingIOError, ConnectionResetError):
            text = b""
        if not text and self._client:
            self._client.close()
            self._client, self._text = None, b""
        return text


def _frame(line: bytes) -> tuple[int, bytes] | None:
    """A standard data frame; None for the adapter commands (open, close, bit rate) and for anything else."""
    try:
        if line[:1] == b"t":
            length = int(line[4:5])
            data = bytes.fromhex(line[5:].decode())
            return (int(line[1:4], 16), data) if len(data) == length else None
    except ValueError:
        pass
    return None
