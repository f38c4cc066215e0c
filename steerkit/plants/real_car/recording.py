"""Everything that the driver process received, decided and sent, in an MCAP file that survives a kill.

MCAP (https://mcap.dev) because it is append-only: what has been written can be read, with or without its end; MDF needs
a finished header. Field tools (Foxglove, PlotJuggler, `mcap`) open it; messages are JSON, so none needs our code.
Topics: /can/rx /client /tick (what the core was given), /can/tx (what it sent), /state /command /steers /car /refused
(why).
"""

from __future__ import annotations

import json
import math
import os
import queue
import struct
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path as File
from typing import Any, NamedTuple

from steerkit.files import whole
from steerkit.plants.real_car.decisions.core import Core, End, Event, Frame, Link, Note, Output, Packet, Send, Tick
from steerkit.plants.real_car.file.config import CarConfig
from steerkit.plants.real_car.file.reading import load

FLUSH = 0.2
"""Longest time that a message waits for the operating system [s]."""
_NUMBER = {"type": ["number", "string"]}  # a NaN or an infinity is written as a text
_TEXT = {"type": "string"}
_TOPICS: dict[str, dict[str, Any]] = {
    "/can/rx": {"t": _NUMBER, "arrived": _NUMBER, "id": {"type": "integer"}, "data": _TEXT},
    "/can/tx": {"t": _NUMBER, "id": {"type": "integer"}, "data": _TEXT},
    "/client": {"t": _NUMBER, "link": {"type": "integer"}, "data": _TEXT, "up": {"type": "boolean"}},
    "/tick": {"t": _NUMBER},
    "/end": {"t": _NUMBER, "cause": _TEXT},
    "/state": {"t": _NUMBER, "from": _TEXT, "to": _TEXT, "cause": _TEXT},
    "/command": {"t": _NUMBER, "request": _NUMBER, "sent": _NUMBER, "why": _TEXT},
    "/steers": {"t": _NUMBER, "what": _TEXT},
    "/car": {"t": _NUMBER, "mode": _TEXT},
    "/refused": {"t": _NUMBER, "order": _TEXT, "why": _TEXT},
}


class Recording:
    """Writes a recording from a thread of its own, so that a slow disk never holds up the driver.

    file: a new one. metadata: texts about the run (the configuration, the course). Raises FileExistsError.
    """

    def __init__(self, file: str | os.PathLike[str], metadata: dict[str, str]):
        from mcap.writer import IndexType, Writer

        self.file = File(file)
        self.failed = ""
        self._stream = self.file.open("xb")
        self._writer = Writer(self._stream, use_chunking=False, index_types=IndexType.NONE)
        self._writer.start(profile="steerkit", library="steerkit")
        self._writer.add_metadata("steerkit", metadata)
        self._channels = {}
        for topic, properties in _TOPICS.items():
            schema = {"type": "object", "properties": properties}
            number = self._writer.register_schema(topic.strip("/"), "jsonschema", json.dumps(schema).encode())
            self._channels[topic] = self._writer.register_channel(topic, "json", number)
        self._stream.flush()
        self._epoch = time.time_ns()
        self._begun: float | None = None
        self._queue: queue.SimpleQueue[tuple[str, dict[str, Any]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    def event(self, event: Event, outputs: list[Output]) -> None:
        """One event of the core and what it answered; returns at once."""
        put = self._queue.put
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
            case End():
                put(("/end", {"t": event.t, "cause": event.cause}))
        for out in outputs:
            match out:
                case Send():
                    put(("/can/tx", {"t": event.t, "id": out.frame_id, "data": out.data.hex()}))
                case Note():
                    put((f"/{out.topic}", out.values))

    def close(self) -> None:
        """Write what is left and the file's end."""
        self._queue.put(None)
        self._thread.join(10.0)

    def _write(self) -> None:
        flushed, last = time.monotonic(), False
        try:
            while not last:
                try:
                    item = self._queue.get(timeout=FLUSH)
                    last = item is None
                    if item is not None:
                        self._add(*item)
                except queue.Empty:
                    pass
                if time.monotonic() - flushed > FLUSH or last:
                    self._stream.flush()
                    flushed = time.monotonic()
            self._writer.finish()
            self._stream.close()
        except OSError as error:  # a full disk must not stop the car's driver; it says so in `failed`
            self.failed = f"{self.file}: {error}"

    def _add(self, topic: str, values: dict[str, Any]) -> None:
        data = json.dumps({k: _plain(v) for k, v in values.items()}, separators=(",", ":")).encode()
        if self._begun is None:
            self._begun = values["t"]
        when = self._epoch + round((values["t"] - self._begun) * 1e9)
        self._writer.add_message(self._channels[topic], when, data, when)


def _plain(value: Any) -> Any:
    """JSON knows neither NaN nor infinity; Python's repr of a finite float comes back bit for bit."""
    return repr(value) if isinstance(value, float) and not math.isfinite(value) else value


class Message(NamedTuple):
    """One recorded message."""

    topic: str
    values: dict[str, Any]


class Recorded(NamedTuple):
    """A recording, read."""

    metadata: dict[str, str]
    messages: list[Message]
    whole: bool
    """Was it closed properly? Otherwise its last fraction of a second is missing."""

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
                case "/end":
                    yield End(v["t"], v["cause"])


def read(file: str | os.PathLike[str]) -> Recorded:
    """A recording, even one that was cut short by a kill. Raises ValueError for a file of another kind."""
    from mcap.exceptions import McapError
    from mcap.records import Channel, Metadata
    from mcap.records import Message as McapMessage
    from mcap.stream_reader import StreamReader

    topics: dict[int, str] = {}
    metadata: dict[str, str] = {}
    messages: list[Message] = []
    whole = True
    with File(file).open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Metadata) and record.name == "steerkit":
                    metadata = record.metadata
                elif isinstance(record, McapMessage):
                    values = {k: _number(v) for k, v in json.loads(record.data).items()}
                    messages.append(Message(topics[record.channel_id], values))
        except (McapError, EOFError, struct.error, json.JSONDecodeError, UnicodeDecodeError) as error:
            if not metadata:
                raise ValueError(f"{file}: no recording of steerkit, or cut off before it began ({error})") from error
            whole = False
    if not metadata:
        raise ValueError(f"{file}: an MCAP file of another program, not a recording of steerkit")
    return Recorded(metadata, messages, whole)


def _number(value: Any) -> Any:
    return float(value) if value in ("nan", "inf", "-inf") else value


def config_of(recorded: Recorded) -> CarConfig:
    """The configuration that a recording was made with; its course file, if it names one, is gone after this call."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in recorded.metadata.items():
            if name.startswith("file:"):
                place = File(folder) / File(name.removeprefix("file:")).name
                place.write_text(text, encoding="cp1252" if place.suffix == ".dbc" else "utf-8")
        return load(File(folder) / "config.toml", bus={})


def mend(file: str | os.PathLike[str]) -> Recorded:
    """Give a recording that was cut short its end, so that every MCAP tool opens it; returns what it holds."""
    recorded = read(file)
    if not recorded.whole:
        with whole(file) as draft:
            copy = Recording(draft, recorded.metadata)
            for message in recorded.messages:
                copy._queue.put(message)
            copy.close()
            copy._thread.join()  # however long it takes
            if copy.failed:
                raise OSError(f"{file}: its copy could not be written: {copy.failed}")
    return recorded


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
