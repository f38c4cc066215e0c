"""Recordings of a drive: cut anywhere, mended or left as they are, bit for bit, of another kind."""

from __future__ import annotations

import errno
import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from steerkit.courses import course
from steerkit.plants.real_car import recording as tapes
from steerkit.plants.real_car.decisions.core import Core, Frame, Link, Note, Packet, Tick
from steerkit.plants.real_car.decisions.modes import Mode, Order
from tests.support.car_messages import config
from tests.support.car_world import World, setup


def written(folder: Path) -> bytes:
    tape = tapes.Recording(folder / "tape.mcap", {"file:config.toml": "x"})
    core = Core(config(), course("paper"))
    for k in range(5):
        for event in (Frame(0.01 * k, 0.01 * k, 0x65, bytes(8)), Tick(0.01 * k), Link(0.01 * k, k, True)):
            tape.event(event, core.handle(event))
    tape.close()
    return (folder / "tape.mcap").read_bytes()


def test_a_recording_cut_anywhere_opens_with_all_that_came_before(tmp_path: Path) -> None:
    whole = written(tmp_path)
    every = tapes.read(tmp_path / "tape.mcap")
    assert every.whole
    assert len(every.messages) >= 15
    counts = []
    for length in range(0, len(whole), 7):
        (tmp_path / "cut.mcap").write_bytes(whole[:length])
        try:
            cut = tapes.read(tmp_path / "cut.mcap")
        except ValueError as error:
            assert "recording" in str(error)  # noqa: PT017
            assert not counts
            continue
        counts.append(len(cut.messages))
        assert [repr(m) for m in cut.messages] == [repr(m) for m in every.messages[: len(cut.messages)]]
    assert counts == sorted(counts)
    assert counts[-1] == len(every.messages)


def test_numbers_of_a_recording_come_back_bit_for_bit(tmp_path: Path) -> None:
    tape = tapes.Recording(tmp_path / "t.mcap", {"a": "b"})
    odd = [0.1, 1 / 3, 5e-324, -0.0, math.inf, -math.inf, 1.7976931348623157e308]
    for value in odd:
        tape._queue.put(("/command", {"t": 1.0, "request": value, "sent": math.nan, "why": ""}))
    tape.close()
    read = tapes.read(tmp_path / "t.mcap").of("/command")
    assert [struct.pack("<d", v["request"]) for v in read] == [struct.pack("<d", value) for value in odd]
    assert all(math.isnan(v["sent"]) for v in read)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_text("hello")
    with pytest.raises(ValueError, match="no recording of steerkit"):
        tapes.read(tmp_path / "x.mcap")


def cut_short(folder: Path) -> Path:
    tape = tapes.Recording(folder / "tape.mcap", {"a": "b"})
    for k in range(50):
        tape._queue.put(("/tick", {"t": 0.01 * k}))
    tape.close()
    whole = (folder / "tape.mcap").read_bytes()
    (folder / "tape.mcap").write_bytes(whole[: 3 * len(whole) // 4])
    return folder / "tape.mcap"


def test_a_recording_that_was_cut_short_gets_its_end(tmp_path: Path) -> None:
    file = cut_short(tmp_path)
    left = tapes.read(file)
    assert not left.whole
    assert [m.values for m in tapes.mend(file).messages] == [m.values for m in left.messages]
    assert tapes.read(file) == left._replace(whole=True)
    assert [f.name for f in tmp_path.iterdir()] == ["tape.mcap"]


def test_a_recording_that_cannot_be_mended_stays_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = cut_short(tmp_path)
    before = file.read_bytes()

    def full(self: tapes.Recording, topic: str, values: dict[str, Any]) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tapes.Recording, "_add", full)
    with pytest.raises(OSError, match=r"its copy could not be written: .*No space left"):
        tapes.mend(file)
    assert file.read_bytes() == before
    assert [f.name for f in tmp_path.iterdir()] == ["tape.mcap"]


def test_every_event_comes_back_as_it_was(tmp_path: Path) -> None:
    events = [
        Link(0.1, 3, True),
        Packet(0.2, 3, b"Q\x00\xff"),
        Frame(0.31, 0.3, 0x65, bytes(range(8))),  # looked at later than it arrived
        Tick(1 / 3),
        Link(0.4, 3, False),
    ]
    tape = tapes.Recording(tmp_path / "t.mcap", {"a": "b"})
    for event in events:
        tape.event(event, [])
    tape.close()
    assert list(tapes.read(tmp_path / "t.mcap").events()) == events


def test_numbers_that_json_does_not_know_are_texts(tmp_path: Path) -> None:
    tape = tapes.Recording(tmp_path / "t.mcap", {"a": "b"})
    odd = {"t": 1.0, "request": math.inf, "sent": -math.inf, "why": ""}
    tape.event(Tick(1.0), [Note("command", odd), Note("command", odd | {"request": math.nan})])
    tape.close()
    text = (tmp_path / "t.mcap").read_bytes()
    assert b"Infinity" not in text
    assert b":NaN" not in text
    first, second = tapes.read(tmp_path / "t.mcap").of("/command")
    assert (first["request"], first["sent"]) == (math.inf, -math.inf)
    assert math.isnan(second["request"])


def test_a_replay_that_sends_other_frames_or_more_or_fewer_is_not_exact(tmp_path: Path) -> None:
    world = World(tape=tapes.Recording(tmp_path / "t.mcap", {"a": "b"}))
    world.bring_to(Mode.ENGAGED)
    world.order(Order.DISENGAGE)
    world.until(world.t + 0.3)
    assert world.tape is not None
    world.tape.close()
    recorded = tapes.read(tmp_path / "t.mcap")
    frames, same = tapes.replayed_exactly(recorded, Core(*setup()))
    assert frames == same == len(world.sent)

    def without(topic: str, number: int) -> tapes.Recorded:
        places = [k for k, message in enumerate(recorded.messages) if message.topic == topic]
        return recorded._replace(messages=[m for k, m in enumerate(recorded.messages) if k != places[number]])

    for cut in (without("/can/tx", -1), without("/can/tx", 0)):  # the replay sends one more than was recorded
        before, agreeing = tapes.replayed_exactly(cut, Core(*setup()))
        assert before == frames - 1
        assert agreeing < before
    silent = replace(world.config, listen_only=True)
    assert tapes.replayed_exactly(recorded, Core(silent, world.path)) == (frames, 0)
