"""The file of a recording: MCAP in which every byte is covered by a check sum, and which is read around any damage.

MCAP (https://mcap.dev) because it is append-only: what has been written can be read, with or without its end; MDF needs
a finished header. Field tools (Foxglove, PlotJuggler, `mcap`) open it; messages are JSON, so none needs our code.

The description stands at the beginning, twice, each with its own sum. Messages come in chunks with a CRC-32, and are
numbered through the file, so that it is known how many are missing. The data section and the index at the end have
CRC-32s of their own (all of it as MCAP has them). A place that does not fit its sum is left out up to the next that
does.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import re
import struct
import zlib
from io import BytesIO
from pathlib import Path as File
from typing import Any, NamedTuple

from steerkit._support import files

_log = logging.getLogger("steerkit.car")
_NUMBER = {"type": ["number", "string"]}  # a NaN or an infinity is written as a text
_TEXT = {"type": "string"}
TOPICS: dict[str, dict[str, Any]] = {
    "/can/rx": {"t": _NUMBER, "arrived": _NUMBER, "id": {"type": "integer"}, "data": _TEXT, "kind": _TEXT},
    "/can/tx": {"t": _NUMBER, "id": {"type": "integer"}, "data": _TEXT},
    "/client": {"t": _NUMBER, "link": {"type": "integer"}, "data": _TEXT, "up": {"type": "boolean"}},
    "/tick": {"t": _NUMBER},
    "/end": {"t": _NUMBER, "cause": _TEXT},
    "/state": {"t": _NUMBER, "from": _TEXT, "to": _TEXT, "cause": _TEXT},
    "/command": {"t": _NUMBER, "request": _NUMBER, "sent": _NUMBER, "why": _TEXT},
    "/steers": {"t": _NUMBER, "what": _TEXT},
    "/car": {"t": _NUMBER, "mode": _TEXT},
    "/refused": {"t": _NUMBER, "order": _TEXT, "why": _TEXT},
    "/recording": {"t": _NUMBER, "wrong": _TEXT},
    "/estimates": {"t": _NUMBER},
    "/safety": {
        "t": _NUMBER,
        "command": _NUMBER,
        "delta_sw": _NUMBER,
        "share": _NUMBER,
        "reach": _NUMBER,
        "reason": _NUMBER,
    },
    "/adapted": {"t": _NUMBER, "delay": _NUMBER, "ratio": _NUMBER},
}
"""Topics with the properties of their messages. A topic's place is its number in the file: only ever add at the end."""
NAME = "steerkit"
"""Profile and library in the file's header, and the name of its description."""
SUM = "crc32"
"""Key of the description's check sum in the description."""
CHUNK = 65536
"""Bytes from which a chunk is closed at once."""
_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQQQQIIQ")  # of a chunk that is not compressed: up to where its records begin
_RECORD = struct.Struct("<BQ")
_CHANNEL = struct.Struct("<9xHHI")
_MESSAGE = struct.Struct("<9xHIQQ")
_DATA_END = struct.Struct("<BQI")
_DATA_END_HEAD = b"\x0f\x04" + bytes(7)
_FOOTER = 37  # bytes, with the magic behind it
_STARTS = re.compile(rb"(?=\x06.{4}\0{4}|\x0c.{4}\0{4}\x08\0\0\0steerkit)", re.DOTALL)


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
    """How many messages its index tells of; None without an intact index."""


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
            _log.warning("%s cannot be locked, so a repair could not tell that it is being written: %s", file, error)
        self._writer = Writer(
            self._stream,
            chunk_size=CHUNK,
            compression=CompressionType.NONE,
            index_types=IndexType.CHUNK | IndexType.METADATA,
            enable_data_crcs=True,
        )
        self._count = 0
        try:
            self._writer.start(profile=NAME, library=NAME)
            for _ in range(2):
                self._writer.add_metadata(NAME, {**description, SUM: _sum(description)})
            self._channels = {topic: self._channel(topic, properties) for topic, properties in TOPICS.items()}
            self.sync()
        except BaseException:
            self.abandon()
            raise

    def _channel(self, topic: str, properties: dict[str, Any]) -> int:
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
    header, at = _header(), 8 + len(_header())
    if data[:8] != _MAGIC:
        damaged.append((0, min(8, len(data))))
    if data[8:at] != header:
        at = _next(data, 8)
        damaged.append((8, at))
    sound = False
    while at < limit and not sound:
        if chunk := _chunk(data, at):
            chunks.append(chunk)
            times = [line.when for line in chunk.lines]
            if _HEAD.unpack_from(data, at)[2:4] != (min(times), max(times)):
                damaged.append((at + 9, at + 25))
            at = chunk.end
        elif copy := _description(data, at):
            description, at = copy
        elif data[at : at + 9] == _DATA_END_HEAD and data[at : at + _DATA_END.size] == _data_end(data, at):
            sound = True
        else:
            begin, at = at, min(_next(data, at + 1), limit)
            damaged.append((begin, at))
    if index:
        written, expected = data[limit : index.begin], _data_end(data, limit)
        if written[:9] != _DATA_END_HEAD or (written != expected and not damaged):  # else its sum tells nothing new
            damaged.append((limit, index.begin))
    elif sound:
        damaged.append((at + _DATA_END.size, len(data)))
    total = index.total if index else None
    damaged = [(a, b) for a, b in damaged if a < b or a == len(data)]  # the end may be missing and nothing else
    return Contents(description, chunks, damaged, index is not None or sound, total)


def _next(data: bytes, at: int) -> int:
    """Where the next intact chunk or description begins, from `at` on."""
    for match in _STARTS.finditer(data, at):
        if _chunk(data, match.start()) or _description(data, match.start()):
            return match.start()
    return len(data)


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


def _description(data: bytes, at: int) -> tuple[dict[str, str], int] | None:
    """The description that begins at `at`, and where it ends; None when there is none, or it does not fit its sum."""
    from mcap.data_stream import ReadDataStream, RecordBuilder
    from mcap.exceptions import McapError
    from mcap.records import Metadata

    if data[at : at + 1] != b"\x0c" or len(data) < at + 9:
        return None
    end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    if end > len(data):
        return None
    try:
        record = Metadata.read(ReadDataStream(BytesIO(data[at + 9 : end])))
    except (McapError, struct.error, ValueError):
        return None
    builder = RecordBuilder()
    record.write(builder)
    texts = {key: text for key, text in record.metadata.items() if key != SUM}
    if builder.end() != data[at:end] or record.name != NAME or record.metadata.get(SUM) != _sum(texts):
        return None
    return texts, end


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


def _header() -> bytes:
    from mcap.data_stream import RecordBuilder
    from mcap.records import Header

    builder = RecordBuilder()
    Header(NAME, NAME).write(builder)
    return bytes(builder.end())


def _sum(texts: dict[str, str]) -> str:
    return f"{zlib.crc32(json.dumps(texts, sort_keys=True).encode()):08x}"


def what_is_wrong(data: bytes) -> str:
    """Why a file in which nothing is intact cannot be read."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.records import Header, Metadata

    nothing = "no recording of steerkit, or cut off before it began"
    if (_MAGIC + _header()).startswith(data):
        return nothing
    try:
        stream = ReadDataStream(BytesIO(data[17:]))
        if data[:8] != _MAGIC or Header.read(stream).library != NAME:
            return "an MCAP file of another program, not a recording of steerkit" if data[:8] == _MAGIC else nothing
        stream.read(9)
        old = Metadata.read(stream)
    except (McapError, struct.error, ValueError):
        return nothing
    if old.name != NAME or SUM in old.metadata:
        return nothing
    hello = re.search(rb'"data":"480[01]([0-9a-f]{2})', data)  # a client's first packet tells the version
    return f"a recording of protocol {int(hello[1], 16) if hello else '1 or 2'}; replay it with the steerkit of then"


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
    """Messages; None where nothing tells how many there were."""

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
