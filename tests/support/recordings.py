"""A short recording of an engaged drive, in chunks of a few messages whatever the clock said."""

import contextlib
import resource
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from steerkit.car import recording as recordings
from steerkit.car.core import RecordingFault
from steerkit.car.protocol import VERSION
from steerkit.car.recording import Recorded, RecordingFile, parse
from steerkit.car.state_machine import Mode
from tests.support.car_world import CONFIG, World

LINES = 24
"""Messages of a chunk."""


@cache
def small() -> bytes:
    """The file: READY, engaged, the recording "stops" for a moment, the human brakes, the process ends."""
    with TemporaryDirectory() as folder:
        recorder = recordings.Recording(Path(folder) / "raw.mcap", recordings.described(CONFIG))
        world = World(recorder=recorder).bring_to(Mode.ENGAGED)
        world.handle(RecordingFault(world.t, "a slow disk"))
        world.handle(RecordingFault(world.t, ""))
        world.until(world.t + 0.1)
        recorder.close()
        assert not recorder.failed
        return chunked(recordings.read(recorder.file), Path(folder) / "small.mcap").read_bytes()


@cache
def brief() -> bytes:
    """The first 100 messages, with a shorter description: for what is read a thousand times."""
    with TemporaryDirectory() as folder:
        found = parse(small())
        text = {"file:config.toml": found.metadata["file:config.toml"][:2000], "protocol": str(VERSION)}
        return chunked(found, Path(folder) / "brief.mcap", text, 100).read_bytes()


def chunked(found: Recorded, file: Path, description: dict[str, str] | None = None, count: int | None = None) -> Path:
    """The same messages in a new file, LINES to a chunk."""
    recorder = RecordingFile(file, found.metadata if description is None else description, found.messages[0].when)
    for k, message in enumerate(found.messages[:count], 1):
        recorder.add(message.topic, message.when, message.data)
        if k % LINES == 0:
            recorder.flush()
    recorder.close()
    return file


class Chunk(NamedTuple):
    """An intact chunk: where it begins and ends, and its messages."""

    begin: int
    end: int
    messages: list[recordings.Message]

    def __repr__(self) -> str:
        return f"{[message[2:] for message in self.messages]}"


def chunks_of(data: bytes) -> list[Chunk]:
    """The intact chunks of a file's messages, in order."""
    pieces = (Chunk(*piece) for piece in recordings._pieces(data))
    return [piece for piece in pieces if piece.messages and piece.messages[0].topic != recordings.DESCRIPTION]


def flipped(data: bytes, bit: int) -> bytes:
    """The bytes with one bit turned over."""
    copy = bytearray(data)
    copy[bit // 8] ^= 1 << bit % 8
    return bytes(copy)


def until(true: Callable[[], Any]) -> None:
    """Wait for another thread."""
    end = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def same(a: list[recordings.Message], b: list[recordings.Message]) -> bool:
    """Are the messages equal, NaN to NaN?"""
    return list(map(repr, a)) == list(map(repr, b))


@contextlib.contextmanager
def full_disk(size: int) -> Iterator[None]:
    """No file of this process may grow beyond that size: writing there fails, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
