"""Store files: each commit reaches the disk; foreign, truncated, damaged and half made ones are noticed."""

import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.learning.data.store import StoreError, TransitionStore, connect, transaction
from tests.support.stores import drive, kept, same

FULL = 2


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
    newer, older = (
        "schema 4, expected 3: a newer steerkit wrote it, update yours",
        "schema 2, expected 3: use a new file",
    )
    for schema, why in ((4, newer), (2, older), (0, "schema 0")):
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


def test_every_commit_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[Any, ...]] = []

    class Watched(sqlite3.Connection):
        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
            if sql == "BEGIN IMMEDIATE":
                pragmas = ("synchronous", "journal_mode")
                seen.append(tuple(super(Watched, self).execute(f"PRAGMA {name}").fetchone()[0] for name in pragmas))
            return super().execute(sql, *values)

    real = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *words, **how: real(*words, **how, factory=Watched))
    path = tmp_path / "t.db"
    with TransitionStore(path, run="a") as store:  # commits: the tables, the run
        assert len(seen) == 2
        store.append([0.0] * 6, 0.0, [0.0] * 6, 1)
        store.flush()
        assert len(seen) == 3
    assert set(seen) == {(FULL, "wal")}


def test_a_transaction_that_fails_leaves_nothing(tmp_path: Path) -> None:
    path = kept(tmp_path / "t.db", drive(3))
    db = connect(path)

    def fails() -> None:
        with transaction(db):
            db.execute("DELETE FROM transition")
            raise KeyError("a mistake in between")

    with pytest.raises(KeyError, match="in between"):
        fails()
    db.close()
    assert len(TransitionStore(path).transitions()) == 3


@pytest.mark.parametrize(
    "change", ["episode = episode + 1", "episode = -episode", "crc = crc + 1", "numbers = zeroblob(104)"]
)
def test_a_row_that_was_changed_behind_the_stores_back_is_noticed(change: str, tmp_path: Path) -> None:
    path = kept(tmp_path / "t.db", drive(5))
    db = connect(path)
    db.execute(f"UPDATE transition SET {change} WHERE n = 2")
    db.close()
    with pytest.raises(StoreError, match="transition 2 is damaged"):
        TransitionStore(path).transitions()
