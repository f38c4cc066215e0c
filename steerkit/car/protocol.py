"""What the car server and its clients say to each other: one packet, one message, fixed layouts."""

from __future__ import annotations

import hashlib
import math
import struct
from typing import Any, NamedTuple

from steerkit.car.state_machine import Mode, Order
from steerkit.paths.path import Path

VERSION = 3
"""Another one where a message changes."""
NO_COURSE = bytes(8)
"""Of a client that does not say which course it means."""
_MODES, _ORDERS = tuple(Mode), tuple(Order)


class Hello(NamedTuple):
    """A client's first packet. Only one controller at a time; operators may look, and give orders."""

    controller: bool
    version: int = VERSION
    course: bytes = NO_COURSE
    """`digest` of the course that the controller drives; a car server on another one refuses it."""


class Query(NamedTuple):
    """Asks for a `Snapshot`."""


class Beat(NamedTuple):
    """An operator's panel has just read its keys: sent ten times a second. Without any, no key could disengage."""


class Command(NamedTuple):
    """An order of the operator."""

    order: Order


class Request(NamedTuple):
    """A steering-wheel angle that the controller asks for."""

    basis: float
    """The `t` of the snapshot that it was computed from [s]: its age counts from there."""
    delta_sw: float
    """[rad]"""
    misses: int
    """Deadlines missed since the controller started."""


class Remark(NamedTuple):
    """What steers from the controller's next request on, as JSON: for the recording, to be replayed; moves nothing."""

    text: str


class Estimates(NamedTuple):
    """What the controller's estimators have found, for the recording and onlookers; moves nothing."""

    numbers: tuple[float, ...]
    """Value, standard deviation and validity of each of `ESTIMATES` [SI]."""

    def named(self) -> dict[str, float]:
        """The numbers by `NAME`, `NAME_deviation`, `NAME_valid`."""
        names = [f"{name}{end}" for name in ESTIMATES for end in ("", "_deviation", "_valid")]
        return dict(zip(names, self.numbers))


class Adapted(NamedTuple):
    """What a controller that adapts believes of its car, for the recording; moves nothing."""

    delay: float
    """Dead time [s]."""
    ratio: float
    """Steering ratio over the data sheet's [1]."""


class Filtered(NamedTuple):
    """What the safety filter made of the command of the last request, for the recording; moves nothing."""

    command: float
    """What was asked of it [rad]."""
    delta_sw: float
    """What it let through [rad]."""
    share: float
    """How much of the backup is in that [1]."""
    reach: float
    """How far off the car could have got otherwise [m]."""
    reason: float
    """Why: the number of a line of `steerkit.controllers.safety_filter.REASONS`, or of a fault of the filter's."""


class Snapshot(NamedTuple):
    """All that the car server knows: the car's outputs, then who steers and why.

    Values hold the last good reading; the ages [s] show how good they are. NaN: never read.
    """

    t: float
    x: float = math.nan
    y: float = math.nan
    psi: float = math.nan
    v: float = math.nan
    beta: float = math.nan
    r: float = math.nan
    a_y: float = math.nan
    delta_sw: float = math.nan
    v_kit: float = math.nan
    torque: float = math.nan
    e: float = math.nan
    psi_e: float = math.nan
    command: float = math.nan
    """The last gated command [rad]."""
    report_age: float = math.inf
    pose_age: float = math.inf
    request_age: float = math.inf
    errors: float = 0.0
    """CRC, counter and value errors since the start."""
    frames_sent: float = 0.0
    places: float = 0.0
    """How often the pose came back after a pause: a path tracker should look for its place again."""
    mode: Mode = Mode.OFF
    text: str = ""
    """The cause of the mode, then what stands against engaging, separated by line breaks."""


class Refused(NamedTuple):
    """The car server's answer to a packet that it does not obey."""

    why: str


Message = Hello | Query | Beat | Command | Request | Remark | Estimates | Adapted | Filtered | Snapshot | Refused
ESTIMATES = ("delay", "lag", "delay_lag", "steer_ratio", "understeer", "offset", "rate_zero", "friction", "play")
"""What is estimated in a drive, in this order; the units are those of the blocks."""
_NUMBERS = len(Snapshot._fields) - 2
_SNAPSHOT = struct.Struct(f"<c{_NUMBERS}dB")
_LAYOUTS: dict[bytes, tuple[Any, struct.Struct]] = {
    b"Q": (Query, struct.Struct("<c")),
    b"B": (Beat, struct.Struct("<c")),
    b"R": (Request, struct.Struct("<cddI")),
    b"F": (Estimates, struct.Struct(f"<c{3 * len(ESTIMATES)}d")),
    b"A": (Adapted, struct.Struct("<c2d")),
    b"C": (Filtered, struct.Struct("<c5d")),
}
"""Messages that are numbers: the byte that a packet begins with, the message, and how its fields lie."""
_LETTERS = {kind: letter for letter, (kind, _) in _LAYOUTS.items()}
MAX_PACKET = 4096


def digest(path: Path) -> bytes:
    """Eight bytes that tell courses apart."""
    return hashlib.blake2b(path.samples.xy.tobytes() + bytes([path.closed]), digest_size=8).digest()


def encode(message: Message) -> bytes:
    """A message as a packet."""
    match message:
        case Hello():
            return b"H" + bytes((message.controller, message.version)) + message.course
        case Command():
            return b"O" + bytes((_ORDERS.index(message.order),))
        case Remark():
            text = message.text.encode()
            if len(text) >= MAX_PACKET:
                raise ValueError(f"remark of {len(text)} bytes, expected less than {MAX_PACKET}")
            return b"T" + text
        case Snapshot():
            numbers = message[:_NUMBERS]
            return _SNAPSHOT.pack(b"S", *numbers, _MODES.index(message.mode)) + message.text.encode()[:2000]
        case Refused():
            return b"E" + message.why.encode()[:2000]
    letter = _LETTERS[type(message)]
    numbers = message.numbers if isinstance(message, Estimates) else message
    return _LAYOUTS[letter][1].pack(letter, *numbers)


def decode(packet: bytes) -> Message:
    """The message in a packet; raises ValueError for anything that `encode` did not write."""
    try:
        match packet[:1]:
            case b"H" if len(packet) >= 3:  # of any version, so that an old client is refused with a reason
                return Hello(bool(packet[1]), packet[2], packet[3:11].ljust(8, b"\0"))
            case b"O" if len(packet) == 2:
                return Command(_ORDERS[packet[1]])
            case b"T":
                return Remark(packet[1:].decode(errors="replace"))
            case b"S":
                numbers = _SNAPSHOT.unpack_from(packet)[1:]
                text = packet[_SNAPSHOT.size :].decode(errors="replace")
                return Snapshot._make((*numbers[:-1], _MODES[numbers[-1]], text))
            case b"E":
                return Refused(packet[1:].decode(errors="replace"))
            case letter if letter in _LAYOUTS:
                kind, layout = _LAYOUTS[letter]
                numbers = layout.unpack(packet)[1:]
                message: Message = kind(numbers) if kind is Estimates else kind(*numbers)
                return message
    except (struct.error, IndexError) as error:
        raise ValueError(f"packet {packet[:1]!r} of {len(packet)} bytes: {error}") from error
    raise ValueError(f"packet {packet[:1]!r} of {len(packet)} bytes is not known")
