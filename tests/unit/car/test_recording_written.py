"""A recording while it is written: in use, on a full or slow disk, without an end."""

from __future__ import annotations

import fcntl
import os
import threading
import time
from pathlib import Path

import pytest

from steerkit.car import recording as recording_file
from steerkit.car import recording as recordings
from steerkit.car.core import Note, Tick
from tests.support.recordings import LINES, flipped, full_disk, small, until


def test_a_recording_in_use_is_looked_into_but_not_repaired(tmp_path: Path) -> None:
    file = tmp_path / "t.mcap"
    tape = recordings.Recording(file, {"a": "b"})
    tape.event(Tick(1.0), [])
    until(lambda: recordings.read(file).messages)
    recorded = recordings.read(file)
    assert recorded.in_use
    assert recorded.gaps == []
    assert not recorded.whole
    with pytest.raises(ValueError, match="is being written by a car server; repair it when that has ended"):
        recordings.repair(file)
    assert [f.name for f in tmp_path.iterdir()] == ["t.mcap"]
    tape.close()
    assert recordings.read(file).whole


def test_damage_in_a_recording_in_use_is_told_but_not_its_end_that_is_yet_to_come(drive: Path) -> None:
    chunks = recording_file.contents(small()).chunks
    drive.write_bytes(flipped(small(), 8 * (chunks[1].begin + 200))[: chunks[4].end])
    with drive.open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        (gap,) = recordings.read(drive).gaps
    assert gap.missing == LINES
    assert len(recordings.read(drive).gaps) == 2
    drive.write_bytes(flipped(small(), 8 * (chunks[-1].begin + 200)))  # with its end, and damage just before that
    with drive.open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        assert len(recordings.read(drive).gaps) == 1


def test_the_operating_system_has_it_before_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "SYNC", 1e6)
    tape = recordings.Recording(tmp_path / "t.mcap", {})
    tape.event(Tick(1.0), [])
    until(lambda: recordings.read(tmp_path / "t.mcap").messages)
    tape.close()


def test_an_event_and_what_came_of_it_reach_the_operating_system_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that a recording that ends with a kill replays exactly, to its last frame."""
    monkeypatch.setattr(recordings, "FLUSH", 0.0)
    tape = recordings.Recording(tmp_path / "t.mcap", {})
    for k in range(50):
        tape.event(Tick(float(k)), [Note("state", {"t": float(k)}), Note("command", {"t": float(k)})])
    until(lambda: tape._queue.empty())
    tape.close()
    chunks = recording_file.contents((tmp_path / "t.mcap").read_bytes()).chunks
    assert len(chunks) > 10
    assert {len(chunk.lines) % 3 for chunk in chunks} == {0}


def test_what_was_recorded_reaches_the_disk_without_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda number: synced.append(os.fstat(number).st_size))
    file = tmp_path / "t.mcap"
    tape = recordings.Recording(file, {})
    begin = synced[-1]
    tape.event(Tick(1.0), [])
    until(lambda: synced[-1] > begin)
    assert file.read_bytes().endswith(b'{"t":1.0}')
    tape.event(Tick(2.0), [])
    size = synced[-1]
    until(lambda: synced[-1] > size)
    assert len(recordings.read(file).messages) == 2
    tape.close()
    assert synced[-1] == file.stat().st_size
    assert recordings.FLUSH < recordings.SYNC < 1.0


def test_a_full_disk_is_told_and_what_was_there_stays_readable(tmp_path: Path) -> None:
    tape = recordings.Recording(tmp_path / "t.mcap", {"x": "y" * 1000})
    assert tape.failed == ""
    with full_disk(12_000):
        k = 0
        while not tape.failed:
            k += 1
            tape.event(Tick(0.01 * k), [])
            time.sleep(0.001)
        tape.event(Tick(0.01 * k), [])
        tape.close()
    assert "t.mcap: [Errno 27] File too large" in tape.failed
    assert tape._queue.qsize() < k
    recorded = recordings.read(tmp_path / "t.mcap")
    assert recorded.lost
    assert [m.values["t"] for m in recorded.messages] == [0.01 * n for n in range(1, len(recorded.messages) + 1)]


def test_a_recording_that_cannot_even_begin_raises(tmp_path: Path) -> None:
    with full_disk(100), pytest.raises(OSError, match="too large"):
        recordings.Recording(tmp_path / "t.mcap", {"x": "y"})
    with pytest.raises(FileExistsError):
        recordings.Recording(tmp_path / "t.mcap", {})


def test_a_thread_that_dies_of_anything_else_is_told_too(tmp_path: Path) -> None:
    tape = recordings.Recording(tmp_path / "t.mcap", {})
    tape.event(Tick(1.0), [Note("state", {"t": 1.0, "cause": object()})])
    until(lambda: tape.failed)
    assert "t.mcap: TypeError: Object of type object is not JSON serializable" in tape.failed
    tape.event(Tick(2.0), [])
    assert tape._queue.empty()
    tape.close()
    assert [m.values["t"] for m in recordings.read(tmp_path / "t.mcap").messages] == [1.0]


def test_a_disk_that_does_not_answer_holds_up_nobody_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tape = recordings.Recording(tmp_path / "t.mcap", {})
    answers, waiting = threading.Event(), threading.Event()

    def stuck(number: int) -> None:
        waiting.set()
        answers.wait(60.0)

    monkeypatch.setattr(os, "fsync", stuck)
    tape.event(Tick(0.0), [])
    assert waiting.wait(60.0)
    assert tape.failed == ""
    monkeypatch.setattr(recordings, "STALL", 0.0)
    assert "the disk has not answered for more than 0 s" in tape.failed
    for k in range(1000):
        tape.event(Tick(1.0 + k), [])
    monkeypatch.setattr(recordings, "STALL", 60.0)
    assert tape.failed == ""
    tape.close(timeout=0.0)
    assert "its end could not be written within 0 s" in tape.failed
    answers.set()
    tape._thread.join(60.0)
    assert len(recordings.read(tmp_path / "t.mcap").messages) == 1001


def test_a_recording_ends_before_the_memory_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tape = recordings.Recording(tmp_path / "t.mcap", {})
    monkeypatch.setattr(recordings, "BACKLOG", 50)
    answers = threading.Event()
    monkeypatch.setattr(os, "fsync", lambda number: answers.wait(60.0))
    until(lambda: tape.event(Tick(0.0), []) or tape.failed)
    assert "the disk does not keep up; 50 events wait for it" in tape.failed
    waiting = tape._queue.qsize()
    tape.event(Tick(0.0), [])
    assert tape._queue.qsize() == waiting
    answers.set()
    tape.close()
