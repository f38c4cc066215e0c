"""Recordings of a drive: written, read, cut, damaged, replayed bit for bit.

Every message of a file counts, damage stays where it is, and no bytes raise anything but a ValueError.
"""

import io
import json
import math
import os
import random
import shutil
import struct
import threading
import time
import tracemalloc
import zlib
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from steerkit.car import protocol
from steerkit.car import recording as recordings
from steerkit.car.config import load, shipped
from steerkit.car.core import Core, End, Frame, Link, Note, Packet, RecordingFault, Send, Tick
from steerkit.car.state_machine import Mode
from steerkit.vehicles import vehicle, vehicle_text
from tests.support.car_world import CONFIG, World
from tests.support.recordings import LINES, brief, chunked, chunks_of, flipped, full_disk, small, until

# ---- what is read ------------------------------------------------------------------------------------------


def test_a_recording_of_a_drive_replays_bit_for_bit(drive: Path) -> None:
    recorded = recordings.read(drive)
    assert recorded.whole
    frames, equal = recordings.replayed_exactly(recorded, Core(recordings.config_of(recorded)))
    assert frames == equal > 10
    assert {type(event) for event in recorded.events()} == {Frame, Packet, Link, Tick, RecordingFault}
    count, size = len(recorded.messages), len(small())
    assert recorded.kept() == f"{count} of {count} messages, {size} of {size} bytes, 0.65 of 0.65 seconds"


def test_every_kind_of_event_comes_back_as_it_was(tmp_path: Path) -> None:
    events = [
        Frame(1.5, 1.25, 0x65, b"\x01\xff", "fd"),
        Frame(1.5, 1.5, 0x1ABCDEF0, b"", "x"),
        Frame(1.5, 1.5, 7, b"\0"),
        Packet(1.6, 3, b"Q"),
        Link(1.7, 3, True),
        Link(1.8, 3, False),
        RecordingFault(1.9, "full"),
        Tick(0.1 + 0.2),
        End(2.0, "stopped"),
    ]
    recorder = recordings.Recording(tmp_path / "t.mcap", {})
    for event in events:
        recorder.event(event, [Send(5, b"\x10"), Note("state", {"t": 1.0, "from": "A", "to": "B", "cause": "c"})])
    recorder.close()
    recorded = recordings.read(tmp_path / "t.mcap")
    assert list(recorded.events()) == events
    assert recorded.of("/can/tx")[0] == {"t": 1.5, "frame_id": 5, "data": "10"}
    assert len(recorded.of("/state")) == len(events)


def test_numbers_of_a_recording_come_back_bit_for_bit(tmp_path: Path) -> None:
    recorder = recordings.Recording(tmp_path / "t.mcap", {"a": "b"})
    odd = [0.1, 1 / 3, 5e-324, -0.0, math.inf, -math.inf, 1.7976931348623157e308]
    for value in odd:
        recorder.event(Tick(1.0), [Note("command", {"t": 1.0, "request": value, "sent": math.nan, "why": "inf"})])
    recorder.close()
    read = recordings.read(tmp_path / "t.mcap").of("/command")
    assert [struct.pack("<d", v["request"]) for v in read] == [struct.pack("<d", value) for value in odd]
    assert all(math.isnan(v["sent"]) for v in read)
    for message in recordings.read(tmp_path / "t.mcap").messages:  # JSON as other tools read it, too
        json.loads(message.data, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_a_replay_that_sends_more_or_fewer_frames_is_not_exact(drive: Path) -> None:
    recorded = recordings.read(drive)
    (*_, last) = (k for k, message in enumerate(recorded.messages) if message.topic == "/can/tx")
    for messages in (
        recorded.messages[:last] + recorded.messages[last + 1 :],
        [*recorded.messages, recorded.messages[last]],
    ):
        frames, equal = recordings.replayed_exactly(recorded._replace(messages=messages), Core(CONFIG))
        assert equal == frames - 1


@pytest.mark.parametrize(("keep", "mode"), [(False, Mode.ENGAGED), (True, Mode.FAULT)])
def test_a_recording_that_stops_ends_the_drive_if_it_has_to_be_kept(keep: bool, mode: Mode, tmp_path: Path) -> None:
    recorder = recordings.Recording(tmp_path / "t.mcap", {})
    world = World(recorder=recorder)
    world.config = replace(world.config, keep_recording=keep)
    world.core.config = world.config
    world.bring_to(Mode.ENGAGED)
    world.handle(RecordingFault(world.t, "no space"))
    world.until(world.t + 0.1)
    assert world.mode is mode
    text = world.query().text
    assert "no space" in text
    assert ("not recorded" in text) is not keep
    world.handle(RecordingFault(world.t, ""))
    world.until(world.t + 0.1)
    assert keep or "no space" not in world.query().text
    recorder.close()
    frames, equal = recordings.replayed_exactly(recordings.read(tmp_path / "t.mcap"), Core(world.config))
    assert frames == equal > 5


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_text("hello")
    with pytest.raises(ValueError, match=r"x\.mcap: no recording of steerkit, or cut off before it began"):
        recordings.read(tmp_path / "x.mcap")
    with (tmp_path / "y.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="somebody")
        writer.finish()
    with pytest.raises(ValueError, match="an MCAP file of another program"):
        recordings.read(tmp_path / "y.mcap")


def test_a_recording_of_a_later_protocol_is_refused_with_its_number_and_version(tmp_path: Path) -> None:
    chunked(recordings.parse(small()), tmp_path / "t.mcap", {"protocol": "9", "steerkit-control": "7.0"})
    with pytest.raises(ValueError, match=rf"of protocol 9, this is {protocol.VERSION}; .* that made it, 7\.0"):
        recordings.read(tmp_path / "t.mcap")


# ---- damage ------------------------------------------------------------------------------------------------


def places_to_cut() -> list[int]:
    ends, rng = [chunk.end for chunk in chunks_of(small())], random.Random(1)
    borders = [end + k for end in (*ends, ends[-1] + 13) for k in (-1, 0, 1)]  # 13 bytes end the data
    some = (rng.randrange(len(small())) for _ in range(100))
    return sorted({*range(100), *borders, *some, len(small()) - 1})


def test_a_recording_cut_anywhere_opens_with_all_chunks_that_came_before(tmp_path: Path) -> None:
    chunks, every = chunks_of(small()), list(map(repr, recordings.parse(small()).messages))
    ended = 0
    for length in places_to_cut():
        (tmp_path / "cut.mcap").write_bytes(small()[:length])
        try:
            cut = recordings.read(tmp_path / "cut.mcap")
        except ValueError:
            assert length < chunks[0].begin
            continue
        there = sum(len(chunk.messages) for chunk in chunks if chunk.end <= length)
        assert list(map(repr, cut.messages)) == every[:there]
        assert not cut.whole
        (gap,) = cut.gaps
        assert gap.end == length
        assert gap.before is None
        behind = length >= chunks[-1].end + 13
        assert gap.missing == (0 if behind else None)  # how many came behind a cut, nothing tells
        assert bool(cut.lost) is not behind
        ended += behind
    assert ended > 3


def test_what_is_missing_is_told_in_messages_bytes_and_seconds(drive: Path) -> None:
    chunks = chunks_of(small())
    drive.write_bytes(flipped(small(), 8 * (chunks[3].begin + 200)))
    recorded = recordings.read(drive)
    count, size, gone = len(recorded.messages), len(small()), chunks[3].end - chunks[3].begin
    before, after = chunks[2].messages[-1].values["t"], chunks[4].messages[0].values["t"]
    assert recorded.kept() == (
        f"{count} of {count + LINES} messages, {size - gone} of {size} bytes, "
        f"{0.65 - (after - before):.2f} of 0.65 seconds"
    )
    where = f"bytes {chunks[3].begin} to {chunks[3].end}"
    told = f"{where}: {LINES} messages are missing between {before:.3f} s and {after:.3f} s"
    assert recorded.lost == [told]
    drive.write_bytes(small()[: chunks[4].end])
    cut = recordings.read(drive)
    assert " and an unknown number messages, " in cut.kept()
    assert "or more seconds" in cut.kept()
    assert cut.lost == [
        f"at byte {chunks[4].end}: an unknown number of messages is missing "
        f"between {chunks[4].messages[-1].values['t']:.3f} s and the end"
    ]
    drive.write_bytes(flipped(small(), 8 * 100))
    assert recordings.read(drive).lost == []
    assert str(recordings.read(drive).gaps[0]).endswith(": no message is missing")


# ---- what a replay needs -----------------------------------------------------------------------------------


def own_files(folder: Path) -> Path:
    """A configuration whose DBCs, course and vehicle are files of its own, in folders of their own."""
    for name in ("can", "places", "cars"):
        (folder / name).mkdir(parents=True)
    text = shipped("dbw-kit.toml").read_text()
    for name in ("dbw_steering.dbc", "pose.dbc"):
        raw = shipped(name).read_bytes() + 'CM_ "f\xfcr Stra\xdfen";\n'.encode("cp1252")
        (folder / "can" / name).with_suffix(".DBC").write_bytes(raw)
        text = text.replace(f'"{name}"', f'"can/{Path(name).stem}.DBC"', 1)
    text = text.replace('name = "paper"', 'file = "places/same.csv"\nclosed = true')
    text = text.replace('name = "vw-passat"', 'name = "cars/own.toml"')
    points = [(60 * math.cos(k / 20 * math.pi), 50 * math.sin(k / 20 * math.pi)) for k in range(40)]
    (folder / "places/same.csv").write_text("x,y\n" + "".join(f"{x},{y}\n" for x, y in points))
    (folder / "cars/own.toml").write_text(vehicle_text(replace(vehicle("vw-passat"), m=1234.5)))
    (folder / "car.toml").write_text(text)
    return folder / "car.toml"


def test_a_replay_depends_on_no_file_but_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load(own_files(tmp_path / "here"))
    recordings.Recording(tmp_path / "t.mcap", recordings.described(config, 2.5)).close()
    for file in (tmp_path / "here").rglob("*.*"):
        file.write_text("gone")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    recorded = recordings.read(tmp_path / "t.mcap")
    again = recordings.config_of(recorded)
    assert asdict(again.vehicle) == asdict(config.vehicle)
    assert sorted(text for name, text in again.texts.items() if name.endswith(".DBC")) == sorted(
        text for name, text in config.texts.items() if name.endswith(".DBC")
    )
    assert protocol.digest(again.course) == protocol.digest(config.course)
    assert [reader.frame_id for reader in again.readers] == [reader.frame_id for reader in config.readers]
    assert again.gate == config.gate
    assert recorded.metadata["time_scale"] == "2.5"
    assert recorded.metadata["protocol"] == str(protocol.VERSION)
    assert {"python", "numpy", "steerkit-control", "cantools"} <= recorded.metadata.keys()
    assert recordings.differences(recorded, again) == []


@pytest.mark.parametrize("name", ["can/pose.DBC", "places/same.csv", "cars/own.toml"])
def test_a_recording_that_lacks_a_file_says_which(tmp_path: Path, name: str) -> None:
    config = load(own_files(tmp_path / "here"))
    description = recordings.described(config)
    del description[f"file:{name}"]
    recordings.Recording(tmp_path / "t.mcap", description).close()
    with pytest.raises(ValueError, match=f"the recording: .*{name} is not in it: no replay"):
        recordings.config_of(recordings.read(tmp_path / "t.mcap"))


def test_a_recording_without_description_says_that_there_is_no_replay(tmp_path: Path) -> None:
    first = chunks_of(small())[0].begin
    (tmp_path / "t.mcap").write_bytes(small()[:8] + bytes(first - 8) + small()[first:])
    recorded = recordings.read(tmp_path / "t.mcap")
    assert len(recorded.messages) == len(recordings.parse(small()).messages)
    with pytest.raises(ValueError, match="its description is damaged or has no configuration"):
        recordings.config_of(recorded)


def test_what_is_different_from_then_is_told(drive: Path) -> None:
    recorded = recordings.read(drive)
    assert recordings.differences(recorded, CONFIG) == []
    then = recorded._replace(metadata={**recorded.metadata, "numpy": "0.1", "course": "00", "vehicle": "{}"})
    told = recordings.differences(then, CONFIG)
    assert any(text.startswith("numpy 0.1, now ") for text in told)
    assert {"the course of that name is another one", "the vehicle of that name is another one"} < set(told)


def test_an_event_and_what_came_of_it_reach_the_operating_system_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that a recording that ends with a kill replays exactly, to its last frame."""
    monkeypatch.setattr(recordings, "FLUSH", 0.0)
    recorder = recordings.Recording(tmp_path / "t.mcap", {})
    for k in range(50):
        recorder.event(Tick(float(k)), [Note("state", {"t": float(k)}), Note("command", {"t": float(k)})])
    until(lambda: recorder._queue.empty())
    recorder.close()
    chunks = chunks_of((tmp_path / "t.mcap").read_bytes())
    assert len(chunks) > 10
    assert {len(chunk.messages) % 3 for chunk in chunks} == {0}


def test_what_was_recorded_reaches_the_disk_without_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda number: synced.append(os.fstat(number).st_size))
    file = tmp_path / "t.mcap"
    recorder = recordings.Recording(file, {})
    begin = synced[-1]
    recorder.event(Tick(1.0), [])
    until(lambda: synced[-1] > begin)
    assert file.read_bytes().endswith(b'{"t":1.0}')
    size = synced[-1]
    recorder.event(Tick(2.0), [])
    until(lambda: synced[-1] > size)
    assert len(recordings.read(file).messages) == 2
    recorder.close()
    assert synced[-1] == file.stat().st_size
    assert recordings.FLUSH < recordings.SYNC < 1.0


def test_a_full_disk_is_told_and_what_was_there_stays_readable(tmp_path: Path) -> None:
    recorder = recordings.Recording(tmp_path / "t.mcap", {"x": "y" * 1000})
    assert recorder.failed == ""
    with full_disk(12_000):
        k = 0
        while not recorder.failed:
            k += 1
            recorder.event(Tick(0.01 * k), [])
            time.sleep(0.001)
        recorder.event(Tick(0.01 * k), [])
        recorder.close()
    assert "t.mcap: [Errno 27] File too large" in recorder.failed
    assert recorder._queue.qsize() < k
    recorded = recordings.read(tmp_path / "t.mcap")
    assert recorded.lost
    assert [m.values["t"] for m in recorded.messages] == [0.01 * n for n in range(1, len(recorded.messages) + 1)]


@pytest.mark.parametrize("at_its_end", [False, True])
def test_a_recording_that_is_deleted_while_it_is_written_is_told(tmp_path: Path, at_its_end: bool) -> None:
    (tmp_path / "runs").mkdir()
    recorder = recordings.Recording(tmp_path / "runs" / "t.mcap", {})
    shutil.rmtree(tmp_path / "runs")
    if not at_its_end:
        until(lambda: recorder.failed)
    recorder.close()
    assert recorder.failed.endswith("t.mcap: [Errno 2] it was deleted while it was written")


def test_a_recording_that_cannot_even_begin_raises(tmp_path: Path) -> None:
    with full_disk(100), pytest.raises(OSError, match="too large"):
        recordings.Recording(tmp_path / "t.mcap", {"x": "y"})
    with pytest.raises(FileExistsError):
        recordings.Recording(tmp_path / "t.mcap", {})


def test_a_thread_that_dies_of_anything_else_is_told_too(tmp_path: Path) -> None:
    recorder = recordings.Recording(tmp_path / "t.mcap", {})
    recorder.event(Tick(1.0), [Note("state", {"t": 1.0, "cause": object()})])
    until(lambda: recorder.failed)
    assert "t.mcap: TypeError: Object of type object is not JSON serializable" in recorder.failed
    recorder.event(Tick(2.0), [])
    assert recorder._queue.empty()
    recorder.close()
    assert [m.values["t"] for m in recordings.read(tmp_path / "t.mcap").messages] == [1.0]


def test_a_disk_that_does_not_answer_holds_up_nobody_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = recordings.Recording(tmp_path / "t.mcap", {})
    answers, waiting = threading.Event(), threading.Event()

    def stuck(number: int) -> None:
        waiting.set()
        answers.wait(60.0)

    monkeypatch.setattr(os, "fsync", stuck)
    recorder.event(Tick(0.0), [])
    assert waiting.wait(60.0)
    assert recorder.failed == ""
    monkeypatch.setattr(recordings, "STALL", 0.0)
    assert "the disk has not answered for more than 0 s" in recorder.failed
    for k in range(1000):
        recorder.event(Tick(1.0 + k), [])
    monkeypatch.setattr(recordings, "STALL", 60.0)
    assert recorder.failed == ""
    recorder.close(timeout=0.0)
    assert "its end could not be written within 0 s" in recorder.failed
    answers.set()
    recorder._thread.join(60.0)
    assert len(recordings.read(tmp_path / "t.mcap").messages) == 1001


def test_a_recording_ends_before_the_memory_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = recordings.Recording(tmp_path / "t.mcap", {})
    monkeypatch.setattr(recordings, "BACKLOG", 50)
    answers = threading.Event()
    monkeypatch.setattr(os, "fsync", lambda number: answers.wait(60.0))
    until(lambda: recorder.event(Tick(0.0), []) or recorder.failed)
    assert "the disk does not keep up; 50 events wait for it" in recorder.failed
    waiting = recorder._queue.qsize()
    recorder.event(Tick(0.0), [])
    assert recorder._queue.qsize() == waiting
    answers.set()
    recorder.close()


# ---- the file --------------------------------------------------------------------------------------------------


HEADER = 8 + 9 + 12 + 12
"""Bytes of the magic and of the header's record."""


def test_other_programs_read_it_and_agree_with_its_sums() -> None:
    messages = recordings.parse(small()).messages
    assert [m.number for m in messages] == list(range(recordings.COPIES, len(messages) + recordings.COPIES))
    assert {len(chunk.messages) for chunk in chunks_of(small())[:-1]} == {LINES}
    reader = make_reader(io.BytesIO(small()), validate_crcs=True)
    told = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]
    assert [topic for topic, _, _ in told[:2]] == ["/description"] * 2
    assert told[2:] == [(m.topic, m.when, m.data) for m in messages]


def places_of_the_frame() -> list[int]:
    """Bits of the head, of chunks' heads but for their times, which nothing here reads, and of the end."""
    chunks = chunks_of(brief())
    places = [*range(HEADER), *range(chunks[-1].end, chunks[-1].end + 40), *range(len(brief()) - 150, len(brief()))]
    for chunk in chunks[:3]:
        places += [*range(chunk.begin, chunk.begin + 9), *range(chunk.begin + 25, chunk.begin + 49)]
    rng = random.Random(13)
    return [8 * place + rng.randrange(8) for place in places]


def test_flipped_bits_lose_no_more_than_their_chunk_and_are_told() -> None:
    rng, whole, chunks = random.Random(2), recordings.parse(brief()), chunks_of(brief())
    every = list(map(repr, whole.messages))
    times = {at for begin, _, _ in recordings._pieces(brief()) for at in range(begin + 9, begin + 25)}
    for bit in (*(rng.randrange(8 * len(brief())) for _ in range(200)), *places_of_the_frame()):
        place = bit // 8
        damaged = recordings.parse(flipped(brief(), bit))
        assert damaged.metadata == whole.metadata
        if place in times:
            continue
        (gap,) = damaged.gaps
        assert not damaged.whole
        assert gap.begin <= place < gap.end
        hit = next((k for k, chunk in enumerate(chunks) if chunk.begin <= place < chunk.end), None)
        lost = len(chunks[hit].messages) if hit is not None else 0
        assert len(damaged.messages) == len(every) - lost
        last = hit == len(chunks) - 1
        data_end = chunks[-1].end <= place < chunks[-1].end + 13
        assert gap.missing == (None if last or data_end else lost)
        n = LINES * (hit if hit is not None else 0)
        assert list(map(repr, damaged.messages)) == every[:n] + every[n + lost :]
        if lost:
            assert gap.after == (whole.messages[n - 1].values["t"] if n else None)
            assert gap.before == (None if last else whole.messages[n + lost].values["t"])


def test_a_stretch_that_was_damaged_went_missing_or_came_in_between_loses_no_chunk_beyond_it() -> None:
    data, rng = small(), random.Random(5)
    whole, metadata = {repr(chunk): chunk for chunk in chunks_of(data)}, recordings.parse(data).metadata
    for fill in (b"\0", b"\xff", b"\x06", b""):
        for _ in range(40):
            begin = rng.randrange(len(data))
            end = min(len(data), begin + int(10 ** rng.uniform(0, 4)))
            left = set(map(repr, chunks_of(data[:begin] + fill * (end - begin) + data[end:])))
            assert left >= {key for key, c in whole.items() if c.end <= begin or c.begin >= end}
            assert left <= whole.keys()
    for _ in range(60):
        place = rng.randrange(len(data))
        found = recordings.parse(data[:place] + rng.randbytes(rng.randrange(1, 60)) + data[place:])
        assert not found.whole
        assert len(found.messages) >= len(recordings.parse(data).messages) - LINES
        assert found.metadata == metadata


def test_what_looks_like_a_beginning_hides_no_chunk_behind_it() -> None:
    place = chunks_of(small())[2].begin
    found = recordings.parse(small()[:place] + b"x\x06" + small()[place:])
    assert [(gap.begin, gap.end, gap.missing) for gap in found.gaps] == [(place, place + 2, 0)]
    assert repr(found.messages) == repr(recordings.parse(small()).messages)


def test_a_sum_of_zero_is_a_sum_like_any_other() -> None:
    """To MCAP it means that there is none."""
    begin = chunks_of(small())[2].begin
    data = bytearray(small())
    data[begin + 33 : begin + 37] = bytes(4)
    data[begin + 300] ^= 1
    assert begin not in [chunk.begin for chunk in chunks_of(bytes(data))]


def test_a_good_sum_of_what_is_none_of_ours_is_left_out() -> None:
    deep, long = b'{"t":' + b"[" * 5000, b'{"t":1' + b"0" * 400 + b"}"
    rx = {"t": 1.0, "arrived": 1.0, "frame_id": 101, "data": "00", "kind": ""}
    odd = [{"frame_id": 1.0}, {"frame_id": 1 << 63}, {"data": "0"}, {"data": 5}, {"arrived": ""}, {"kind": 0}, {"x": 0}]
    shapes = [json.dumps(rx | change).encode() for change in odd] + [b'{"t":1.0}']
    for text in (*shapes, b"[1]", b"nonsense", b'{"t":"x"}', b'{"t":"1.5"}', b'{"u":1}', b"\xff", deep, long):
        record = struct.pack("<BQHIQQ", 5, 22 + len(text), 1, 0, 1, 1) + text
        head = struct.pack("<BQQQQIIQ", 6, 40 + len(record), 1, 1, len(record), zlib.crc32(record), 0, len(record))
        with pytest.raises(ValueError, match="no recording of steerkit"):
            recordings.parse(small()[:HEADER] + head + record)


def test_lengths_that_lie_cost_neither_memory_nor_a_second_look_at_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    """Heads of chunks whose lengths point beyond the file, or to its end, again and again."""
    beyond = struct.pack("<BQQQQIIQ", 6, 2**31, 0, 0, 2**31 - 40, 1, 0, 2**31 - 40)
    data = small()[:HEADER] + beyond * 8000
    sums, real = [0], zlib.crc32

    def counted(data: bytes, *more: int) -> int:
        sums[0] += len(data)
        return real(data, *more)

    monkeypatch.setattr(recordings.zlib, "crc32", counted)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="no recording of steerkit"):
            recordings.parse(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert sums[0] < 2 * len(data)
    assert peak < len(data)


def test_a_long_message_closes_its_chunk(tmp_path: Path) -> None:
    recorder = recordings.RecordingFile(tmp_path / "t.mcap", {}, 1)
    for k in range(3):
        recorder.add("/state", k, json.dumps({"t": k, "x": "x" * recordings.CHUNK}).encode())
    recorder.close()
    assert [len(chunk.messages) for chunk in chunks_of((tmp_path / "t.mcap").read_bytes())] == [1, 1, 1]


def test_the_numbers_of_topics_are_for_good() -> None:
    """They tell the topics of a file whose first chunk is lost: only ever add at the end."""
    assert " ".join(recordings.TOPICS) == (
        "/can/rx /client /link /tick /recording /end /can/tx /state /command /steers /car /refused /estimates /safety "
        "/adapted /description /port"
    )
