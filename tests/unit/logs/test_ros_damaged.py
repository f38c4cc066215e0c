"""An MCAP of ROS 2 that is cut off or spoilt: what is intact is used, and a note says so."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.logs import Drive, read_drive
from tests.support.written_logs import driven, written

pytest.importorskip("mcap")
pytest.importorskip("rosbags")
from mcap.reader import make_reader


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, Drive]:
    file, _ = written("ros2 mcap with sums", tmp_path_factory.mktemp("bag"), driven(60.0))
    return file.read_bytes(), read_drive(file)


def read(data: bytes, folder: Path) -> Any:
    file = folder / "drive.mcap"
    file.write_bytes(data)
    return read_drive(file)


def notes_of(drive: Drive) -> list[str]:
    return [note for note in drive.notes if note.startswith("cut off or broken")]


def test_of_a_file_that_is_cut_off_what_comes_before_is_used(whole: tuple[bytes, Drive], tmp_path: Path) -> None:
    data, right = whole
    assert not notes_of(right)
    for share in (0.6, 0.9):
        drive = read(data[: int(share * len(data))], tmp_path)
        (note,) = notes_of(drive)
        assert "what is intact is used" in note
        n = len(drive.v)
        assert 0.4 * len(right.v) < n < len(right.v)
        np.testing.assert_array_equal(drive.v[: n - 1], right.v[: n - 1])


def test_a_chunk_that_does_not_hold_its_sum_is_left_out_and_told(whole: tuple[bytes, Drive], tmp_path: Path) -> None:
    """The first one too, which has the descriptions of its topics: those stand at the file's end once more."""
    data, right = whole
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    chunks = summary.chunk_indexes
    for chunk in (chunks[0], chunks[len(chunks) // 2]):
        spoilt = bytearray(data)
        spoilt[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 16
        drive = read(bytes(spoilt), tmp_path)
        (note,) = notes_of(drive)
        assert "a chunk that is not intact" in note
        assert drive.dt == right.dt
        assert drive.measured.sum() < right.measured.sum()
        begin = len(right.v) - len(drive.v)  # as the first seconds are missing where the first chunk is
        both = drive.measured & right.measured[begin:]
        assert both.sum() > 300
        np.testing.assert_allclose(drive.v[both], right.v[begin:][both], atol=1e-5)


def test_what_holds_nothing_intact_teaches(whole: tuple[bytes, Drive], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no ROS bag, or a broken one"):
        read(whole[0][:600], tmp_path)
    with pytest.raises(ValueError, match=r"no ROS bag, or a broken one"):
        read(b"\x89MCAP0\r\n" + bytes(500), tmp_path)
