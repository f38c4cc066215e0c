"""What the car server and its clients say to each other: one packet, one message, in JSON."""

import hashlib
import json
import math
from typing import Any, NamedTuple, get_args, get_type_hints

from steerkit.car.state_machine import Mode, Order
from steerkit.paths.path import Path

VERSION = 7
"""Another one where a message changes."""
NO_COURSE = ""
"""Of a client that does not say which course it means."""
MAX_PACKET = 32768
"""Bytes of the longest packet."""


class Hello(NamedTuple):
    """A client's first packet. Only one controller at a time; operators may look, and give orders."""

    controller: bool
    version: int = VERSION
    course: str = NO_COURSE
    """`digest` of the course that the controller drives; a car server on another one refuses it."""
    name: str = ""
    """What every panel calls this client."""


class Query(NamedTuple):
    """Asks for a `Snapshot`."""


class Beat(NamedTuple):
    """An operator's panel has just read its keys: sent ten times a second. Without any, no key could disengage.

    Any panel's lets the car be READY; while it is ENGAGED only those of the panel that engaged count.
    """


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
    late: float
    """How much later than believed commands were found to arrive [s]."""
    widened: float
    """Factor on its doubt of ratio and tyres [1]."""


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
    astray: float = math.nan
    """The time in which a pose that lies unnoticed could lead the car half a metre off [s]; inf: not within 10 s."""
    mode: Mode = Mode.OFF
    holder: str = ""
    """While engaged, the name of the panel that engaged: no other's heartbeat counts."""
    text: str = ""
    """The cause of the mode, then what stands against engaging, separated by line breaks."""


class Refused(NamedTuple):
    """The car server's answer to a packet that it does not obey."""

    why: str


Message = Hello | Query | Beat | Command | Request | Remark | Estimates | Adapted | Filtered | Snapshot | Refused
ESTIMATES = ("delay", "lag", "delay_lag", "steer_ratio", "understeer", "offset", "rate_zero", "friction")
"""What is estimated in a drive, in this order; the units are those of the blocks."""
_KINDS = {kind.__name__: kind for kind in get_args(Message)}
_FIELDS: dict[str, dict[str, Any]] = {name: get_type_hints(kind) for name, kind in _KINDS.items()}


def digest(path: Path) -> str:
    """A text that tells courses apart."""
    return hashlib.blake2b(path.samples.xy.tobytes() + bytes([path.closed]), digest_size=8).hexdigest()


def encode(message: Message) -> bytes:
    """A message as a packet: a JSON list of its kind and its fields; raises ValueError for one that is too long."""
    fields: list[Any] = [*message]
    if isinstance(message, Snapshot | Refused):  # the last field is a text for people
        fields[-1] = fields[-1][:2000]
    packet = json.dumps([type(message).__name__, *fields]).encode()
    if len(packet) > MAX_PACKET:
        raise ValueError(f"{type(message).__name__} of {len(packet)} bytes, expected at most {MAX_PACKET}")
    return packet


def decode(packet: bytes) -> Message:
    """The message in a packet; raises ValueError for what is none. Of another version's `Hello`, that version only."""
    try:
        name, *values = _field(list, json.loads(packet))
        if name == "Hello" and len(values) > 1 and values[1] != VERSION:
            values = [*values[:2], NO_COURSE, ""]
        fields = [_field(kind, value) for kind, value in zip(_FIELDS[name].values(), values, strict=True)]
        message: Message = _KINDS[name](*fields)
        return message
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise ValueError(f"packet {packet[:20]!r} of {len(packet)} bytes is not known: {error}") from error


def _field(kind: Any, value: Any) -> Any:
    """The value of a field of that type; raises ValueError, TypeError or OverflowError for another."""
    if kind in (Mode, Order):
        return kind(value)
    if kind is float and type(value) is int:
        return float(value)
    if kind == tuple[float, ...] and type(value) is list:
        return tuple(_field(float, number) for number, _ in zip(value, 3 * ESTIMATES, strict=True))
    if type(value) is not kind or (kind is int and not 0 <= value < 1 << 32):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    return value
