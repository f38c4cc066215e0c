"""The transition store: it never delays a step, survives a kill, refuses what it cannot vouch for, and merges."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from steerkit.learning.data.exchange import from_parquet, merge, to_parquet
from steerkit.learning.data.store import StoreError, TransitionStore
from steerkit.learning.data.transitions import Transitions

AWKWARD = (-0.0, 5e-324, 0.1 + 0.2, -1e300, 1.0, -3.5)
ARRAYS = ("s", "a", "s_next", "episode")


def drive(n: int, seed: int = 0, first_episode: int = 1) -> Transitions:
    rng = np.random.default_rng(seed)
    record = Transitions()
    record.extend(
        rng.normal(size=(n, 6)), rng.normal(size=n), rng.normal(size=(n, 6)), first_episode + np.arange(n) // 10
    )
    return record


def same(one: Transitions, other: Transitions) -> bool:
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in ARRAYS)


def kept(path: Path, record: Transitions, run: str = "a") -> Path:
    with TransitionStore(path, run=run) as store:
        store.extend(record)
    return path


# ---- what goes in comes out -------------------------------------------------------------------------------------


def test_rows_come_back_in_order_and_bit_for_bit(tmp_path: Path) -> None:
    whole = drive(300)
    whole.append(AWKWARD, -0.0, AWKWARD, 99)
    with TransitionStore(tmp_path / "t.db", run="a") as store:
        for k in range(150):
            store.append(whole.s[k].tolist(), float(whole.a[k]), whole.s_next[k].tolist(), int(whole.episode[k]))
        rest = Transitions()
        rest.extend(whole.s[150:], whole.a[150:], whole.s_next[150:], whole.episode[150:])
        store.extend(rest)
        store.flush()
        assert (store.committed, store.waiting, store.fault) == (301, 0, "")
        assert same(store.transitions(), whole)  # another reader, while it is open to be written
    assert same(TransitionStore(tmp_path / "t.db").transitions("a"), whole)


def test_two_hundred_thousand_rows(tmp_path: Path) -> None:
    whole = drive(200_000)
    assert same(TransitionStore(kept(tmp_path / "t.db", whole)).transitions(), whole)


def test_a_run_goes_on_where_it_was_and_can_be_cut_back(tmp_path: Path) -> None:
    path = kept(tmp_path / "t.db", drive(30))
    with TransitionStore(path, run="a") as store:
        assert store.next_episode() == 4
        store.extend(drive(10, seed=1, first_episode=4))
    assert TransitionStore(path).runs() == {"a": 40}
    with TransitionStore(path, run="a") as store:
        store.cut(30)
        store.extend(drive(5, seed=2, first_episode=4))
    rows = TransitionStore(path).transitions()
    assert rows.s[30:].tobytes() == drive(5, seed=2).s.tobytes()
    assert rows.s[:30].tobytes() == drive(30).s.tobytes()
    with TransitionStore(path, run="another") as store:
        assert store.next_episode() == 0


def test_runs_keep_their_order_and_their_episodes_apart(tmp_path: Path) -> None:
    path = tmp_path / "t.db"
    with TransitionStore(path, run="a") as a, TransitionStore(path, run="b") as b:
        for k in range(20):  # two cars at once: rows of one run stay together all the same
            for store, shift in ((a, 0.0), (b, 100.0)):
                store.append([k + shift] * 6, 0.0, [k + 1 + shift] * 6, 1 + k // 10)
                store.flush()
    rows = TransitionStore(path).transitions()
    np.testing.assert_array_equal(rows.s[:, 0], [*range(20), *range(100, 120)])
    np.testing.assert_array_equal(rows.episode, [1] * 10 + [2] * 10 + [3] * 10 + [4] * 10)
    np.testing.assert_array_equal(TransitionStore(path).transitions("b").episode, [1] * 10 + [2] * 10)
    with pytest.raises(ValueError, match="has no run 'c'; valid: a, b"):
        TransitionStore(path).transitions("c")


def test_what_cannot_be_learned_from_is_refused_at_once(tmp_path: Path) -> None:
    with TransitionStore(tmp_path / "t.db", run="a") as store:
        with pytest.raises(ValueError, match="psi_e_next = nan, expected a finite number; end the episode"):
            store.append([0.0] * 6, 0.0, [0.0, 0.0, 0.0, float("nan"), 0.0, 0.0], 1)
        with pytest.raises(ValueError, match="s has 5, s_next has 6 entries, expected 6: e, e_dot"):
            store.append([0.0] * 5, 0.0, [0.0] * 6, 1)
    assert len(TransitionStore(tmp_path / "t.db").transitions()) == 0
    with pytest.raises(StoreError, match="closed, or opened for reading"):
        store.append([0.0] * 6, 0.0, [0.0] * 6, 1)
    with pytest.raises(StoreError, match="closed, or opened for reading"):
        TransitionStore(tmp_path / "t.db").append([0.0] * 6, 0.0, [0.0] * 6, 1)


# ---- a driver is never kept waiting -----------------------------------------------------------------------------


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
    store.extend(whole)
    for _ in range(500):  # would never return if append waited for the lock: nobody else releases it
        store.append([1.0] * 6, 0.5, [2.0] * 6, 200)
    with pytest.raises(StoreError, match=r"1500 transitions are not written after 0\.5 s: .*locked"):
        store.flush(timeout=0.5)
    assert (store.waiting, store.committed) == (1500, 0)
    assert "locked" in store.fault
    other.execute("ROLLBACK")
    store.flush()
    assert (store.waiting, store.fault) == (0, "")
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
    print(k, store.committed, time.monotonic(), flush=True)
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
    assert TransitionStore(path).runs() == {"a": len(rows) + 1}


def test_a_program_that_ends_without_closing_loses_nothing(tmp_path: Path) -> None:
    code = CHILD.replace("while True", "while k < 50").replace("time.sleep(0.005)", "")
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "t.db")], check=True, capture_output=True)
    assert TransitionStore(tmp_path / "t.db").runs() == {"a": 50}


# ---- what it will not touch -------------------------------------------------------------------------------------


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


# ---- between programs -------------------------------------------------------------------------------------------


def test_parquet_and_back_bit_for_bit(tmp_path: Path) -> None:
    record = drive(50)
    record.append(AWKWARD, -0.0, AWKWARD, 99)
    path = kept(kept(tmp_path / "t.db", record), drive(20, seed=1), run="second")
    to_parquet(TransitionStore(path), tmp_path / "t.parquet")
    back = from_parquet(tmp_path / "t.parquet", tmp_path / "back.db")
    assert back.runs() == {"a": 51, "second": 20}
    assert same(back.transitions("a"), record)
    assert same(back.transitions(), TransitionStore(path).transitions())
    assert merge(path, [back.path]) == {"a": 51, "second": 20}  # they are known to be the same runs
    import pyarrow.parquet as pq

    assert pq.read_table(tmp_path / "t.parquet").column_names[:4] == ["run", "episode", "s.e", "s.e_dot"]
    with pytest.raises(ValueError, match="exists; make a new store"):
        from_parquet(tmp_path / "t.parquet", path)


def test_foreign_and_truncated_parquet_is_refused(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    to_parquet(TransitionStore(kept(tmp_path / "t.db", drive(50))), tmp_path / "t.parquet")
    (tmp_path / "short.parquet").write_bytes((tmp_path / "t.parquet").read_bytes()[:-40])
    pq.write_table(pa.table({"title": ["hey"]}), tmp_path / "songs.parquet")
    for name in ("short", "songs"):
        with pytest.raises(StoreError, match="cut short, or not a Parquet file"):
            from_parquet(tmp_path / f"{name}.parquet", tmp_path / "new.db")
    assert not (tmp_path / "new.db").exists()


def test_an_empty_store_survives_parquet(tmp_path: Path) -> None:
    TransitionStore(tmp_path / "t.db", run="a").close()
    to_parquet(TransitionStore(tmp_path / "t.db"), tmp_path / "t.parquet")
    assert from_parquet(tmp_path / "t.parquet", tmp_path / "back.db").runs() == {"a": 0}


def test_merging_labels_runs_and_keeps_episodes_apart(tmp_path: Path) -> None:
    first, second = kept(tmp_path / "first.db", drive(20)), kept(tmp_path / "second.db", drive(30, seed=1))
    kept(second, drive(5, seed=2), run="b")
    assert merge(tmp_path / "all.db", [first, second]) == {"a": 20, "a (second)": 30, "b": 5}
    merged = TransitionStore(tmp_path / "all.db")
    assert same(merged.transitions("a (second)"), drive(30, seed=1))
    rows = merged.transitions()
    assert len(rows) == 55
    assert sorted(set(rows.episode.tolist())) == [1, 2, 3, 4, 5, 6]
    assert (np.diff(rows.episode) >= 0).all()


def test_merging_again_adds_only_what_is_new(tmp_path: Path) -> None:
    source, target = kept(tmp_path / "t.db", drive(20)), tmp_path / "all.db"
    shutil.copy(source, tmp_path / "copy.db")
    assert merge(target, [source, tmp_path / "copy.db"]) == {"a": 20}
    with TransitionStore(source, run="a") as store:
        store.extend(drive(5, seed=1, first_episode=3))
    assert merge(target, [source]) == {"a": 25}
    assert same(TransitionStore(target).transitions(), TransitionStore(source).transitions())
    with TransitionStore(source, run="a") as store:
        store.cut(10)
        store.extend(drive(15, seed=9))
    with pytest.raises(StoreError, match="15 rows of run 'a' have changed since it was merged"):
        merge(target, [source])


def test_a_bad_source_leaves_the_target_as_it_was(tmp_path: Path) -> None:
    target = tmp_path / "all.db"
    merge(target, [kept(tmp_path / "t.db", drive(20))])
    before = TransitionStore(target).runs()
    bad = kept(tmp_path / "bad.db", drive(40, seed=3))
    with sqlite3.connect(bad) as db:
        db.execute("UPDATE transition SET crc = crc + 1 WHERE n = 7")
    db.close()
    with pytest.raises(StoreError, match="transition 7 of run 'a' is damaged"):
        merge(target, [bad])
    other = tmp_path / "other.db"
    TransitionStore(other, run="x", names=("e", "v")).close()
    with pytest.raises(StoreError, match="holds the columns"):
        merge(target, [other])
    assert TransitionStore(target).runs() == before
