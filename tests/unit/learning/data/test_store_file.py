"""Store files: each commit reaches the disk; foreign, truncated, damaged and half written ones are noticed."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from steerkit.learning.data.store import TAIL, StoreError, TransitionStore
from tests.support.stores import drive, kept, same

ROW = 8 * 15 + 4


def refused(path: Path, why: str, **how: object) -> None:
    before = path.read_bytes() if path.exists() else None
    for run in (None, "a"):
        if before is None and run:
            continue
        with pytest.raises(StoreError, match=why):
            TransitionStore(path, run=run, **how).transitions()  # type: ignore[arg-type]
    assert (path.read_bytes() if path.exists() else None) == before


def test_missing_empty_and_foreign_files_are_refused_and_left_alone(tmp_path: Path) -> None:
    refused(tmp_path / "none.rows", "there is no store; make one with")
    (tmp_path / "empty.rows").touch()
    with pytest.raises(StoreError, match="not a transition store"):
        TransitionStore(tmp_path / "empty.rows")
    for text in ("to be or not to be\n", '{"title": "songs"}\n', "[1]\n", '{"format": "steerkit transitions 4"}\n'):
        (tmp_path / "other.rows").write_text(text * 100)
        refused(tmp_path / "other.rows", "not a transition store; use a new file")


def test_another_format_and_other_names_are_refused(tmp_path: Path) -> None:
    path = kept(tmp_path / "t.rows", drive(20))
    refused(path, "holds the columns e, e_dot, .*expected e, v; use a new file", names=("e", "v"))
    path.write_bytes(path.read_bytes().replace(b"transitions 4", b"transitions 5"))
    refused(path, "format 'steerkit transitions 5', expected 'steerkit transitions 4'; use a new file")


@pytest.mark.parametrize("lost", [1, ROW - 1, ROW, ROW + 1, 5 * ROW])
def test_what_a_crash_cuts_off_is_left_out(lost: int, tmp_path: Path) -> None:
    whole, path = drive(20), tmp_path / "t.rows"
    cut = kept(path, whole).read_bytes()[:-lost]
    path.write_bytes(cut)
    left = 20 - -(-lost // ROW)
    assert same(TransitionStore(path).transitions(), whole.part(slice(left)))
    assert path.read_bytes() == cut
    with TransitionStore(path, run="a") as store:
        store.append([0.0] * 6, 0.0, [0.0] * 6, 99)
    assert TransitionStore(path).transitions().episode.tolist() == [*whole.episode[:left].tolist(), 99]


def test_zeros_at_the_end_are_left_out_and_said(tmp_path: Path) -> None:
    """A file may have got its length before its rows when the power was cut."""
    whole, path = drive(20), tmp_path / "t.rows"
    kept(path, whole)
    with path.open("ab") as file:
        file.write(bytes(3 * ROW))
    with pytest.warns(RuntimeWarning, match="the last 3 transitions were not wholly written"):
        assert same(TransitionStore(path).transitions(), whole)
    with pytest.warns(RuntimeWarning, match="the last 3"), TransitionStore(path, run="a"):
        pass
    assert same(TransitionStore(path).transitions(), whole)
    with path.open("ab") as file:
        file.write(bytes((TAIL + 1) * ROW))
    refused(path, "transition 20 is damaged; use a copy")


def test_every_damaged_byte_is_noticed(tmp_path: Path) -> None:
    whole = drive(300)
    good = kept(tmp_path / "good.rows", whole).read_bytes()
    path, rng = tmp_path / "bad.rows", np.random.default_rng(0)
    for at in rng.integers(0, len(good) - ROW, 60).tolist() + list(range(0, good.index(b"\n"), 7)):
        bad = bytearray(good)
        bad[at] ^= 1 << at % 8
        path.write_bytes(bad)
        with pytest.raises(StoreError):
            TransitionStore(path, names=whole.names).transitions()


def test_every_commit_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    real = os.fsync

    def fsync(number: int) -> None:
        seen.append(os.fstat(number).st_size)
        real(number)

    monkeypatch.setattr(os, "fsync", fsync)
    path = tmp_path / "t.rows"
    with TransitionStore(path, run="b\nc", names=("e", "v")) as store:
        head = path.read_bytes()
        assert json.loads(head)["names"] == ["e", "v"]
        assert len(head) in seen
        store.append([0.0] * 2, 0.0, [0.0] * 2, 1)
        store.flush()
        assert seen[-1] == len(head) + 8 * 7 + 4
