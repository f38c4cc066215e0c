"""The transition store: it never delays a step, survives a kill, and refuses what it cannot vouch for."""

import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.learning.data.store import StoreError, TransitionStore, connect, transaction
from tests.support.stores import AWKWARD, drive, fill, kept, same


def test_rows_come_back_in_order_and_bit_for_bit(tmp_path: Path) -> None:
    whole = drive(300)
    whole.append(AWKWARD, -0.0, AWKWARD, 99)
    with TransitionStore(tmp_path / "t.db", run="a") as store:
        fill(store, whole)
        store.flush()
        assert store.writer is not None
        assert (store.writer.committed, store.writer.waiting, store.fault) == (301, [], "")
        assert same(store.transitions(), whole)  # another reader, while it is open to be written
    assert same(TransitionStore(tmp_path / "t.db").transitions(), whole)


def test_a_run_goes_on_where_it_was(tmp_path: Path) -> None:
    path = kept(tmp_path / "t.db", drive(30))
    with TransitionStore(path, run="a") as store:
        assert store.next_episode() == 4
        fill(store, drive(10, seed=1, first_episode=4))
    rows = TransitionStore(path).transitions()
    assert rows.s[30:].tobytes() == drive(10, seed=1).s.tobytes()
    assert rows.s[:30].tobytes() == drive(30).s.tobytes()
    with TransitionStore(tmp_path / "new.db", run="a") as store:
        assert store.next_episode() == 0


def test_a_file_is_of_one_run(tmp_path: Path) -> None:
    path = kept(tmp_path / "t.db", drive(3))
    with pytest.raises(StoreError, match=r"holds the runs \['a'\], expected b; use a new file"):
        TransitionStore(path, run="b")
    assert len(TransitionStore(path).transitions()) == 3
    with sqlite3.connect(path) as db:
        db.execute("INSERT INTO run VALUES (2, 'b')")
    db.close()
    for run in (None, "a"):
        with pytest.raises(StoreError, match=r"holds the runs \['a', 'b'\], expected"):
            TransitionStore(path, run=run)


def test_a_store_that_is_only_read_takes_nothing(tmp_path: Path) -> None:
    with TransitionStore(tmp_path / "t.db", run="a") as store:
        pass
    with pytest.raises(StoreError, match="closed, or opened for reading"):
        store.append([0.0] * 6, 0.0, [0.0] * 6, 1)
    with pytest.raises(StoreError, match="closed, or opened for reading"):
        TransitionStore(tmp_path / "t.db").append([0.0] * 6, 0.0, [0.0] * 6, 1)


@pytest.fixture
def blocked(tmp_path: Path) -> Iterator[tuple[TransitionStore, sqlite3.Connection]]:
    """A store whose file another program holds locked."""
    store = TransitionStore(tmp_path / "t.db", run="a")
    other = sqlite3.connect(store.path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    yield store, other
    other.close()
    store.close()


def test_a_locked_database_does_not_stop_append_and_loses_nothing(
    blocked: tuple[TransitionStore, sqlite3.Connection],
) -> None:
    store, other = blocked
    whole = drive(1000)
    fill(store, whole)
    for _ in range(500):  # would never return if append waited for the lock: nobody else releases it
        store.append([1.0] * 6, 0.5, [2.0] * 6, 200)
    with pytest.raises(StoreError, match=r"1500 transitions are not written after 0\.5 s: .*locked"):
        store.flush(timeout=0.5)
    assert store.writer is not None
    assert (len(store.writer.waiting), store.writer.committed) == (1500, 0)
    assert "locked" in store.fault
    other.execute("ROLLBACK")
    store.flush()
    assert (store.writer.waiting, store.fault) == ([], "")
    rows = store.transitions()
    assert len(rows) == 1500
    assert rows.s[:1000].tobytes() == whole.s.tobytes()


def test_rows_that_cannot_be_written_are_no_secret(
    blocked: tuple[TransitionStore, sqlite3.Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("steerkit.learning.data.store.PROMISE", -1.0)
    store, _ = blocked

    def give_up() -> None:
        store.append([1.0] * 6, 0.5, [2.0] * 6, 1)
        with pytest.raises(StoreError, match="1 transitions are not written"):
            store.close(timeout=1.0)

    with pytest.warns(RuntimeWarning, match="1 transitions wait to be written: .*locked"):
        give_up()


CHILD = """
import sys, time
from steerkit.learning.data.store import TransitionStore
store = TransitionStore(sys.argv[1], run="a")
k = 0
while True:
    store.append([k, 0, 5, 0, 0, 0], 0.5, [k + 1, 0, 5, 0, 0, 0], k // 100)
    k += 1
    print(k, store.writer.committed, time.monotonic(), flush=True)
    time.sleep(0.005)
"""


def test_kill_9_loses_at_most_the_last_second(tmp_path: Path) -> None:
    path = tmp_path / "t.db"
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    lines = [child.stdout.readline()]
    while int(lines[-1].split()[1]) < 200:
        lines.append(child.stdout.readline())
    lines += [child.stdout.readline() for _ in range(400)]  # two seconds and more
    os.kill(child.pid, signal.SIGKILL)
    lines += child.stdout.readlines()
    child.wait()
    told = [line.split() for line in lines if line.endswith("\n")]
    appended, committed = int(told[-1][0]), int(told[-1][1])
    rows = TransitionStore(path).transitions()
    assert committed <= len(rows) <= appended + 1
    np.testing.assert_array_equal(rows.s[:, 0], np.arange(len(rows)))
    np.testing.assert_array_equal(rows.episode, np.arange(len(rows)) // 100)
    if len(rows) < appended:  # how old was the oldest row that is lost, by the child's own clock?
        assert float(told[-1][2]) - float(told[len(rows)][2]) < 1.0
    with TransitionStore(path, run="a") as store:
        store.append([0.0] * 6, 0.0, [0.0] * 6, store.next_episode())
    assert len(TransitionStore(path).transitions()) == len(rows) + 1


def test_a_program_that_ends_without_closing_loses_nothing(tmp_path: Path) -> None:
    code = CHILD.replace("while True", "while k < 50").replace("time.sleep(0.005)", "")
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "t.db")], check=True, capture_output=True)
    assert len(TransitionStore(tmp_path / "t.db").transitions()) == 50


# ---- the file


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
