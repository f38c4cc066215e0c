"""A short recording of an engaged drive, in chunks of a few messages whatever the clock said."""

from __future__ import annotations

import contextlib
import resource
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from steerkit.car import recording as recordings
from steerkit.car.core import RecordingFault
from steerkit.car.protocol import VERSION
from steerkit.car.recording import Contents, RecordingFile, contents
from steerkit.car.state_machine import Mode
from tests.support.car_world import World, setup

LINES = 24
"""Messages of a chunk."""


@cache
def small() -> bytes:
    """The file: READY, engaged, the recording "stops" for a moment, the human brakes, the process ends."""
    with TemporaryDirectory() as folder:
        recorder = recordings.Recording(Path(folder) / "raw.mcap", recordings.described(*setup()))
        world = World(recorder=recorder)
        world.bring_to(Mode.ENGAGED)
        world.handle(RecordingFault(world.t, "a slow disk"))
        world.handle(RecordingFault(world.t, ""))
        world.until(world.t + 0.1)
        recorder.close()
        assert not recorder.failed
        return chunked(contents((Path(folder) / "raw.mcap").read_bytes()), Path(folder) / "small.mcap").read_bytes()


@cache
def brief() -> bytes:
    """The first 100 messages, with a shorter description: for what is read a thousand times."""
    with TemporaryDirectory() as folder:
        found = contents(small())
        assert found.description is not None
        text = {"file:config.toml": found.description["file:config.toml"][:2000], "protocol": str(VERSION)}
        return chunked(found, Path(folder) / "brief.mcap", text, 100).read_bytes()


def chunked(found: Contents, file: Path, description: dict[str, str] | None = None, count: int | None = None) -> Path:
    """The same messages in a new file, LINES to a chunk."""
    recorder = RecordingFile(file, found.description or {} if description is None else description)
    lines = [line for chunk in found.chunks for line in chunk.lines][:count]
    for k, line in enumerate(lines, 1):
        recorder.add(line.topic, line.when, line.data)
        if k % LINES == 0:
            recorder.flush()
    recorder.close()
    return file


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
