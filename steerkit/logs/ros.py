"""Reader of ROS bags (SQLite, MCAP, ROS 1) without ROS: which messages are known, and what they hold."""

import tomllib
from array import array
from collections.abc import Callable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import optional, require
from steerkit._support.files import Bounded
from steerkit.logs.can_frames import Decoder
from steerkit.logs.channels import Channel


def intact(file: Path, notes: list[str]) -> Iterator[tuple[str, str, float, Any]]:
    """(topic, kind, when it was received [s], message) of an MCAP file up to where it breaks off, without its index."""
    from mcap.reader import NonSeekingReader
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    store, count, why = get_typestore(Stores.EMPTY), 0, "no index, or no metadata.yaml"
    with Bounded(file) as stream:
        try:
            reader = NonSeekingReader(stream, validate_crcs=True, record_size_limit=file.stat().st_size)
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                if schema is None or channel.message_encoding != "cdr" or schema.name.endswith(_HEAVY):
                    continue
                if schema.name not in store.fielddefs:
                    text, idl = schema.data.decode(), schema.encoding == "ros2idl"
                    types = get_types_from_idl(text) if idl else get_types_from_msg(text, schema.name)
                    store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
                told = store.deserialize_cdr(message.data, schema.name)
                count += 1
                yield channel.topic, schema.name.rpartition("/")[2], 1e-9 * message.log_time, told
        except Exception as error:  # mcap's own, rosbags', struct's, and whatever text may be
            why = f"{type(error).__name__} {error}".strip()[:80]
    notes.append(f"cut off or broken ({why}): what comes before is used, {count} messages")


_TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
KNOWN: dict[str, dict[str, tuple[str, str]]] = _TABLE["known"]
"""Kind of message (of autoware_*, sensor_msgs, nav_msgs, geometry_msgs, ackermann_msgs, whatever the package) to what
its fields are, and their units; no quantity: taken where there is nothing better."""
DEFINITIONS: dict[str, str] = _TABLE["definitions"]
"""Messages that ROS itself does not have, for bags that do not bring their definitions (older SQLite ones)."""
DEFINITIONS |= {
    name.replace("autoware_vehicle_msgs", "autoware_auto_vehicle_msgs"): text
    for name, text in DEFINITIONS.items()
    if name.startswith("autoware_vehicle_msgs")
}

_HEAVY = ("Image", "CompressedImage", "PointCloud2", "LaserScan", "OccupancyGrid", "TFMessage", "MarkerArray", "Path")
"""Kinds that hold no number over time that a drive could be made of."""
_NEAR = 3600.0
"""A stamp further than this from when the message was recorded is of another clock [s]."""


class _Bag:
    """What is collected of a bag: the numbers of each topic, and CAN frames."""

    def __init__(self, dbc: tuple[str, ...]):
        self.frames, self.kinds = Decoder(dbc), dict[str, str]()
        self._numbers: dict[str, dict[str, Callable[[Any], Any]]] = {}
        """By topic, where in its messages numbers stand, and how to get them."""
        self._rows: dict[str, array[float]] = {}
        """When it was received [s], its stamp [s], its numbers; of the next message ..."""

    def add(self, topic: str, kind: str, t: float, message: Any) -> None:
        """One more message, that was received at t [s]."""
        stamp = _stamp(message)
        if kind == "Frame":
            if not (message.is_error or message.is_rtr):
                near = stamp if abs(stamp - t) < _NEAR else t
                data = bytes(message.data[: message.dlc])
                self.frames.add(near, int(message.id), bool(message.is_extended), data)
            return
        if topic not in self.kinds:
            self.kinds[topic], self._rows[topic] = kind, array("d")
            self._numbers[topic] = {path: attrgetter(path) for path in _numbers(message)}
        self._rows[topic].extend((t, stamp, *(float(number(message)) for number in self._numbers[topic].values())))

    def channels(self, path: Path, notes: list[str], *, decode: bool) -> list[Channel]:
        """The numbers of all topics, and of the frames if they are to be decoded, or are all that there is."""
        names = [name for name in sorted(self.kinds) if self._numbers[name]]
        channels = [channel for name in names for channel in self._of_topic(name, notes)]
        if self.frames.seen and (decode or not channels):
            channels += self.frames.channels(path, notes)
        elif self.frames.seen:
            count = sum(self.frames.seen.values())
            notes.append(f"{count} CAN frames are not read: say what is in them, --dbc")
        require(channels, str(path), f"no messages with numbers in it{'; ' + notes[-1] if notes else ''}")
        return channels

    def _of_topic(self, name: str, notes: list[str]) -> Iterator[Channel]:
        received, stamped, *numbers = np.frombuffer(self._rows[name]).reshape(-1, 2 + len(self._numbers[name])).T.copy()
        trusted = bool(np.isfinite(stamped).all()) and float(np.abs(stamped - received).max()) < _NEAR
        if not trusted and np.isfinite(stamped).all():
            notes.append(f"{name}: its stamps are of another clock: taken as they were received")
        columns = dict(zip(self._numbers[name], numbers))
        for path in [path for path in columns if path.endswith("orientation.w")]:
            base = path.removesuffix("w")
            x, y, z, w = (columns[f"{base}{axis}"] for axis in "xyzw")
            columns[f"{base}yaw"] = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        t = stamped if trusted else received
        for path, values in columns.items():
            quantity, unit = KNOWN.get(self.kinds[name], {}).get(path, ("", ""))
            yield Channel(name=f"{name}.{path}", t=t, values=values, unit=unit, means=quantity)


def read_ros(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Channel]:
    """The numbers in a bag's messages: a folder with metadata.yaml, or one file of it (.mcap, .db3, .bag).

    A topic has the clock of its stamps if it has such, else of when its messages were received.
    """
    rosbags = optional("rosbags.highlevel", f"{path}: a ROS bag", "logs")
    for file in [path] if path.is_file() else sorted(path.glob("*.db3")):
        _check_size(file)
    bag = _Bag(dbc)
    try:
        with rosbags.AnyReader([path], default_typestore=typestore()) as reader:
            for message in _messages(reader, notes):
                bag.add(*message)
    except Exception as error:  # rosbags' errors have no common base, and what it is built on has others
        parts = [path] if path.is_file() else sorted(path.glob("*.mcap"))
        if all(part.suffix.lower() == ".mcap" for part in parts):
            bag = _Bag(dbc)
            for message in (message for part in parts for message in intact(part, notes)):
                bag.add(*message)
        else:
            notes.append(f"cut off or broken: what comes before is used ({type(error).__name__}: {str(error)[:80]})")
        found = bag.kinds or bag.frames.seen
        require(found, str(path), f"no ROS bag, or a broken one ({type(error).__name__}: {error})")
    return bag.channels(path, notes, decode=bool(dbc))


def _check_size(file: Path) -> None:
    """SQLite reads on where a file is cut off, as if there were zeros; its header says how long it was."""
    with file.open("rb") as stream:
        head = stream.read(100)
    if head.startswith(b"SQLite format 3\0") and len(head) == 100:
        page, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
        wanted, size = (65536 if page == 1 else page) * pages, file.stat().st_size
        require(size == wanted, str(file), f"cut off, or not closed: {size} bytes, its header says {wanted}")


def typestore() -> Any:
    """The messages of ROS 2 and those of DEFINITIONS, for rosbags."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.LATEST)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def _messages(reader: Any, notes: list[str]) -> Iterator[tuple[str, str, float, Any]]:
    """(topic, kind, when it was received [s], message); those that cannot be read are counted."""
    wanted, unknown, bad = [], [], 0
    for connection in reader.connections:
        kind = connection.msgtype.rpartition("/")[2]
        if connection.msgtype not in reader.typestore.fielddefs:
            unknown.append(f"{connection.topic} ({connection.msgtype})")
        elif kind not in _HEAVY:
            wanted.append(connection)
    if unknown:
        notes.append(f"not read, as the bag does not say what is in them: {', '.join(unknown)}")
    count = 0
    if wanted:
        for connection, stamp, raw in reader.messages(wanted):
            count += 1
            try:
                message = reader.deserialize(raw, connection.msgtype)
            except Exception:  # a message of the wrong length, or text that is none
                bad += 1
                continue
            yield connection.topic, connection.msgtype.rpartition("/")[2], 1e-9 * stamp, message
    told = sum(connection.msgcount for connection in wanted)
    if bad:
        notes.append(f"left out {bad} messages that cannot be read")
    if count < told:
        notes.append(f"{count} of {told} messages are there")


def _numbers(message: Any, before: str = "") -> Iterator[str]:
    """Where numbers stand in a message: `pose.pose.position.x`; arrays and stamps are left out."""
    for name in message.__dataclass_fields__:
        value = getattr(message, name)
        if hasattr(value, "__dataclass_fields__"):
            if not name.endswith(("header", "stamp")):
                yield from _numbers(value, f"{before}{name}.")
        elif isinstance(value, int | float | np.number) and name != "__msgtype__":
            yield f"{before}{name}"


def _stamp(message: Any) -> float:
    stamp = getattr(getattr(message, "header", message), "stamp", None)
    return float("nan") if stamp is None else stamp.sec + 1e-9 * stamp.nanosec
