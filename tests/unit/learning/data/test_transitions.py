"""The record of transitions: it grows, it refuses nonsense, and it comes back from disk as it was."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.learning.data.transitions import Transitions
from tests.support.stores import ARRAYS, drive


@given(st.lists(st.integers(0, 400), max_size=6))
def test_rows_come_back_in_order_however_they_were_added(counts: list[int]) -> None:
    n = sum(counts)
    whole = drive(n)
    parts = Transitions()
    at = 0
    for count in counts:
        rows = slice(at, at + count)
        parts.extend(whole.s[rows], whole.a[rows], whole.s_next[rows], whole.episode[rows], whole.own[rows])
        at += count
    assert len(parts) == n
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_views_are_contiguous_read_only_and_stay_valid() -> None:
    record = drive(10)
    view, before = record.s, record.s.copy()
    assert view.flags.c_contiguous
    with pytest.raises(ValueError, match="read-only"):
        view[0, 0] = 1.0
    record.extend(np.ones((5000, 6)), np.ones(5000), np.ones((5000, 6)), 7)
    np.testing.assert_array_equal(view, before)
    assert record.s.shape == (5010, 6)


ZEROS = np.zeros(6)
BROKEN = np.array([0.0, 0.0, 0.0, np.nan, 0.0, 0.0])


@pytest.mark.parametrize(
    ("s", "a", "s_next", "episode", "words"),
    [
        (BROKEN, 0.0, ZEROS, 0, r"s\.psi_e = nan in row 0"),
        (ZEROS, 0.0, BROKEN, 0, r"s_next\.psi_e"),
        (ZEROS, np.inf, ZEROS, 0, r"a = .*\[rad\]"),
        (ZEROS[:5], 0.0, ZEROS, 0, r"expected \(1, 6\): e, e_dot, v, psi_e, r_e, doe"),
        (ZEROS, 0.0, ZEROS, [1, 2, 3], "broadcast"),
    ],
)
def test_rows_that_are_none_are_refused_by_name_and_leave_nothing(
    s: Any, a: float, s_next: Any, episode: Any, words: str
) -> None:
    record = drive(3)
    with pytest.raises(ValueError, match=words):
        record.extend(s[None], [a], s_next[None], episode)
    assert [len(getattr(record, name)) for name in ARRAYS] == [3] * 5


def test_saved_and_loaded_bit_for_bit(tmp_path: Path) -> None:
    record, file = drive(300), tmp_path / "t.npz"
    record.save(file)
    again = Transitions.load(file)
    for name in ARRAYS:
        assert getattr(again, name).tobytes() == getattr(record, name).tobytes()
    assert again.names == record.names
    again.save(tmp_path / "u.npz")
    assert (tmp_path / "u.npz").read_bytes() == file.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["t.npz", "u.npz"]


def test_a_data_frame_has_a_row_a_transition() -> None:
    record = drive(30)
    frame = record.to_pandas()
    after = [f"next_{name}" for name in record.names]
    assert [*frame.columns] == [*record.names, "a", *after, "episode", "own"]
    np.testing.assert_array_equal(frame[[*record.names]], record.s)
    np.testing.assert_array_equal(frame[after], record.s_next)
    for name in ("a", "episode", "own"):
        np.testing.assert_array_equal(frame[name], getattr(record, name))
        assert frame[name].dtype == getattr(record, name).dtype


def test_foreign_files_are_named(tmp_path: Path) -> None:
    file = tmp_path / "t.npz"
    np.savez(file, x=np.zeros(3))
    with pytest.raises(ValueError, match="of another program', expected 'steerkit transitions 1'"):
        Transitions.load(file)
    np.savez(file, format="steerkit transitions 1", names=["e"], s=np.zeros((2, 1)), a=np.zeros(3))
    with pytest.raises(ValueError, match="do not hold together"):
        Transitions.load(file)
    with pytest.raises(FileNotFoundError):
        Transitions.load(tmp_path / "nothing.npz")
