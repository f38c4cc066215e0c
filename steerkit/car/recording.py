"""Everything that the car server received, decided and sent, in a file that survives a kill, and read again.

Topics: /can/rx /client /tick /recording /end (what the core was given), /can/tx (what it sent), /state /command /steers
/car /refused (why).

The file is MCAP (https://mcap.dev), because it is append-only: what has been written can be read, with or without its
end. Field tools (Foxglove, PlotJuggler, `mcap`) open it; messages are JSON. Every byte is covered by a check sum:
messages come in chunks with a CRC-32, the first two of which hold the description, twice; the others are numbered
through the file, so that it is known how many are missing; the data section and the index have CRC-32s too.
A place that does not fit its sum is left out up to the next that does.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import math
import os
import platform
import queue
import re
import struct
import tempfile
import threading
import time
import tomllib
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path as File
from typing import Any, NamedTuple

from steerkit._support import files
from steerkit._support.errors import require
from steerkit._support.files import atomic_write
from steerkit.car import protocol
from steerkit.car.config import CarConfig, Reading
from steerkit.car.core import Core, End, Event, Frame, Link, Note, Output, Packet, RecordingFault, Send, Tick
from steerkit.paths.path import Path

_log = logging.getLogger("steerkit.car")
_KINDS: dict[str, dict[str, Any]] = {
    "number": {"type": ["number", "string"]},  # a NaN or an infinity is written as a text
    "id": {"type": "integer"},
    "text": {"type": "string"},
    "flag": {"type": "boolean"},
}
TOPICS = {
    "/can/rx": {"t": "number", "arrived": "number", "id": "id", "data": "text", "kind": "text"},
    "/can/tx": {"t": "number", "id": "id", "data": "text"},
    "/client": {"t": "number", "link": "id", "data": "text", "up": "flag"},
    "/tick": {"t": "number"},
    "/end": {"t": "number", "cause": "text"},
    "/state": {"t": "number", "from": "text", "to": "text", "cause": "text"},
    "/command": {"t": "number", "request": "number", "sent": "number", "why": "text"},
    "/steers": {"t": "number", "what": "text"},
    "/car": {"t": "number", "mode": "text"},
    "/refused": {"t": "number", "order": "text", "why": "text"},
    "/recording": {"t": "number", "wrong": "text"},
    "/estimates": {"t": "number"},
    "/safety": dict.fromkeys(("t", *protocol.Filtered._fields), "number"),
    "/adapted": dict.fromkeys(("t", *protocol.Adapted._fields), "number"),
    "/description": {"t": "number"},
}
"""Topics with the kinds of their messages' fields. A topic's place is its number in the file: only add at the end."""
NAME = "steerkit"
"""Profile and library in the file's header."""
DESCRIPTION, COPIES = "/description", 2
"""The topic of the description, and how often it is written: each copy in a chunk of its own, before all messages."""
CHUNK = 65536
"""Bytes from which a chunk is closed at once."""
_MAGIC = b"\x89MCAP0\r\n"
_HEADER = struct.pack("<BQI8sI8s", 0x01, 24, 8, NAME.encode(), 8, NAME.encode())  # profile and library
_HEAD = struct.Struct("<BQQQQIIQ")  # of a chunk that is not compressed: up to where its records begin
_RECORD = struct.Struct("<BQ")
_CHANNEL = struct.Struct("<9xHHI")
_MESSAGE = struct.Struct("<9xHIQQ")
_DATA_END = struct.Struct("<BQI")
_DATA_END_HEAD = b"\x0f\x04" + bytes(7)
_FOOTER = 37  # bytes, with the magic behind it
_STARTS = re.compile(rb"(?=\x06.{4}\0{4})", re.DOTALL)


class Line(NamedTuple):
    """A message as it lies in the file."""

    number: int
    """Of all messages that were written to the file."""
    topic: str
    when: int
    """Since 1970 [ns]."""
    data: bytes
    values: dict[str, Any]


class Chunk(NamedTuple):
    """A chunk that fits its sum; `begin` and `end` are places in the file."""

    begin: int
    end: int
    lines: list[Line]


class Contents(NamedTuple):
    """All that is intact in a file, and where it is not."""

    description: dict[str, str] | None
    """None when both of its copies are damaged."""
    chunks: list[Chunk]
    damaged: list[tuple[int, int]]
    """From where to where, in bytes."""
    finished: bool
    """Is its end there?"""
    total: int | None
    """How many messages its index counts; None without an intact index."""


class RecordingFile:
    """A new file to write messages to; nobody else can repair it as long as it is open.

    description: texts about what is in it. Raises FileExistsError, and OSError from everything.
    """

    def __init__(self, file: str | os.PathLike[str], description: dict[str, str]):
        from mcap.writer import CompressionType, IndexType, Writer

        self._stream = File(file).open("xb")  # noqa: SIM115
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX)  # a reader that looks whether it is in use is gone at once
        except OSError as error:
            _log.warning("%s cannot be locked, so a repair cannot know that it is being written: %s", file, error)
        self._writer = Writer(
            self._stream,
            chunk_size=CHUNK,
            compression=CompressionType.NONE,
            index_types=IndexType.CHUNK,
            enable_data_crcs=True,
        )
        self._count = 0
        try:
            self._writer.start(profile=NAME, library=NAME)
            self._channels = {topic: self._channel(topic, fields) for topic, fields in TOPICS.items()}
            data = json.dumps({"t": 0.0, "texts": description}).encode()
            for _ in range(COPIES):
                self._writer.add_message(self._channels[DESCRIPTION], 0, data, 0, 0)
                self.flush()
            self.sync()
        except BaseException:
            self.abandon()
            raise

    def _channel(self, topic: str, fields: dict[str, str]) -> int:
        properties = {name: _KINDS[kind] for name, kind in fields.items()}
        schema = json.dumps({"type": "object", "properties": properties}).encode()
        number = self._writer.register_schema(topic.strip("/"), "jsonschema", schema)
        return self._writer.register_channel(topic, "json", number)

    def add(self, topic: str, when: int, data: bytes, number: int | None = None) -> None:
        """A message; it is in the file after `flush`. number: its own in the file that it is copied from."""
        if topic not in self._channels:
            self._channels[topic] = self._channel(topic, {})
        count = self._count if number is None else number
        self._writer.add_message(self._channels[topic], when, data, when, count)
        self._count = count + 1

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system: a kill loses nothing of it."""
        self._writer.flush()

    def sync(self) -> None:
        """`flush`, and wait until the disk has it all: losing power loses nothing of it."""
        self.flush()
        files.sync(self._stream)

    def close(self) -> None:
        """Write the file's end and close it."""
        self._writer.finish()
        self._stream.flush()
        files.sync(self._stream)
        self._stream.close()

    def abandon(self) -> None:
        """Close it as it is."""
        with contextlib.suppress(OSError):
            self._stream.close()


def in_use(file: str | os.PathLike[str]) -> bool:
    """Is somebody writing that file?"""
    with File(file).open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks: its writer has said so
            return False
    return False


def contents(data: bytes) -> Contents:
    """What is intact in a file of which `data` are the bytes; raises nothing, whatever they are.

    Time is proportional to their number, up to the length of a chunk for each damaged place.
    """
    description, chunks, damaged = None, list[Chunk](), list[tuple[int, int]]()
    index = _index(data)
    limit = index.begin - _DATA_END.size if index else len(data)
    at = 8 + len(_HEADER)
    if data[:8] != _MAGIC:
        damaged.append((0, min(8, len(data))))
    if data[8:at] != _HEADER:
        at = _next(data, 8)
        damaged.append((8, at))
    sound = False
    while at < limit and not sound:
        if chunk := _chunk(data, at):
            first = chunk.lines[0]
            if first.topic == DESCRIPTION:
                description = first.values.get("texts")
            else:
                chunks.append(chunk)
            times = [line.when for line in chunk.lines]
            if _HEAD.unpack_from(data, at)[2:4] != (min(times), max(times)):
                damaged.append((at + 9, at + 25))
            at = chunk.end
        elif data[at : at + 9] == _DATA_END_HEAD and data[at : at + _DATA_END.size] == _data_end(data, at):
            sound = True
        else:
            begin, at = at, min(_next(data, at + 1), limit)
            damaged.append((begin, at))
    if index:
        written, expected = data[limit : index.begin], _data_end(data, limit)
        if written[:9] != _DATA_END_HEAD or (written != expected and not damaged):  # else its sum shows nothing new
            damaged.append((limit, index.begin))
    elif sound:
        damaged.append((at + _DATA_END.size, len(data)))
    total = index.total - COPIES if index and index.total is not None else None
    damaged = [(a, b) for a, b in damaged if a < b or a == len(data)]  # the end may be missing and nothing else
    return Contents(description, chunks, damaged, index is not None or sound, total)


def _next(data: bytes, at: int) -> int:
    """Where the next intact chunk begins, from `at` on."""
    return next((m.start() for m in _STARTS.finditer(data, at) if _chunk(data, m.start())), len(data))


def _chunk(data: bytes, at: int) -> Chunk | None:
    """The chunk that begins at `at`; None when there is none, or it does not fit its sum."""
    if len(data) < at + _HEAD.size:
        return None
    opcode, length, _, _, size, crc, name, stored = _HEAD.unpack_from(data, at)
    last = at + 9 + length
    if opcode != 0x06 or name != 0 or size != stored or length != _HEAD.size - 9 + stored or last > len(data):
        return None
    records = data[at + _HEAD.size : last]
    if zlib.crc32(records) != crc:
        return None
    try:
        lines = _lines(records)
    except (struct.error, ValueError, TypeError, KeyError, AttributeError):
        return None  # a good sum of what is none of ours
    return Chunk(at, last, lines) if lines else None


def _lines(records: bytes) -> list[Line]:
    """The messages in a chunk's records."""
    lines, topics, at = list[Line](), dict(enumerate(TOPICS, 1)), 0
    while at < len(records):
        opcode, length = _RECORD.unpack_from(records, at)
        end = at + _RECORD.size + length
        match opcode:
            case 0x04:  # a channel: its number, its schema's, its topic
                number, _, size = _CHANNEL.unpack_from(records, at)
                topics[number] = records[at + _CHANNEL.size : at + _CHANNEL.size + size].decode()
            case 0x05:
                channel, number, when, _ = _MESSAGE.unpack_from(records, at)
                data = records[at + _MESSAGE.size : end]
                values = {key: _value(value) for key, value in json.loads(data.decode()).items()}
                float(values["t"])  # every message has one
                lines.append(Line(number, topics.get(channel, str(channel)), when, data, values))
        at = end
    return lines


def _value(value: Any) -> Any:
    return float(value) if value in ("nan", "inf", "-inf") else value


class _Index(NamedTuple):
    """The index at a file's end."""

    begin: int
    total: int | None
    """How many messages there are."""


def _index(data: bytes) -> _Index | None:
    """The index at the file's end; None when it is cut off or does not fit its sum."""
    if len(data) < _FOOTER or data[-8:] != _MAGIC:
        return None
    begin = int.from_bytes(data[-28:-20], "little")
    if not _DATA_END.size <= begin <= len(data) - _FOOTER:
        return None
    if zlib.crc32(data[begin:-12]) != int.from_bytes(data[-12:-8], "little"):
        return None
    place = begin
    while place < len(data) - _FOOTER:
        if data[place] == 0x0B:
            return _Index(begin, int.from_bytes(data[place + 9 : place + 17], "little"))
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    return _Index(begin, None)


def _data_end(data: bytes, at: int) -> bytes:
    """The record that ends a data section of `at` bytes."""
    return _DATA_END.pack(0x0F, 4, zlib.crc32(memoryview(data)[:at]))


class Gap(NamedTuple):
    """A place where a file is damaged, cut off, or where messages were missing already when it was repaired."""

    begin: int
    """Byte of the file; so is `end`, the first one behind."""
    end: int
    after: float | None
    """t of the last message before it [s]; None at the beginning."""
    before: float | None
    """t of the first message behind it [s]; None at the end."""
    missing: int | None
    """Messages; None where their number is not known."""

    def __str__(self) -> str:
        where = f"bytes {self.begin} to {self.end}" if self.end > self.begin else f"at byte {self.begin}"
        if self.missing == 0:
            return f"{where}: no message is missing"
        since = "the beginning" if self.after is None else f"{self.after:.3f} s"
        until = "the end" if self.before is None else f"{self.before:.3f} s"
        count = f"{self.missing} messages are" if self.missing else "an unknown number of messages is"
        return f"{where}: {count} missing between {since} and {until}"


def gaps_in(parts: Contents, size: int) -> list[Gap]:
    """Where messages are missing, and where bytes are damaged even if none is."""
    gaps, damaged, known, count = list[Gap](), list(parts.damaged), 0, 0
    after: float | None = None
    for chunk in parts.chunks:
        here = [place for place in damaged if place[0] < chunk.end]  # a chunk's own head counts as before it
        damaged = damaged[len(here) :]
        missing = max(0, chunk.lines[0].number - known)
        if here or missing:
            begin, end = (here[0][0], here[-1][1]) if here else (chunk.begin, chunk.begin)
            gaps.append(Gap(begin, end, after, chunk.lines[0].values.get("t"), missing))
        after, known, count = chunk.lines[-1].values.get("t"), chunk.lines[-1].number + 1, count + len(chunk.lines)
    at_the_end: int | None = None
    if parts.finished:
        counted = sum(gap.missing or 0 for gap in gaps if gap.end > gap.begin)  # others were missing before a repair
        at_the_end = 0 if parts.total is None else max(0, parts.total - count - counted)
    if damaged or at_the_end != 0:
        begin, end = (damaged[0][0], damaged[-1][1]) if damaged else (size, size)
        gaps.append(Gap(begin, end, after, None, at_the_end))
    return gaps


FLUSH = 0.2
"""Longest time that a message waits for the operating system [s]."""
SYNC = 0.5
"""Longest time that the operating system's part waits for the disk, if that takes no time [s]."""
STALL = 5.0
"""From when on a disk that does not answer is reported [s]."""
BACKLOG = 200_000
"""Events that wait for a disk that does not answer; then the recording ends there, before the memory does."""
_PACKAGES = ("steerkit-control", "numpy", "scipy", "cantools", "python-can", "mcap")


class Recording:
    """Writes a recording from a thread of its own, so that a slow disk never holds up the car server.

    file: a new one. description: texts about the run, as `described` makes them; versions are added. Raises
    FileExistsError, and OSError when not even the beginning can be written.
    """

    def __init__(self, file: str | os.PathLike[str], description: dict[str, str]):
        self.file = File(file)
        self._broken = ""
        self._written = RecordingFile(self.file, {**description, "protocol": str(protocol.VERSION), **_versions()})
        self._alive = time.monotonic()
        self._epoch = time.time_ns()
        self._begun: float | None = None
        self._queue: queue.SimpleQueue[list[tuple[str, dict[str, Any]]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def failed(self) -> str:
        """What is wrong with it; "" when all is well. An error stays, a disk that does not answer may come back."""
        silent = time.monotonic() - self._alive
        if self._broken or silent < STALL or not self._thread.is_alive():
            return self._broken
        return f"{self.file}: the disk has not answered for more than {STALL:g} s"

    def event(self, event: Event, outputs: list[Output]) -> None:
        """One event of the core and what it answered; returns at once. A kill loses both or neither."""
        if self._broken:
            return
        if self._queue.qsize() > BACKLOG:
            self._broken = f"{self.file}: the disk does not keep up; {BACKLOG} events wait for it"
        lines = list[tuple[str, dict[str, Any]]]()
        put = lines.append
        match event:
            case Frame():
                record = {"t": event.t, "arrived": event.arrived, "id": event.frame_id, "data": event.data.hex()}
                record |= {"kind": event.kind} if event.kind else {}
                put(("/can/rx", record))
            case Packet():
                put(("/client", {"t": event.t, "link": event.link, "data": event.data.hex()}))
            case Link():
                put(("/client", {"t": event.t, "link": event.link, "up": event.up}))
            case Tick():
                put(("/tick", {"t": event.t}))
            case RecordingFault():
                put(("/recording", {"t": event.t, "wrong": event.wrong}))
            case End():
                put(("/end", {"t": event.t, "cause": event.cause}))
        for out in outputs:
            match out:
                case Send():
                    put(("/can/tx", {"t": event.t, "id": out.frame_id, "data": out.data.hex()}))
                case Note():
                    put((f"/{out.topic}", out.values))
        self._queue.put(lines)

    def close(self, timeout: float = 10.0) -> None:
        """Write what is left and the file's end; `failed` says so when that does not succeed within `timeout` [s]."""
        self._queue.put(None)
        self._thread.join(timeout)
        if self._thread.is_alive():
            self._broken = self._broken or f"{self.file}: its end could not be written within {timeout:g} s"

    def _run(self) -> None:
        try:
            self._write()
        except OSError as error:
            self._broken = f"{self.file}: {error}"
            self._written.abandon()
        except BaseException as error:  # whatever ends it, the car server has to know, and to go on without it
            self._broken = f"{self.file}: {type(error).__name__}: {error}"
            with suppress(OSError):
                self._written.close()

    def _write(self) -> None:
        flushed = synced = time.monotonic()
        while True:
            try:
                item = self._queue.get(timeout=FLUSH)
            except queue.Empty:
                pass
            else:
                if item is None:
                    break
                for line in item:
                    self._add(*line)
            self._alive = now = time.monotonic()
            if now - synced > SYNC:
                self._written.sync()
                flushed = synced = time.monotonic()
            elif now - flushed > FLUSH:
                self._written.flush()
                flushed = now
        self._written.close()

    def _add(self, topic: str, values: dict[str, Any]) -> None:
        data = json.dumps({k: _plain(v) for k, v in values.items()}, separators=(",", ":")).encode()
        if self._begun is None:
            self._begun = values["t"]
        self._written.add(topic, self._epoch + round((values["t"] - self._begun) * 1e9), data)


def _plain(value: Any) -> Any:
    """JSON knows neither NaN nor infinity; Python's repr of a finite float comes back bit for bit."""
    return repr(value) if isinstance(value, float) and not math.isfinite(value) else value


def _versions() -> dict[str, str]:
    """Of all that a replay's numbers come from."""
    versions = {"python": platform.python_version(), "machine": platform.platform()}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions


def described(config: CarConfig, path: Path, time_scale: float = 1.0) -> dict[str, str]:
    """The description of a recording made with that configuration and course: all that a replay needs.

    The nets of a learner are not in it: of each the recording has its file and SHA-256 (see `Remark`).
    """
    files = {f"file:{name}": text for name, text in config.texts.items()}
    return files | {"time_scale": repr(time_scale), **_facts(config, path)}


def _facts(config: CarConfig, path: Path) -> dict[str, str]:
    """What built-in names mean, to notice when they mean something else later."""
    return {"course": protocol.digest(path).hex(), "vehicle": json.dumps(asdict(config.vehicle))}


def differences(recorded: Recorded, config: CarConfig, path: Path) -> list[str]:
    """What is different now from when the recording was made, so that its replay may be."""
    now = _versions() | _facts(config, path)
    then = recorded.metadata
    changed = [name for name, text in now.items() if then.get(name, text) != text]
    texts = {"course": "the course of that name is another one", "vehicle": "the vehicle of that name is another one"}
    return [texts.get(name, f"{name} {then[name]}, now {now[name]}") for name in changed]


class Message(NamedTuple):
    """One recorded message."""

    topic: str
    values: dict[str, Any]


class Recorded(NamedTuple):
    """A recording, read."""

    metadata: dict[str, str]
    messages: list[Message]
    gaps: list[Gap]
    size: int
    """Bytes of the file."""
    in_use: bool
    """Was it still being written? Then its end is not missing, but yet to come."""

    @property
    def sound(self) -> bool:
        """Was the file closed properly, and is every byte as it was written? Otherwise a repair does it good."""
        return not self.in_use and not any(gap.end > gap.begin or gap.before is None for gap in self.gaps)

    @property
    def lost(self) -> list[str]:
        """Which messages are missing, or may be; also those that were missing before a repair."""
        earlier = json.loads(self.metadata.get("repaired", "[]"))
        return [*earlier, *(str(gap) for gap in self.gaps if gap.missing != 0 and (gap.end > gap.begin or not earlier))]

    @property
    def whole(self) -> bool:
        """Is it sound, and nothing missing?"""
        return self.sound and not self.lost

    def kept(self) -> str:
        """How much of how much is there."""
        known = [gap.missing for gap in self.gaps if gap.missing is not None]
        more = " and an unknown number" if len(known) < len(self.gaps) else ""
        bad = sum(gap.end - gap.begin for gap in self.gaps)
        times = [m.values["t"] for m in self.messages]
        span = times[-1] - times[0] if times else 0.0
        gone = sum(g.before - g.after for g in self.gaps if g.missing and g.before is not None and g.after is not None)
        return (
            f"{len(times)} of {len(times) + sum(known)}{more} messages, {self.size - bad} of {self.size} bytes, "
            f"{span - gone:.2f} of {span:.2f}{' or more' if more else ''} seconds"
        )

    def of(self, topic: str) -> list[dict[str, Any]]:
        """All messages of a topic such as "/can/tx"."""
        return [m.values for m in self.messages if m.topic == topic]

    def events(self) -> Iterator[Event]:
        """What the core was given, in order."""
        for topic, v in self.messages:
            match topic:
                case "/can/rx":
                    yield Frame(v["t"], v["arrived"], v["id"], bytes.fromhex(v["data"]), v.get("kind", ""))
                case "/client" if "up" in v:
                    yield Link(v["t"], v["link"], v["up"])
                case "/client":
                    yield Packet(v["t"], v["link"], bytes.fromhex(v["data"]))
                case "/tick":
                    yield Tick(v["t"])
                case "/recording":
                    yield RecordingFault(v["t"], v["wrong"])
                case "/end":
                    yield End(v["t"], v["cause"])


def read(file: str | os.PathLike[str]) -> Recorded:
    """All that is intact in a recording, also behind a damaged place, and one that is still being written.

    Raises ValueError for a file of another kind, one that was cut off before it began, and one of an older protocol.
    """
    return _read(file)[0]


def _read(file: str | os.PathLike[str]) -> tuple[Recorded, Contents]:
    used = in_use(file)  # before its bytes are read, as it may be closed in between
    try:
        return _read_bytes(File(file).read_bytes(), used)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


def _read_bytes(data: bytes, used: bool = False) -> tuple[Recorded, Contents]:
    parts = contents(data)
    if parts.description is None and not parts.chunks:
        if data[:8] == _MAGIC and not (_MAGIC + _HEADER).startswith(data[: 8 + len(_HEADER)]):
            raise ValueError("an MCAP file of another program, not a recording of steerkit")
        raise ValueError("no recording of steerkit, or cut off before it began")
    metadata, wanted = parts.description or {}, str(protocol.VERSION)
    if metadata.get("protocol", wanted) != wanted:
        raise ValueError(
            f"a recording of protocol {metadata['protocol']}, this is {wanted}; replay it with the steerkit that made "
            f"it, {metadata.get('steerkit-control', 'of an unknown version')}"
        )
    messages = [Message(line.topic, line.values) for chunk in parts.chunks for line in chunk.lines]
    gaps = gaps_in(parts, len(data))
    if used and gaps and gaps[-1].before is None and gaps[-1].missing is None:
        gaps.pop()
    return Recorded(metadata, messages, gaps, len(data), used), parts


def config_of(recorded: Recorded) -> CarConfig:
    """The configuration that a recording was made with; it depends on no file but the recording.

    Raises ValueError, with their names, when it lacks files.
    """
    texts = {k.removeprefix("file:"): text for k, text in recorded.metadata.items() if k.startswith("file:")}
    require("config.toml" in texts, "the recording", "its description is damaged or has no configuration: no replay")
    data = tomllib.loads(texts["config.toml"])
    databases = data.get("files", {}).get("dbc", [])
    course, car = data.get("course", {}), data.get("vehicle", {})
    named = [*databases, *([course["file"]] if "file" in course else [])]
    named += [car["name"]] if str(car.get("name", "")).endswith(".toml") else []
    missing = [name for name in named if name not in texts]
    require(not missing, "the recording", f"it lacks {', '.join(missing)}, named by its configuration: no replay")
    with tempfile.TemporaryDirectory() as folder:
        short = {name: f"{k}-{File(name).name}" for k, name in enumerate(named)}  # their folders are not here
        for name, flat in short.items():
            (File(folder) / flat).write_text(texts[name], encoding="cp1252" if name in databases else "utf-8")
        if databases:
            data["files"]["dbc"] = [short[name] for name in databases]
        if "file" in course:
            course["file"] = short[course["file"]]
        car["name"] = short.get(car.get("name"), car.get("name"))
        return Reading(File(folder) / "config.toml", texts["config.toml"], data).config({})


def repair(
    file: str | os.PathLike[str], target: str | os.PathLike[str] | None = None, *, overwrite: bool = False
) -> tuple[Recorded, File]:
    """Write all that is intact in a recording to a new file, with a proper end; `file` itself is never changed.

    target: the new file; by default beside `file`, as NAME.repaired.mcap. overwrite: even if it is there already.
    Returns what is kept, and where. Raises ValueError for a recording that is being written, FileExistsError, and
    OSError when it cannot be written; then `target` is as it was.
    """
    place = File(target) if target else File(file).with_suffix(f".repaired{File(file).suffix}")
    recorded, parts = _read(file)
    require(not recorded.in_use, f"{file}", "is being written by a car server; repair it when that has ended")
    if place.exists() and place.samefile(file):
        raise ValueError(f"{place}: is the recording itself, which a repair never changes; choose another name")
    if place.exists() and not overwrite:
        raise FileExistsError(f"{place}: exists already; it is overwritten only with --overwrite")
    with atomic_write(place) as draft, ExitStack() as stack:
        new = RecordingFile(draft, {**recorded.metadata, "repaired": json.dumps(recorded.lost)})
        stack.callback(new.abandon)
        for chunk in parts.chunks:
            for line in chunk.lines:
                new.add(line.topic, line.when, line.data, line.number)
            new.flush()
        new.close()
    return recorded, place


def replay(recorded: Recorded, core: Core) -> list[tuple[float, Send]]:
    """The frames that `core`, new, sends when it is given the recorded events."""
    sent = []
    for event in recorded.events():
        sent += [(event.t, out) for out in core.handle(event) if isinstance(out, Send)]
    return sent


def replayed_exactly(recorded: Recorded, core: Core) -> tuple[int, int]:
    """(frames sent in the recording, how many of them the replay gives bit for bit at the same moment)."""
    before = [(v["t"], v["id"], v["data"]) for v in recorded.of("/can/tx")]
    after = [(t, s.frame_id, s.data.hex()) for t, s in replay(recorded, core)]
    same = sum(a == b for a, b in zip(before, after))
    return len(before), same if len(after) == len(before) else min(same, len(before) - 1)
