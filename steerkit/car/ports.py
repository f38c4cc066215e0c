"""Ports of a CAN bus: python-can's, the simulated car's end of one, and the other end of an slcan line."""

import contextlib
import os
import re
import select
import sys
import tty
from types import ModuleType
from typing import Any

from steerkit._support.errors import known, require

INTERFACES = ("slcan", "socketcan", "pcan", "kvaser", "vector", "ixxat", "socketcand", "udp_multicast", "virtual")
"""Interfaces of python-can that a car may have."""


def python_can() -> ModuleType:
    """The module `can`, without its support of MF4 files.

    python-can imports asammdf where that is installed, and with it pandas and SymPy: more than a second, for files that
    a car does not need. Call it before cantools is imported too, which imports `can`. Raises ImportError without it.
    """
    modules: dict[str, Any] = sys.modules
    absent = "can" not in modules and "asammdf" not in modules
    if absent:
        modules["asammdf"] = None  # as if it were not installed
    try:
        import can
    finally:
        if absent:
            del modules["asammdf"]
    return can


def checked(bus: dict[str, Any]) -> dict[str, Any]:
    """`bus`, arguments of `can.Bus`; raises ValueError for an interface that is none of `INTERFACES`.

    slcan goes over a serial device or TCP: other addresses of pyserial, such as spy://, write files.
    """
    known(str(bus["interface"]), INTERFACES, "[bus] interface")
    address = str(bus["channel"]).partition("@")[0]
    ok = bus["interface"] != "slcan" or "://" not in address or re.fullmatch(r"socket://[\w.-]+:\d+", address)
    require(ok, f"[bus] channel {address!r}", "expected a serial device, such as /dev/ttyACM0, or socket://HOST:PORT")
    return bus


def open_bus(arguments: dict[str, Any]) -> Any:
    """`can.Bus` of these arguments; raises OSError, naming them, when it cannot be opened."""
    can = python_can()
    try:
        return can.Bus(**checked(arguments), ignore_config=True)  # python-can would read more from files
    except Exception as error:  # the interfaces' own libraries raise whatever they like, a NameError included
        where = ", ".join(f"{k} = {v!r}" for k, v in arguments.items())
        raise OSError(
            f"bus {where}: cannot be opened ({error}); is the adapter there and free, its interface installed?"
        ) from error


def lost(error: Exception) -> Exception:
    """An error of a bus as one that ends a program in one line: what the interfaces raise is no OSError."""
    return error if isinstance(error, (OSError, ValueError)) else OSError(f"the bus is lost: {error}")


class BusPort(contextlib.ExitStack):
    """A simulated car's port on a bus that the computer has already: kernel CAN, UDP multicast, ...

    arguments: of `can.Bus`. channel: what `--channel` of the car server wants. Raises OSError.
    """

    def __init__(self, arguments: dict[str, Any]):
        super().__init__()
        self._bus = open_bus(arguments)
        self.callback(self._bus.shutdown)
        self.channel = f"{arguments['interface']}:{arguments['channel']}"

    def wait(self, timeout: float) -> list[tuple[int, bytes]]:
        """The frames (id, data) that came in, after at most `timeout` [s] without any."""
        frames: list[tuple[int, bytes]] = []
        pause = max(0.0, timeout)
        try:
            while (message := self._bus.recv(pause)) is not None and len(frames) < 100:
                frames.append((message.arbitration_id, bytes(message.data)))
                pause = 0.0
        except python_can().CanError as error:
            raise lost(error) from error
        return frames

    def send(self, frame_id: int, data: bytes) -> None:
        """A frame to the bus; a full one drops it."""
        can = python_can()
        with contextlib.suppress(can.CanOperationError):
            self._bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=False))


class SlcanPort(contextlib.ExitStack):
    """Serves slcan clients on a pseudo-terminal: text frames `tIIILDD..` and a carriage return (Lawicel CAN232 manual).

    `channel` is its name. What a client does not read in time is dropped, as an adapter does.
    """

    def __init__(self) -> None:
        super().__init__()
        self._text = b""
        self._line, slave = os.openpty()  # the slave stays open here, so that clients may come and go
        self.callback(os.close, self._line)
        self.callback(os.close, slave)
        tty.setraw(slave)
        os.set_blocking(self._line, False)
        self.channel = os.ttyname(slave)

    def wait(self, timeout: float) -> list[tuple[int, bytes]]:
        """The frames (id, data) that clients sent, after at most `timeout` [s] without any."""
        ready, _, _ = select.select([self._line], [], [], max(0.0, timeout))
        if ready:
            with contextlib.suppress(BlockingIOError):
                self._text += os.read(self._line, 65536)
        *lines, self._text = self._text.split(b"\r")
        return [frame for line in lines if (frame := _frame(line))]

    def send(self, frame_id: int, data: bytes) -> None:
        """A frame to the client, if it has room."""
        with contextlib.suppress(OSError):
            os.write(self._line, b"t%03X%d%s\r" % (frame_id, len(data), data.hex().upper().encode()))


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
