"""The file under a transition store: its tables, its transactions, and the checks before any use.

SQLite alone would notice damage to its pages, but not to a number inside one: each row carries a checksum.
"""

from __future__ import annotations

import json
import os
import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path as FilePath
from urllib.parse import quote

import numpy as np

from steerkit.controllers.state_description import StateDescription
from steerkit.learning.data.transitions import Transitions

APPLICATION, SCHEMA = 0x53746565, 1
"""SQLite's application_id ("Stee") and user_version of a store."""
TABLES = (
    "CREATE TABLE IF NOT EXISTS meta(key TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS run(id INTEGER PRIMARY KEY, label TEXT NOT NULL UNIQUE, uid TEXT NOT NULL UNIQUE)",
    # numbers: s, a, s_next as little-endian doubles; crc: CRC-32 of them, begun with the episode
    "CREATE TABLE IF NOT EXISTS transition(run INTEGER NOT NULL REFERENCES run, n INTEGER NOT NULL, "
    "episode INTEGER NOT NULL, numbers BLOB NOT NULL, crc INTEGER NOT NULL, PRIMARY KEY(run, n)) WITHOUT ROWID",
)
Path = str | os.PathLike[str]
Row = tuple[int, bytes, int]
"""Episode, numbers, checksum."""


class StoreError(ValueError):
    """A store that cannot be used: damaged, foreign, of a newer schema or other names, or not writable."""


@contextmanager
def errors_of(path: FilePath) -> Iterator[None]:
    """SQLite's errors as StoreError, with what to do."""
    try:
        yield
    except sqlite3.OperationalError as why:
        raise StoreError(f"{path}: {why}; another program may hold it, or the disk may be full") from why
    except sqlite3.DatabaseError as why:
        raise StoreError(f"{path}: damaged or not a transition store ({why}); use a copy, or a new file") from why


def connect(path: FilePath, timeout: float = 5.0) -> sqlite3.Connection:
    """A connection that makes no file, and waits for the disk at every commit."""
    db = sqlite3.connect(_uri(path), uri=True, isolation_level=None, timeout=timeout)
    db.execute("PRAGMA synchronous = FULL")
    return db


@contextmanager
def transaction(db: sqlite3.Connection) -> Iterator[sqlite3.Connection]:
    """All that is written inside, or nothing; the write lock is taken at once, so that nothing comes in between."""
    db.execute("BEGIN IMMEDIATE")
    try:
        yield db
        db.execute("COMMIT")
    except BaseException:
        if db.in_transaction:
            db.execute("ROLLBACK")
        raise


@contextmanager
def reading(path: FilePath) -> Iterator[sqlite3.Connection]:
    """A connection of its own, for as long as the block runs."""
    with errors_of(path), closing(connect(path)) as db:
        yield db


@contextmanager
def writing(path: FilePath, attach: FilePath | None = None) -> Iterator[sqlite3.Connection]:
    """A connection in one transaction; the store `attach`, if given, is `other` in it."""
    with reading(path) as db:
        if attach is not None:
            db.execute("ATTACH ? AS other", (_uri(attach),))
        with transaction(db):
            yield db


def opened(path: FilePath, names: Sequence[str] | None, *, create: bool) -> tuple[str, ...]:
    """The names of the store at `path`, checked to be one of ours and whole; a missing one is made if `create`."""
    new = not path.exists() or path.stat().st_size == 0
    if new and not create:
        raise StoreError(f"{path}: there is no store; make one with TransitionStore(path, run='a label')")
    if new:
        path.touch()
    with reading(path) as db:
        numbers = {name: db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")}
        tables = {row[0] for row in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        blank = not tables and not any(numbers.values())  # also: killed while it was being made
        if not blank:
            if numbers["application_id"] != APPLICATION:
                raise StoreError(f"{path}: an SQLite file of another program, not a transition store")
            check_schema(path, numbers["user_version"])
            check = db.execute("PRAGMA quick_check(1)").fetchone()[0]
            if check != "ok":
                raise StoreError(f"{path}: damaged ({check}); use a copy, or a new file")
    if blank and not create:
        raise StoreError(f"{path}: an empty file, not a transition store")
    if blank:
        _create(path, tuple(names or StateDescription().names))
    with reading(path) as db:
        (text,) = db.execute("SELECT value FROM meta WHERE key = 'names'").fetchone()
    columns = tuple(json.loads(text))
    if names is not None and tuple(names) != columns:
        raise StoreError(f"{path}: holds the columns {', '.join(columns)}, expected {', '.join(names)}; use a new file")
    return columns


def _create(path: FilePath, names: tuple[str, ...]) -> None:
    with reading(path) as db:
        (mode,) = db.execute("PRAGMA journal_mode = WAL").fetchone()
    if mode != "wal":
        raise StoreError(f"{path}: no write-ahead log on this file system; use a local disk")
    with writing(path) as db:
        db.execute(f"PRAGMA application_id = {APPLICATION}")
        db.execute(f"PRAGMA user_version = {SCHEMA}")
        for table in TABLES:
            db.execute(table)
        db.execute("INSERT OR IGNORE INTO meta VALUES ('names', ?)", (json.dumps(names),))


def check_schema(path: Path, schema: int) -> None:
    """Raise StoreError unless this steerkit knows the schema."""
    if schema != SCHEMA:
        reason = "a newer steerkit wrote it, update yours" if schema > SCHEMA else "no steerkit ever wrote that"
        raise StoreError(f"{path}: schema {schema}, expected {SCHEMA}: {reason}")


def insert(db: sqlite3.Connection, run: int, n: int, rows: Sequence[Row]) -> None:
    """Write rows n, n + 1, ... of a run."""
    numbered = ((run, n + i, *row) for i, row in enumerate(rows))
    db.executemany("INSERT INTO transition VALUES (?, ?, ?, ?, ?)", numbered)


def rows_of(transitions: Transitions) -> list[Row]:
    """Transitions as the file keeps them."""
    numbers = np.column_stack([transitions.s, transitions.a, transitions.s_next]).astype("<f8")
    texts = [row.tobytes() for row in numbers]
    return [(episode, text, checksum(episode, text)) for episode, text in zip(transitions.episode.tolist(), texts)]


def checksum(episode: int, numbers: bytes) -> int:
    """CRC-32 of a row."""
    return zlib.crc32(numbers, episode & 0xFFFFFFFF)


def _uri(path: FilePath) -> str:
    return f"file:{quote(str(path.absolute()))}?mode=rw"
