"""Stores to Parquet and back, and merged."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from steerkit.learning.data.exchange import from_parquet, merge, to_parquet
from steerkit.learning.data.store import StoreError, TransitionStore
from tests.support.stores import AWKWARD, drive, kept, same


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
