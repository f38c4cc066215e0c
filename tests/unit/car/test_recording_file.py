"""A recording's file: every byte counts, damage stays where it is, and whatever the bytes are, nothing is raised."""

from __future__ import annotations

import io
import json
import random
import re
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
from tests.support.recordings import LINES, brief, flipped, small

HEADER = 8 + 9 + 12 + 12
"""Bytes of the magic and of the header's record."""


def test_an_intact_file_has_nothing_wrong() -> None:
    found = recordings.contents(small())
    assert found.finished
    assert not found.damaged
    lines = [line for chunk in found.chunks for line in chunk.lines]
    assert [line.number for line in lines] == list(range(len(lines)))
    assert found.total == len(lines)
    assert {len(chunk.lines) for chunk in found.chunks[:-1]} == {LINES}
    assert len(found.chunks) > 5
    assert found.description is not None
    assert "file:config.toml" in found.description


def test_other_programs_read_it_and_agree_with_its_sums() -> None:
    lines = [line for chunk in recordings.contents(small()).chunks for line in chunk.lines]
    reader = make_reader(io.BytesIO(small()), validate_crcs=True)
    told = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]
    assert [topic for topic, _, _ in told[:2]] == ["/description"] * 2
    assert told[2:] == [(line.topic, line.when, line.data) for line in lines]
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        properties = json.loads(schema.data)["properties"]
        unknown = json.loads(message.data).keys() - properties.keys()
        assert not unknown or channel.topic in ("/car", "/description")  # a snapshot has many


def test_what_was_flushed_is_read_by_other_programs_from_a_file_without_end(tmp_path: Path) -> None:
    recorder = recordings.RecordingFile(tmp_path / "t.mcap", {"a": "b"})
    recorder.add("/tick", 5, b'{"t":1.0}')
    recorder.flush()
    recorder.add("/tick", 6, b'{"t":2.0}')
    records, stream = (
        list[Any](),
        StreamReader(io.BytesIO((tmp_path / "t.mcap").read_bytes()), validate_crcs=True).records,
    )
    with pytest.raises(EndOfFile):
        records.extend(stream)
    assert [record.data for record in records if isinstance(record, Message)] == [
        *[b'{"t": 0.0, "texts": {"a": "b"}}'] * 2,
        b'{"t":1.0}',
    ]
    recorder.abandon()


def read(chunk: recordings.Chunk, *, place: bool = True) -> tuple[object, ...]:
    """All of a chunk but the values, which follow from the data, and of which a NaN is not equal to itself."""
    return (chunk.begin, chunk.end) * place + tuple(line[:4] for line in chunk.lines)


def every_byte_of_the_frame() -> list[int]:
    """Bytes of head, chunk heads, the data section's end and the index's two ends: one bit of each is flipped."""
    found = recordings.contents(brief())
    places = [*range(40), *range(found.chunks[-1].end, found.chunks[-1].end + 40)]
    places += range(len(brief()) - 150, len(brief()))
    for chunk in found.chunks[:3]:
        places += range(chunk.begin, chunk.begin + 49)
    return places


def test_every_flipped_bit_is_noticed_where_it_is_and_only_its_chunk_is_left_out() -> None:
    data, rng = brief(), random.Random(13)
    whole = recordings.contents(data)
    bits = [rng.randrange(8 * len(data)) for _ in range(300)]
    bits += [8 * place + rng.randrange(8) for place in every_byte_of_the_frame()]
    dropped = 0
    for bit in bits:
        found, place = recordings.contents(flipped(data, bit)), bit // 8
        assert len(found.damaged) == 1, place
        begin, end = found.damaged[0]
        assert begin <= place < end
        assert found.description == whole.description
        kept = [chunk for chunk in whole.chunks if not chunk.begin <= place < chunk.end]
        if place - next((c.begin for c in whole.chunks if c.begin <= place < c.end), -999) in range(9, 25):
            kept = whole.chunks  # the times in a chunk's head, which its messages tell too
        assert [read(chunk) for chunk in found.chunks] == [read(chunk) for chunk in kept], place
        dropped += len(kept) < len(whole.chunks)
        assert found.finished
        assert found.total == (whole.total if place < whole.chunks[-1].end + 13 else None)
    assert dropped > 100


def test_a_damaged_stretch_of_any_size_loses_no_chunk_beyond_it() -> None:
    data, rng = small(), random.Random(5)
    whole = {read(chunk): chunk for chunk in recordings.contents(data).chunks}
    for fill in (b"\0", b"\xff", b"\x06"):
        for _ in range(40):
            begin = rng.randrange(len(data))
            end = min(len(data), begin + int(10 ** rng.uniform(0, 4)))
            found = recordings.contents(data[:begin] + fill * (end - begin) + data[end:])
            left = {read(chunk) for chunk in found.chunks}
            assert left >= {key for key, c in whole.items() if c.end <= begin or c.begin >= end}
            assert left <= whole.keys()


def test_bytes_that_went_missing_or_came_in_between_lose_one_chunk_at_most() -> None:
    data, rng = small(), random.Random(6)
    whole = recordings.contents(data)
    lines = [read(chunk, place=False) for chunk in whole.chunks]
    for _ in range(60):
        place, count = rng.randrange(len(data)), rng.randrange(1, 60)
        for changed in (data[:place] + data[place + count :], data[:place] + rng.randbytes(count) + data[place:]):
            found = recordings.contents(changed)
            assert found.damaged
            left = [read(chunk, place=False) for chunk in found.chunks]
            assert len(left) >= len(lines) - 2
            assert all(chunk in lines for chunk in left)
            assert found.description == whole.description


def test_what_looks_like_a_beginning_hides_no_chunk_behind_it() -> None:
    whole = recordings.contents(small())
    place = whole.chunks[2].begin
    found = recordings.contents(small()[:place] + b"x\x06" + small()[place:])
    assert found.damaged[0] == (place, place + 2)
    assert [read(c, place=False) for c in found.chunks] == [read(c, place=False) for c in whole.chunks]


def test_a_sum_of_zero_is_a_sum_like_any_other() -> None:
    """To MCAP it means that there is none."""
    chunk = recordings.contents(small()).chunks[2]
    data = bytearray(small())
    data[chunk.begin + 33 : chunk.begin + 37] = bytes(4)
    data[chunk.begin + 300] ^= 1
    assert chunk.begin not in [c.begin for c in recordings.contents(bytes(data)).chunks]


@pytest.mark.parametrize("copy", [0, 1])
def test_one_of_the_two_copies_of_the_description_is_enough(copy: int) -> None:
    data = small()
    starts = [m.start() for m in re.finditer(rb'{"t": 0.0, "texts": ', data)]
    assert len(starts) == 2
    middle = starts[copy] + 200
    found = recordings.contents(data[:middle] + bytes(300) + data[middle + 300 :])
    assert found.description == recordings.contents(data).description
    assert len(found.damaged) == 1


def test_without_both_copies_the_messages_are_still_read() -> None:
    data = small()
    first = recordings.contents(data).chunks[0].begin
    found = recordings.contents(data[:8] + bytes(first - 8) + data[first:])
    assert found.description is None
    assert repr(found.chunks) == repr(recordings.contents(data).chunks)


def test_topics_are_known_without_the_first_chunk_that_tells_them() -> None:
    whole = recordings.contents(small())
    begin, end = whole.chunks[0].begin, whole.chunks[0].end
    found = recordings.contents(small()[:begin] + small()[end:])
    assert [line.topic for line in found.chunks[0].lines] == [line.topic for line in whole.chunks[1].lines]


@settings(max_examples=200)
@given(st.binary(max_size=200), st.integers(0, 30), st.booleans())
def test_noise_raises_nothing(noise: bytes, head: int, tail: bool) -> None:
    data = small()[:head] + noise + (small()[-60:] if tail else b"")
    found = recordings.contents(data)
    assert not found.chunks
    assert found.description is None


def test_a_good_sum_of_what_is_none_of_ours_is_left_out() -> None:
    for text in (b"[1]", b"nonsense", b'{"t":"x"}', b'{"u":1}', b"\xff"):
        record = struct.pack("<BQHIQQ", 5, 22 + len(text), 1, 0, 1, 1) + text
        head = struct.pack("<BQQQQIIQ", 6, 40 + len(record), 1, 1, len(record), zlib.crc32(record), 0, len(record))
        found = recordings.contents(small()[:HEADER] + head + record)
        assert not found.chunks
        assert found.damaged[-1][1] == HEADER + 49 + len(record)


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
        found = recordings.contents(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.damaged
    assert not found.chunks
    assert sums[0] < 2 * len(data)
    assert peak < len(data)


def test_a_long_message_closes_its_chunk(tmp_path: Path) -> None:
    recorder = recordings.RecordingFile(tmp_path / "t.mcap", {})
    for k in range(3):
        recorder.add("/tick", k, json.dumps({"t": k, "x": "x" * recordings.CHUNK}).encode())
    recorder.close()
    assert [len(chunk.lines) for chunk in recordings.contents((tmp_path / "t.mcap").read_bytes()).chunks] == [1, 1, 1]


def test_a_topic_of_another_version_is_kept(tmp_path: Path) -> None:
    recorder = recordings.RecordingFile(tmp_path / "t.mcap", {})
    recorder.add("/new", 1, b'{"t":1.0}')
    recorder.close()
    (chunk,) = recordings.contents((tmp_path / "t.mcap").read_bytes()).chunks
    assert chunk.lines[0].topic == "/new"


def test_the_numbers_of_topics_are_for_good() -> None:
    """They tell the topics of a file whose first chunk is lost: only ever add at the end."""
    assert list(recordings.TOPICS) == (
        [
            "/can/rx",
            "/can/tx",
            "/client",
            "/tick",
            "/end",
            "/state",
            "/command",
            "/steers",
            "/car",
            "/refused",
            "/recording",
            "/estimates",
            "/safety",
            "/adapted",
            "/description",
        ]
    )
