"""A CAN bus: its ports (python-can's, the simulated car's end, the other end of an slcan line), and its frames."""

import contextlib
import math
import os
import re
import select
import sys
import tty
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from steerkit._support.errors import known, optional, require
from steerkit.diagram.units import FACTORS

INTERFACES = ("slcan", "socketcan", "pcan", "kvaser", "vector", "ixxat", "socketcand", "udp_multicast", "virtual")
"""Interfaces of python-can that a car may have."""


def python_can(where: str = "a CAN bus") -> Any:
    """The module `can`, without its support of MF4 files.

    python-can imports asammdf where that is installed, and with it pandas and SymPy: more than a second, for files that
    a car does not need. Call it before cantools is imported too, which imports `can`. where: what needs it, for the
    ValueError without it.
    """
    modules: dict[str, Any] = sys.modules
    absent = "can" not in modules and "asammdf" not in modules
    if absent:
        modules["asammdf"] = None  # as if it were not installed
    try:
        return optional("can", where, "car")
    finally:
        if absent:
            del modules["asammdf"]


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


UNIT_FACTORS = {"": 1.0, "1": 1.0, **{unit: one for units in FACTORS.values() for unit, one in units.items()}}
"""Units that a signal may be in, and what one of them is in SI."""


@dataclass(frozen=True, kw_only=True)
class Mapping:
    """One quantity of ours as one signal of a frame: value = sign*scale*factor(unit)*physical + offset."""

    frame: str
    signal: str
    unit: str = ""
    scale: float = 1.0
    sign: float = 1.0
    offset: float = 0.0

    @cached_property
    def gain(self) -> float:
        """SI units of ours in one physical unit of the signal."""
        return self.sign * self.scale * UNIT_FACTORS[self.unit]


MAX_JUMP = 3
"""Counter steps a frame may skip and still count as the next; more is an error (AUTOSAR E2E: MaxDeltaCounter)."""


class Checked(NamedTuple):
    """A received frame, looked at."""

    values: dict[str, float]
    """Quantities in SI; NaN where the signal is out of its DBC's range (such as the code 0x8000). Empty on error."""
    counter: int | None
    """The counter to compare the next frame's with."""
    error: str
    """What was wrong; empty for a good frame."""


class FrameReader:
    """Reads one kind of frame, and writes it for a simulated car.

    message: of a cantools database. mappings: quantity by name. counter, crc: names of their signals, empty for none.
    period: time between two such frames [s], 0: not known; more frequent ones have a second sender, those that come
    later than their counter says queue up on the way. The CRC lies in a byte of its own; it covers the other bytes in
    their order, then the id's low and high byte.
    """

    def __init__(
        self, message: Any, mappings: dict[str, Mapping], *, counter: str = "", crc: str = "", period: float = 0.0
    ):
        self.message, self.mappings, self.counter, self.crc = message, mappings, counter, crc
        self.name: str = message.name
        self.frame_id: int = message.frame_id
        self.kind = "x" if message.is_extended_frame else ""
        self.period = period
        self._ranges = {s.name: signal_range(s) for s in message.signals}
        self._names = [signal.name for signal in message.signals]
        self._signals = {m.signal: message.get_signal_by_name(m.signal) for m in mappings.values()}
        self._needed = [*dict.fromkeys(m.signal for m in mappings.values()), *([counter] if counter else [])]
        self._crc_byte = message.get_signal_by_name(crc).start // 8 if crc else None
        self.modulus = 1 << message.get_signal_by_name(counter).length if counter else 0
        """The counter's; 0 without one."""

    def read(self, data: bytes, counter: int | None) -> Checked:
        """`data` checked against the last good frame's counter (None: there was none). Raises nothing."""
        if len(data) != self.message.length:
            return Checked({}, counter, f"{self.name}: {len(data)} bytes, expected {self.message.length}")
        if self._crc_byte is not None:
            expected = frame_crc(data, self._crc_byte, self.frame_id)
            if data[self._crc_byte] != expected:
                return Checked({}, counter, f"{self.name}: CRC 0x{data[self._crc_byte]:02X}, expected 0x{expected:02X}")
        try:
            raw = self.message.decode(data, decode_choices=False)
        except Exception as error:  # a multiplexer code of no signal, for one; what cantools raises is not ours to list
            return Checked({}, counter, f"{self.name}: cannot be decoded ({type(error).__name__}: {error})")
        if absent := [signal for signal in self._needed if signal not in raw]:
            return Checked({}, counter, f"{self.name}: without {', '.join(absent)}")
        if self.counter:
            new = int(raw[self.counter])
            jump = 1 if counter is None else (new - counter) % self.modulus
            if not 1 <= jump <= MAX_JUMP:
                return Checked({}, new, f"{self.name}: counter {new} after {counter}")
            counter = new
        values = {}
        for quantity, mapping in self.mappings.items():
            low, high = self._ranges[mapping.signal]
            physical = float(raw[mapping.signal])
            values[quantity] = physical * mapping.gain + mapping.offset if low <= physical <= high else math.nan
        return Checked(values, counter, "")

    def write(
        self, values: dict[str, float], *, count: int = 0, raw: dict[str, float] | None = None, strict: bool = False
    ) -> bytes:
        """The frame with these quantities [SI], saturated to the DBC's range, as the simulated car sends it.

        A NaN becomes the code 0x80.. . count: its counter. raw: codes of signals that no quantity maps to; strict: they
        have to be within the DBC's ranges.
        """
        codes: dict[str, float] = dict.fromkeys(self._names, 0)
        codes |= {name: code for name, code in (raw or {}).items() if name in codes}
        for quantity, mapping in self.mappings.items():
            if quantity in values:
                codes[mapping.signal] = self._code(values[quantity], mapping)
        if self.counter:
            codes[self.counter] = count % self.modulus
        data = bytes(self.message.encode(codes, scaling=False, strict=strict))
        at = self._crc_byte
        return data if at is None else data[:at] + bytes([frame_crc(data, at, self.frame_id)]) + data[at + 1 :]

    def _code(self, value: float, mapping: Mapping) -> int:
        signal = self._signals[mapping.signal]
        if not math.isfinite(value):
            return -(1 << (signal.length - 1)) if signal.is_signed else (1 << signal.length) - 1
        low, high = self._ranges[mapping.signal]
        physical = max(low, min(high, (value - mapping.offset) / mapping.gain))
        return round((physical - signal.offset) / signal.scale)


def frame_crc(data: bytes, crc_byte: int, frame_id: int) -> int:
    """The CRC of a frame whose byte `crc_byte` holds it: polynomial 0x2F, start 0xFF, final XOR 0xFF.

    Source: AUTOSAR, Specification of CRC Routines, Crc_CalculateCRC8H2F.
    """
    from fastcrc import crc8

    return crc8.autosar(data[:crc_byte] + data[crc_byte + 1 :] + bytes((frame_id & 0xFF, frame_id >> 8 & 0xFF)))


def signal_range(signal: Any) -> tuple[float, float]:
    """Lowest and highest valid physical value: the DBC's, else all codes but a signed signal's most negative one."""
    slack = 1e-6 * abs(signal.scale)
    if signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum:
        return float(signal.minimum) - slack, float(signal.maximum) + slack
    n = signal.length
    codes = (-(2 ** (n - 1)) + 1, 2 ** (n - 1) - 1) if signal.is_signed else (0, 2**n - 1)
    ends = sorted(code * signal.scale + signal.offset for code in codes)
    return ends[0] - slack, ends[1] + slack


@dataclass(frozen=True)
class CommandWriter:
    """Writes the steering command.

    message: of a cantools database. angle: where delta_sw goes. enable, clear, alert, counter, crc: names of signals,
    empty for none. fixed: raw values of others.
    """

    message: Any
    angle: Mapping
    enable: str
    clear: str = ""
    alert: str = ""
    counter: str = ""
    crc: str = ""
    fixed: tuple[tuple[str, float], ...] = ()

    @cached_property
    def _frame(self) -> FrameReader:
        return FrameReader(self.message, {"delta_sw": self.angle}, counter=self.counter, crc=self.crc)

    @cached_property
    def quantum(self) -> float:
        """The angle's resolution on the bus [rad]."""
        return abs(self.message.get_signal_by_name(self.angle.signal).scale * self.angle.gain)

    def write(
        self, delta_sw: float, *, enable: bool, clear: bool = False, alert: bool = False, count: int = 0
    ) -> bytes:
        """The frame for delta_sw [rad], a whole number of quanta. alert: ask the kit to warn the human.

        Flags that the frame has no signal for are left out. Raises ValueError for an angle that it cannot hold.
        """
        flags = {self.enable: enable, self.clear: clear, self.alert: alert}
        signal = self.message.get_signal_by_name(self.angle.signal)
        code = round(((delta_sw - self.angle.offset) / self.angle.gain - signal.offset) / signal.scale)
        low, high = signal_range(signal)
        if not low <= code * signal.scale + signal.offset <= high:
            raise ValueError(f"{self.message.name}.{signal.name}: code {code} is beyond the DBC's range")
        raw = dict(self.fixed) | {name: int(up) for name, up in flags.items() if name}
        return self._frame.write({"delta_sw": delta_sw}, count=count, raw=raw, strict=True)

    def read(self, data: bytes) -> tuple[float, bool, bool]:
        """delta_sw [rad], enable and clear of a command frame: what the kit makes of it."""
        raw = self.message.decode(data, decode_choices=False)
        clear = bool(raw[self.clear]) if self.clear else False
        return raw[self.angle.signal] * self.angle.gain + self.angle.offset, bool(raw[self.enable]), clear
