"""Store files: foreign, truncated, damaged and half made ones."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from steerkit.learning.data.store import StoreError, TransitionStore
from tests.support.stores import drive, kept, same


def refused(path: Path, why: str, **how: object) -> None:
    before = path.read_bytes() if path.exists() else None
    for run in (None, "a"):
        if before is None and run:
            continue
        with pytest.raises(StoreError, match=why):
            TransitionStore(path, run=run, **how)  # type: ignore[arg-type]
    assert (path.read_bytes() if path.exists() else None) == before


def test_missing_empty_and_foreign_files_are_refused_and_left_alone(tmp_path: Path) -> None:
    refused(tmp_path / "none.db", "there is no store; make one with")
    (tmp_path / "empty.db").touch()
    with pytest.raises(StoreError, match="there is no store"):
        TransitionStore(tmp_path / "empty.db")
    (tmp_path / "text.db").write_text("to be or not to be\n" * 100)
    refused(tmp_path / "text.db", "damaged or not a transition store .file is not a database.")
    with sqlite3.connect(tmp_path / "other.db") as db:
        db.execute("CREATE TABLE songs(title)")
    db.close()
    refused(tmp_path / "other.db", "SQLite file of another program")


def test_another_schema_and_other_names_are_refused(tmp_path: Path) -> None:
    path = kept(tmp_path / "t.db", drive(20))
    refused(path, "holds the columns e, e_dot, .*expected e, v; use a new file", names=("e", "v"))
    for schema, why in ((2, "schema 2, expected 1: a newer steerkit wrote it, update yours"), (0, "schema 0")):
        with sqlite3.connect(path) as db:
            db.execute(f"PRAGMA user_version = {schema}")
        db.close()
        refused(path, why)


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    whole = kept(tmp_path / "t.db", drive(2000)).read_bytes()
    for size in (len(whole) // 2, 4096, 4095, 50):
        (tmp_path / "short.db").write_bytes(whole[:size])
        refused(tmp_path / "short.db", "damaged")


def test_every_damaged_page_is_noticed(tmp_path: Path) -> None:
    """Structure by SQLite's own check, numbers by the checksums: never a wrong number."""
    whole = drive(300)
    good = kept(tmp_path / "good.db", whole).read_bytes()
    path, noticed, rng = tmp_path / "bad.db", 0, np.random.default_rng(0)
    for at in rng.integers(100, len(good), 60).tolist():
        bad = bytearray(good)
        bad[at : at + 4] = bytes(b ^ 0xFF for b in bad[at : at + 4])
        path.write_bytes(bad)
        try:
            assert same(TransitionStore(path).transitions(), whole)  # unused space
        except (StoreError, ValueError):
            noticed += 1
        for stray in ("bad.db-wal", "bad.db-shm"):
            (tmp_path / stray).unlink(missing_ok=True)
    assert noticed >= 30


def test_a_creation_that_was_killed_halfway_is_made_good(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "t.db") as db:
        db.execute("PRAGMA journal_mode = WAL")
    db.close()
    assert len(TransitionStore(kept(tmp_path / "t.db", drive(7))).transitions()) == 7
