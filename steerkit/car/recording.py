"""Everything that the car server received, decided and sent, in a file that survives a kill, and read again.

The file is MCAP (https://mcap.dev), because it is append-only: what has been written can be read, with or without its
end. Field tools (Foxglove, PlotJuggler, `mcap`) open it; messages are JSON. They come in chunks with a CRC-32, the
first two of which hold the description, twice; all are numbered through the file, so that it is known how many are
missing. A place that does not fit its sum is left out up to the next that does.
"""

import contextlib
import errno
import json
import math
import os
import platform
import queue
import re
import struct
import threading
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path as File
from typing import Any, NamedTuple, get_type_hints

from steerkit._support import files
from steerkit._support.errors import require
from steerkit.car import protocol
from steerkit.car.config import CarConfig, Reading
from steerkit.car.core import Core, End, Event, Frame, Link, Note, Output, Packet, RecordingFault, Send, Tick
from steerkit.car.state_machine import Mode

EVENTS: dict[str, type[Event]] = {
    "/can/rx": Frame,
    "/client": Packet,
    "/link": Link,
    "/tick": Tick,
    "/recording": RecordingFault,
    "/end": End,
}
"""The topics of what the core was given."""
DESCRIPTION, COPIES = "/description", 2
"""The topic of the description, and how often it is written: each copy in a chunk of its own, before all messages."""
_CORE = ("/can/tx", "/state", "/command", "/steers", "/car", "/refused", "/estimates", "/safety", "/adapted")
TOPICS = (*EVENTS, *_CORE, DESCRIPTION, "/port")
"""Those, what the core sent and why. A topic's place is its number in the file: only add at the end."""
NAME = "steerkit"
"""Profile and library in the file's header."""
CHUNK = 65536
"""Bytes from which a chunk is closed at once."""
_MAGIC = b"\x89MCAP0\r\n"
_BEGIN = _MAGIC + struct.pack("<BQI8sI8s", 0x01, 24, 8, NAME.encode(), 8, NAME.encode())  # profile and library
_HEAD = struct.Struct("<BQQQQIIQ")  # of a chunk that is not compressed: up to where its records begin
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<9xHIQQ")
_DATA_END = b"\x0f\x04" + bytes(11)
_STARTS = re.compile(rb"\x06.{4}\0{4}|" + _DATA_END, re.DOTALL)


class Message(NamedTuple):
    """One recorded message."""

    topic: str
    values: dict[str, Any]
    number: int = 0
    """Of all messages that were written to the file."""
    when: int = 0
    """Since 1970 [ns]."""
    data: bytes = b""
    """`values` as they lie in the file."""


class RecordingFile:
    """A new file to write messages to.

    description: texts about what is in it. begin: since 1970 [ns]. Raises FileExistsError, and OSError from everything.
    """

    def __init__(self, file: str | os.PathLike[str], description: dict[str, str], begin: int):
        from mcap.writer import CompressionType, IndexType, Writer

        self._stream = File(file).open("xb")  # noqa: SIM115
        self._writer = Writer(
            self._stream, chunk_size=CHUNK, compression=CompressionType.NONE, index_types=IndexType.CHUNK
        )
        self._count = 0
        try:
            self._writer.start(profile=NAME, library=NAME)
            for topic in TOPICS:
                schema = self._writer.register_schema(topic.strip("/"), "jsonschema", b'{"type": "object"}')
                self._writer.register_channel(topic, "json", schema)
            data = json.dumps({"t": 0.0, "texts": description}).encode()
            for _ in range(COPIES):
                self.add(DESCRIPTION, begin, data)
                self._writer.flush()
            self.sync()
        except BaseException:
            self.abandon()
            raise

    def add(self, topic: str, when: int, data: bytes) -> None:
        """A message; it is in the file after `flush`."""
        self._writer.add_message(1 + TOPICS.index(topic), when, data, when, self._count)
        self._count += 1

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system: a kill loses nothing of it."""
        self._writer.flush()

    def sync(self) -> None:
        """`flush`, and wait until the disk has it all: losing power loses nothing of it.

        Raises OSError, also where the file has been deleted.
        """
        self.flush()
        files.sync(self._stream)
        if not os.fstat(self._stream.fileno()).st_nlink:
            raise FileNotFoundError(errno.ENOENT, "it was deleted while it was written")

    def close(self) -> None:
        """Write the file's end and close it."""
        self._writer.finish()
        self._stream.flush()
        self.sync()
        self._stream.close()

    def abandon(self) -> None:
        """Close it as it is."""
        with contextlib.suppress(OSError):
            self._stream.close()


FLUSH = 0.2
"""Longest time that a message waits for the operating system [s]."""
SYNC = 0.5
"""Longest time that the operating system's part waits for the disk, if that takes no time [s]."""
STALL = 5.0
"""From when on a disk that does not answer is reported [s]."""
BACKLOG = 200_000
"""Events that wait for a disk that does not answer; then the recording ends there, before the memory does."""
_TOPIC_OF: dict[type, str] = {kind: topic for topic, kind in EVENTS.items()}
_PACKAGES = ("steerkit-control", "numpy", "scipy", "cantools", "python-can", "mcap")


class Recording:
    """Writes a recording from a thread of its own, so that a slow disk never holds up the car server.

    file: a new one. description: texts about the run, as `described` makes them; versions are added. Raises
    FileExistsError, and OSError when not even the beginning can be written.
    """

    def __init__(self, file: str | os.PathLike[str], description: dict[str, str]):
        self.file = File(file)
        self._broken = ""
        self._epoch = time.time_ns()
        texts = {**description, "protocol": str(protocol.VERSION), **_versions()}
        self._written = RecordingFile(self.file, texts, self._epoch)
        self._alive = time.monotonic()
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
        lines = [(_TOPIC_OF[type(event)], event._asdict())]
        for out in outputs:
            match out:
                case Send():
                    lines.append(("/can/tx", {"t": event.t, **out._asdict()}))
                case Note():
                    lines.append((f"/{out.topic}", out.values))
        self._queue.put(lines)

    def frames(self, t: float, received: Sequence[Any], sent: Sequence[Any]) -> None:
        """A step of a production car's port: the (id, data, bus) of its car's frames, and of those to it; at once."""
        if not self._broken:
            told = [[f"{bus} {frame_id:X} {data.hex()}" for frame_id, data, bus in some] for some in (received, sent)]
            self._queue.put([("/port", {"t": t, "received": told[0], "sent": told[1]})])

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
            with contextlib.suppress(OSError):
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
                for topic, values in item:
                    data = json.dumps({k: _plain(v) for k, v in values.items()}, separators=(",", ":")).encode()
                    if self._begun is None:
                        self._begun = values["t"]
                    self._written.add(topic, self._epoch + round((values["t"] - self._begun) * 1e9), data)
            self._alive = now = time.monotonic()
            if now - synced > SYNC:
                self._written.sync()
                flushed = synced = time.monotonic()
            elif now - flushed > FLUSH:
                self._written.flush()
                flushed = now
        self._written.close()


def _plain(value: Any) -> Any:
    """JSON knows neither bytes, NaN nor infinity; Python's repr of a finite float comes back bit for bit."""
    if isinstance(value, bytes):
        return value.hex()
    return repr(value) if isinstance(value, float) and not math.isfinite(value) else value


def _versions() -> dict[str, str]:
    """Of all that a replay's numbers come from."""
    versions = {"python": platform.python_version(), "machine": platform.platform()}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # a checkout on the path
            versions[name] = "not installed"
    return versions


def described(config: CarConfig, time_scale: float = 1.0) -> dict[str, str]:
    """The description of a recording made with that configuration: all that a replay needs.

    The nets of a learner are not in it: of each the recording has its file and SHA-256 (see `Remark`).
    """
    files = {f"file:{name}": text for name, text in config.texts.items()}
    return files | {"time_scale": repr(time_scale), **_facts(config)}


def _facts(config: CarConfig) -> dict[str, str]:
    """What built-in names mean, to notice when they mean something else later."""
    return {"course": protocol.digest(config.course), "vehicle": json.dumps(asdict(config.vehicle))}


def differences(recorded: "Recorded", config: CarConfig) -> list[str]:
    """What is different now from when the recording was made, so that its replay may be."""
    now = _versions() | _facts(config)
    then = recorded.metadata
    changed = [name for name, text in now.items() if then.get(name, text) != text]
    texts = {"course": "the course of that name is another one", "vehicle": "the vehicle of that name is another one"}
    return [texts.get(name, f"{name} {then[name]}, now {now[name]}") for name in changed]


class Gap(NamedTuple):
    """A place where a file is damaged or cut off."""

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


class Recorded(NamedTuple):
    """A recording, read."""

    metadata: dict[str, str]
    messages: list[Message]
    gaps: list[Gap]
    size: int
    """Bytes of the file."""

    @property
    def lost(self) -> list[str]:
        """Which messages are missing, or may be."""
        return [str(gap) for gap in self.gaps if gap.missing != 0]

    @property
    def whole(self) -> bool:
        """Was the file closed properly, does all that is read fit its sums, and is nothing missing?"""
        return not (self.lost or any(gap.end > gap.begin or gap.before is None for gap in self.gaps))

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
        for message in self.messages:
            if kind := EVENTS.get(message.topic):
                values = message.values
                yield kind(**(values | {"data": bytes.fromhex(values["data"])} if "data" in values else values))


def read(file: str | os.PathLike[str]) -> Recorded:
    """All that is intact in a recording, also behind a damaged place, and so far of one that is still being written.

    Raises ValueError for a file of another kind, one that was cut off before it began, and one of an older protocol.
    """
    try:
        return parse(files.read_bytes(file))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


def parse(data: bytes) -> Recorded:
    """`read` of a file that holds these bytes. Time is proportional to their number, plus a chunk a damaged place."""
    metadata, messages, gaps = dict[str, str](), list[Message](), list[Gap]()
    intact, known, after, finished = len(_BEGIN) if data.startswith(_BEGIN) else 0, COPIES, None, False
    for begin, end, lines in _pieces(data):
        finished = not lines
        missing = max(0, lines[0].number - known) if lines else None
        if begin > intact or missing:
            gaps.append(Gap(intact, begin, after, lines[0].values["t"] if lines else None, missing))
        intact = end
        if lines and lines[0].topic == DESCRIPTION:
            metadata = lines[0].values["texts"]
        elif lines:
            messages += lines
            known, after = lines[-1].number + 1, lines[-1].values["t"]
    if not finished:
        gaps.append(Gap(intact, len(data), after, None, None))
    elif not _index_fits(data[intact:]):
        gaps.append(Gap(intact, len(data), after, None, 0))
    if not metadata and not messages:
        if data.startswith(_MAGIC) and not _BEGIN.startswith(data[: len(_BEGIN)]):
            raise ValueError("an MCAP file of another program, not a recording of steerkit")
        raise ValueError("no recording of steerkit, or cut off before it began")
    then, wanted = metadata.get("protocol"), str(protocol.VERSION)
    if then not in (None, wanted):
        maker = metadata.get("steerkit-control", "of an unknown version")
        hint = f"replay it with the steerkit that made it, {maker}"
        raise ValueError(f"a recording of protocol {then}, this is {wanted}; {hint}")
    return Recorded(metadata, messages, gaps, len(data))


def _pieces(data: bytes) -> Iterator[tuple[int, int, list[Message]]]:
    """Where each intact chunk begins and ends, and its messages; last the data's end, which has none."""
    at = 0
    while found := _STARTS.search(data, at):
        at = found.start()
        if found[0] == _DATA_END:
            yield at, at + len(_DATA_END), []
            return
        end, lines = _chunk(data, at)
        if lines:
            yield at, end, lines
        at = end if lines else at + 1


def _chunk(data: bytes, at: int) -> tuple[int, list[Message]]:
    """The end and the messages of the chunk that begins at `at`; none when it does not fit its sum."""
    if len(data) < at + _HEAD.size:
        return at, []
    _, length, _, _, size, crc, name, stored = _HEAD.unpack_from(data, at)
    end = at + 9 + length
    if name != 0 or size != stored or length != _HEAD.size - 9 + stored or end > len(data):
        return at, []
    records = data[at + _HEAD.size : end]
    if zlib.crc32(records) != crc:
        return at, []
    try:
        return end, _messages(records)
    except (struct.error, ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError):
        return at, []  # a good sum of what is none of ours


def _messages(records: bytes) -> list[Message]:
    """The messages in a chunk's records."""
    messages, at = list[Message](), 0
    while at < len(records):
        opcode, length = _RECORD.unpack_from(records, at)
        end = at + _RECORD.size + length
        if opcode == 0x05:
            channel, number, when, _ = _MESSAGE.unpack_from(records, at)
            data = records[at + _MESSAGE.size : end]
            values = {key: _value(value) for key, value in json.loads(data.decode()).items()}
            _check(TOPICS[channel - 1], values)
            messages.append(Message(TOPICS[channel - 1], values, number, when, data))
        at = end
    return messages


_MADE: dict[str, Any] = EVENTS | {"/car": protocol.Snapshot}
_HINTS = {topic: get_type_hints(kind) for topic, kind in _MADE.items()}


def _check(topic: str, values: dict[str, Any]) -> None:
    """Raise one of the errors that `_chunk` expects for a message that is none of ours."""
    values["t"] + 0.0  # every one has a t
    if topic == DESCRIPTION:
        "".join(values["texts"].values())
    for value, kind in zip(_MADE[topic](**values), _HINTS[topic].values()) if topic in _MADE else ():
        if kind in (bytes, Mode):
            bytes.fromhex(value) if kind is bytes else Mode(value)
        elif kind is float:
            value + 0.0
        elif type(value) is not kind or (kind is int and abs(value) >= 1 << 63):
            raise TypeError


def _value(value: Any) -> Any:
    return float(value) if value in ("nan", "inf", "-inf") else value


def _index_fits(index: bytes) -> bool:
    """Is that the whole index at a file's end, which only other programs use?"""
    sum_of = zlib.crc32(index[:-12])
    return index[-8:] == _MAGIC and sum_of == int.from_bytes(index[-12:-8], "little")


def config_of(recorded: Recorded) -> CarConfig:
    """The configuration that a recording was made with; it depends on no file but the recording.

    Raises ValueError, with their names, when it lacks files.
    """
    texts = {k.removeprefix("file:"): text for k, text in recorded.metadata.items() if k.startswith("file:")}
    require("config.toml" in texts, "the recording", "its description is damaged or has no configuration: no replay")
    return Reading("the recording", files.toml_of(texts["config.toml"], "the recording"), texts).config({})


def replayed_exactly(recorded: Recorded, core: Core) -> tuple[int, int]:
    """(frames sent in the recording, how many of them `core`, new, sends bit for bit at the same moment)."""
    before = [(v["t"], v.get("frame_id"), v.get("data")) for v in recorded.of("/can/tx")]
    answers = ((event.t, out) for event in recorded.events() for out in core.handle(event))
    after = [(t, out.frame_id, out.data.hex()) for t, out in answers if isinstance(out, Send)]
    same = sum(a == b for a, b in zip(before, after))
    return len(before), same if len(after) == len(before) else min(same, len(before) - 1)
