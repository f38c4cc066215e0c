"""Stores merged into one."""

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from steerkit.learning.data.store import StoreError, TransitionStore, merge
from tests.support.stores import drive, fill, kept, same


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
        fill(store, drive(5, seed=1, first_episode=3))
    assert merge(target, [source]) == {"a": 25}
    assert same(TransitionStore(target).transitions(), TransitionStore(source).transitions())
    with TransitionStore(source, run="a") as store:
        store.cut(10)
        fill(store, drive(15, seed=9))
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
