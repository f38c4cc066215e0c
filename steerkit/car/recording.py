"""Everything that the car server received, decided and sent, in a file that survives a kill, and read again.

Topics: /can/rx /client /tick /recording /end (what the core was given), /can/tx (what it sent), /state /command /steers
/car /refused (why). How they lie in the file, and what protects them there: `recording_file`.
"""

from __future__ import annotations

import json
import math
import os
import platform
import queue
import tempfile
import threading
import time
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path as File
from typing import Any, NamedTuple

from steerkit._support.errors import require
from steerkit._support.files import atomic_write
from steerkit.car import protocol
from steerkit.car.config.config import CarConfig
from steerkit.car.config.reading import Reading
from steerkit.car.core import Core, End, Event, Frame, Link, Note, Output, Packet, Send, Taping, Tick
from steerkit.car.recording_file import Contents, Gap, RecordingFile, contents, gaps_in, in_use, what_is_wrong
from steerkit.paths.path import Path

FLUSH = 0.2
"""Longest time that a message waits for the operating system [s]."""
SYNC = 0.5
"""Longest time that the operating system's part waits for the disk, if that takes no time [s]."""
STALL = 5.0
"""From when on a disk that does not answer is told of [s]."""
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
        self._tape = RecordingFile(self.file, {**description, "protocol": str(protocol.VERSION), **_versions()})
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
            case Taping():
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
        """Write what is left and the file's end; `failed` tells when that does not succeed within `timeout` [s]."""
        self._queue.put(None)
        self._thread.join(timeout)
        if self._thread.is_alive():
            self._broken = self._broken or f"{self.file}: its end could not be written within {timeout:g} s"

    def _run(self) -> None:
        try:
            self._write()
        except OSError as error:
            self._broken = f"{self.file}: {error}"
            self._tape.abandon()
        except BaseException as error:  # whatever ends it, the car server has to know, and to go on without it
            self._broken = f"{self.file}: {type(error).__name__}: {error}"
            with suppress(OSError):
                self._tape.close()

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
                self._tape.sync()
                flushed = synced = time.monotonic()
            elif now - flushed > FLUSH:
                self._tape.flush()
                flushed = now
        self._tape.close()

    def _add(self, topic: str, values: dict[str, Any]) -> None:
        data = json.dumps({k: _plain(v) for k, v in values.items()}, separators=(",", ":")).encode()
        if self._begun is None:
            self._begun = values["t"]
        self._tape.add(topic, self._epoch + round((values["t"] - self._begun) * 1e9), data)


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
                    yield Taping(v["t"], v["wrong"])
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
        raise ValueError(what_is_wrong(data))
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
    if "driver" in data:  # the name of the table before it was called after the car server
        data["server"] = data.pop("driver")
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
        tape = RecordingFile(draft, {**recorded.metadata, "repaired": json.dumps(recorded.lost)})
        stack.callback(tape.abandon)
        for chunk in parts.chunks:
            for line in chunk.lines:
                tape.add(line.topic, line.when, line.data, line.number)
            tape.flush()
        tape.close()
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
