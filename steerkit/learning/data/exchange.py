"""Transition stores between programs: several merged into one, and to and from Parquet."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit.learning.data.store import TransitionStore
from steerkit.learning.data.store_file import (
    SCHEMA,
    Path,
    StoreError,
    check_schema,
    insert,
    opened,
    reading,
    rows_of,
    writing,
)
from steerkit.learning.data.transitions import Transitions


def merge(target: Path, sources: Sequence[Path]) -> dict[str, int]:
    """Bring the runs of several stores into one; returns its labels and rows.

    Runs keep their labels; where two different runs have the same one, the newcomer's gets its file's name behind it.
    A run that is there already is not doubled: rows driven since are added. All or nothing of each source. Raises
    StoreError for a source that cannot be read, has other names, or has changed in rows that were merged before.
    """
    require(len(sources) > 0, "merge", "no sources, expected at least one store")
    stores = [TransitionStore(source) for source in sources]
    for store in stores:
        store.transitions()  # damage is found before anything is written
    opened(FilePath(target), stores[0].names, create=True)
    for store in stores:
        if store.names != stores[0].names:
            raise StoreError(f"{store.path}: has {store.names}, but {stores[0].path} has {stores[0].names}")
        with writing(FilePath(target), attach=store.path) as db:
            for number, label, uid in db.execute("SELECT id, label, uid FROM other.run ORDER BY id").fetchall():
                _merge_run(db, number, label, uid, store.path)
    return TransitionStore(target).runs()


def _merge_run(db: sqlite3.Connection, number: int, label: str, uid: str, source: FilePath) -> None:
    known = db.execute("SELECT id FROM main.run WHERE uid = ?", (uid,)).fetchone()
    if known is None:
        taken = {row[0] for row in db.execute("SELECT label FROM main.run")}
        more = (f"{label} ({source.stem}{f' {k}' if k > 1 else ''})" for k in range(1, len(taken) + 2))
        label = next(free for free in (label, *more) if free not in taken)
        known = (db.execute("INSERT INTO main.run(label, uid) VALUES (?, ?)", (label, uid)).lastrowid,)
    same = "FROM other.transition o JOIN main.transition m ON m.run = ? AND m.n = o.n WHERE o.run = ?"
    (changed,) = db.execute(f"SELECT count(*) {same} AND o.crc != m.crc", (*known, number)).fetchone()
    if changed:
        raise StoreError(f"{source}: {changed} rows of run '{label}' have changed since it was merged; start afresh")
    rows = "SELECT ?, n, episode, numbers, crc FROM other.transition WHERE run = ?"
    db.execute(f"INSERT OR IGNORE INTO main.transition {rows}", (*known, number))


def to_parquet(store: TransitionStore, file: Path) -> None:
    """Write all runs of a store to a Parquet file with the columns run, episode, s.<name>..., a, s_next.<name>...

    Raises ImportError without pyarrow (extra `bench`).
    """
    pa, pq = _pyarrow()
    columns: dict[str, list[Any]] = {name: [] for name in _columns(store.names)}
    for label in store.runs():
        rows = store.transitions(label)
        for name, values in zip(columns, ([label] * len(rows), rows.episode, *rows.s.T, rows.a, *rows.s_next.T)):
            columns[name].append(pa.array(values, pa.string() if name == "run" else None))
    with reading(store.path) as db:
        uids = dict(db.execute("SELECT label, uid FROM run ORDER BY id").fetchall())
    about = json.dumps({"schema": SCHEMA, "names": store.names, "runs": uids})
    kinds = [pa.string(), pa.int64(), *[pa.float64()] * (2 * len(store.names) + 1)]
    chunks = [pa.chunked_array(parts, kind) for parts, kind in zip(columns.values(), kinds)]
    table = pa.table(chunks, names=list(columns)).replace_schema_metadata({"steerkit.transitions": about})
    pq.write_table(table, file)


def from_parquet(file: Path, path: Path) -> TransitionStore:
    """A new store at `path`, opened for reading, with what `to_parquet` wrote, bit for bit.

    Raises StoreError when the file is none of ours, ValueError when `path` exists (bring it in with `merge`),
    ImportError without pyarrow.
    """
    pa, pq = _pyarrow()
    require(not FilePath(path).exists(), str(path), "exists; make a new store, and bring it in with merge()")
    try:
        table = pq.read_table(file)
        about = json.loads((table.schema.metadata or {})[b"steerkit.transitions"])
        schema, names, uids = about["schema"], tuple(about["names"]), about["runs"]
    except (pa.ArrowInvalid, KeyError, ValueError) as why:
        raise StoreError(f"{file}: cut short, or not a Parquet file that to_parquet wrote ({why})") from why
    check_schema(file, schema)
    missing = set(_columns(names)) - set(table.column_names)
    if missing:
        raise StoreError(f"{file}: columns {', '.join(sorted(missing))} are missing")
    opened(FilePath(path), names, create=True)
    labels = table["run"].to_numpy()
    numbers = np.stack([table[name].to_numpy() for name in _columns(names)[2:]], axis=1)
    episode, n = table["episode"].to_numpy(), len(names)
    with writing(FilePath(path)) as db:
        for run, (label, uid) in enumerate(uids.items(), start=1):
            mine, record = labels == label, Transitions(names)
            record.extend(numbers[mine, :n], numbers[mine, n], numbers[mine, n + 1 :], episode[mine])
            db.execute("INSERT INTO run VALUES (?, ?, ?)", (run, label, uid))
            insert(db, run, 0, rows_of(record))
    return TransitionStore(path)


def _columns(names: Sequence[str]) -> list[str]:
    return ["run", "episode", *(f"s.{name}" for name in names), "a", *(f"s_next.{name}" for name in names)]


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as why:
        raise ImportError("Parquet needs pyarrow: pip install 'steerkit-control[bench]'") from why
    return pa, pq
