"""A recording's file: every message counts, damage stays where it is, and no bytes raise anything but a ValueError."""

import io
import json
import random
import struct
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from steerkit.car import recording as recordings
from tests.support.recordings import LINES, brief, chunks_of, flipped, small

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


def test_what_was_flushed_is_read_by_other_programs_from_a_file_without_end(tmp_path: Path) -> None:
    recorder = recordings.RecordingFile(tmp_path / "t.mcap", {"a": "b"}, 4)
    recorder.add("/tick", 5, b'{"t":1.0}')
    recorder.flush()
    recorder.add("/tick", 6, b'{"t":2.0}')
    data, records = (tmp_path / "t.mcap").read_bytes(), list[Any]()
    with pytest.raises(EndOfFile):
        records.extend(StreamReader(io.BytesIO(data), validate_crcs=True).records)
    assert [(record.log_time, record.data) for record in records if isinstance(record, Message)] == [
        *[(4, b'{"t": 0.0, "texts": {"a": "b"}}')] * 2,
        (5, b'{"t":1.0}'),
    ]
    recorder.abandon()


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


@settings(max_examples=80)
@given(st.binary(max_size=200), st.integers(0, 30), st.booleans())
def test_noise_is_no_recording(noise: bytes, head: int, tail: bool) -> None:
    with pytest.raises(ValueError, match=r"no recording of steerkit|an MCAP file of another"):
        recordings.parse(small()[:head] + noise + (small()[-60:] if tail else b""))


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
