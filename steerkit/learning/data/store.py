"""The transition store: what a car experienced, on disk within half a second, whole after any crash.

One SQLite file in write-ahead mode. `append` only puts a row into memory; a thread of the store's own writes and
commits what has come in, four times a second. Commits are synced to the disk (synchronous=FULL): the thread can wait
for the disk, the loop never does, and a car's power is cut as often as a process is killed.
"""

import json
import math
import os
import sqlite3
import struct
import threading
import time
import warnings
import weakref
import zlib
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path as FilePath
from typing import Any
from urllib.parse import quote

import numpy as np

from steerkit.controllers.policy import StateDescription
from steerkit.learning.data.transitions import Transitions

APPLICATION, SCHEMA = 0x53746565, 3
"""SQLite's application_id ("Stee") and user_version of a store."""
RUN = 1
"""The id of a file's run."""
TABLES = (
    "CREATE TABLE IF NOT EXISTS meta(key TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS run(id INTEGER PRIMARY KEY, label TEXT NOT NULL UNIQUE)",
    # numbers: s, a, s_next, own (0 or 1) as little-endian doubles; crc: CRC-32 of them, begun with the episode
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
    uri = f"file:{quote(str(path.absolute()))}?mode=rw"
    db = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=timeout)
    db.execute("PRAGMA synchronous = FULL")
    return db


@contextmanager
def transaction(db: sqlite3.Connection) -> Iterator[sqlite3.Connection]:
    """All that is written inside, or nothing; the write lock is taken at once, so that nothing comes in between."""
    with db:
        db.execute("BEGIN IMMEDIATE")
        yield db


@contextmanager
def reading(path: FilePath) -> Iterator[sqlite3.Connection]:
    """A connection of its own, for as long as the block runs."""
    with errors_of(path), closing(connect(path)) as db:
        yield db


def opened(path: FilePath, names: Sequence[str] | None, run: str | None) -> tuple[str, ...]:
    """The names of the store at `path`, checked to be ours, whole and of that run; a missing one is made for a run."""
    if not path.exists() or path.stat().st_size == 0:
        if run is None:
            raise StoreError(f"{path}: there is no store; make one with TransitionStore(path, run='a label')")
        path.touch()
    with reading(path) as db:

        def value(query: str) -> Any:
            return db.execute(query).fetchone()[0]

        application, schema = value("PRAGMA application_id"), value("PRAGMA user_version")
        if not (application or schema or value("SELECT count(*) FROM sqlite_master")):  # also: killed in the making
            if run is None:
                raise StoreError(f"{path}: an empty file, not a transition store")
            if value("PRAGMA journal_mode = WAL") != "wal":
                raise StoreError(f"{path}: no write-ahead log on this file system; use a local disk")
            with transaction(db):
                for query in (f"PRAGMA application_id = {APPLICATION}", f"PRAGMA user_version = {SCHEMA}", *TABLES):
                    db.execute(query)
                columns = json.dumps(tuple(names or StateDescription().names))
                db.execute("INSERT OR IGNORE INTO meta VALUES ('names', ?)", (columns,))
        elif application != APPLICATION:
            raise StoreError(f"{path}: an SQLite file of another program, not a transition store")
        elif schema != SCHEMA:
            reason = "a newer steerkit wrote it, update yours" if schema > SCHEMA else "use a new file"
            raise StoreError(f"{path}: schema {schema}, expected {SCHEMA}: {reason}")
        elif (check := value("PRAGMA quick_check(1)")) != "ok":
            raise StoreError(f"{path}: damaged ({check}); use a copy, or a new file")
        kept = tuple(json.loads(value("SELECT value FROM meta WHERE key = 'names'")))
        if names is not None and tuple(names) != kept:
            other = f"holds the columns {', '.join(kept)}, expected {', '.join(names)}"
            raise StoreError(f"{path}: {other}; use a new file")
        if run is not None:
            with transaction(db):
                db.execute("INSERT OR IGNORE INTO run VALUES (?, ?)", (RUN, run))
        held = dict(db.execute("SELECT id, label FROM run"))
    if held != {RUN: run} and (run is not None or len(held) > 1):
        raise StoreError(f"{path}: holds the runs {[*held.values()]}, expected {run or 'one'}; use a new file")
    return kept


def checksum(episode: int, numbers: bytes) -> int:
    """CRC-32 of a row."""
    return zlib.crc32(numbers, episode & 0xFFFFFFFF)


PERIOD = 0.25
"""Time between two commits while rows come in [s]; at most this much, and one commit, is lost by a kill."""
PROMISE = 1.0
"""Age of an unwritten row from which the writer complains [s]."""


class TransitionStore(AbstractContextManager["TransitionStore"]):
    """Transitions of a run in a file, to append to while driving.

    path: the file. run: label of the run to append to; a missing file is created, that of the same run is continued.
    Without `run` the store is only read. names: the state's columns; checked against the file's (default for a new
    file: the standard six).

    A kill of the process loses the rows of the last second at most; everything older is there, and the file opens
    again. Any number of stores may read a file while one writes to it. Close it, or use it in a `with`.
    Raises StoreError for a file that is missing (without `run`), damaged, cut short, another program's, of a newer
    schema, of other names, or of another run.
    """

    def __init__(self, path: Path, *, run: str | None = None, names: Sequence[str] | None = None):
        self.path, self.run = FilePath(path), run
        self.names = opened(self.path, names, run)
        self._pack = struct.Struct(f"<{2 * len(self.names) + 2}d").pack
        self.writer: _Writer | None = None
        """What is `waiting` in it, and how many rows it has `committed`; None: the store is only read, or closed."""
        if run is not None:
            self.writer = _Writer(self.path)
            self._end = weakref.finalize(self, _Writer.end, self.writer)  # also when the program ends unclosed

    # ---- writing --------------------------------------------------------------------------------------------

    def append(self, s: Sequence[float], a: float, s_next: Sequence[float], episode: int, own: bool = True) -> None:
        """Record one transition; returns at once, whatever the disk does.

        s, s_next: the state's columns (SI); a: action [rad]; episode: its number; own: did the learner steer? All of
        it as `Transitions.append` takes it. Raises StoreError when the store is opened for reading or closed.
        """
        row = self._pack(*s, a, *s_next, own)
        self._writing().waiting.append((int(episode), row, checksum(int(episode), row)))

    def flush(self, timeout: float = 10.0) -> None:
        """Wait until all that was appended is on the disk; raises StoreError when it is not within `timeout` [s]."""
        self._writing().flush(timeout)

    def close(self, timeout: float = 10.0) -> None:
        """Write what is left and end; raises StoreError when that cannot be done within `timeout` [s]."""
        writer, self.writer = self.writer, None
        if writer is not None:
            try:
                writer.flush(timeout)
            finally:
                self._end()

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def fault(self) -> str:
        """Why the last commit did not succeed; empty when it did. The rows wait, and the writer tries again."""
        return self.writer.fault if self.writer else ""

    def _writing(self) -> "_Writer":
        if self.writer is None:
            raise StoreError(f"{self.path}: closed, or opened for reading; to append, open it with run='a label'")
        return self.writer

    # ---- reading --------------------------------------------------------------------------------------------

    def next_episode(self) -> int:
        """The first episode number that the run has not used: where to go on counting."""
        with reading(self.path) as db:
            (last,) = db.execute("SELECT max(episode) FROM transition").fetchone()
        return 0 if last is None else last + 1

    def transitions(self) -> Transitions:
        """All committed transitions in the order of recording; raises StoreError for damaged rows."""
        query = "SELECT episode, numbers, crc FROM transition WHERE run = ? ORDER BY n"
        with reading(self.path) as db:
            rows = db.execute(query, (RUN,)).fetchall()
        n = len(self.names)
        for number, (episode, numbers, crc) in enumerate(rows):
            if len(numbers) != 8 * (2 * n + 2) or checksum(episode, numbers) != crc:
                raise StoreError(f"{self.path}: transition {number} is damaged; use a copy")
        values = np.frombuffer(b"".join([row[1] for row in rows]), dtype="<f8").reshape(-1, 2 * n + 2)
        episode = np.array([row[0] for row in rows], dtype=int)
        return Transitions(self.names, values[:, :n], values[:, n], values[:, n + 1 : -1], episode, values[:, -1])


class _Writer(threading.Thread):
    """Commits what waits, every PERIOD; a database that is busy or broken makes the rows wait, never the loop."""

    def __init__(self, path: FilePath):
        super().__init__(name="steerkit store", daemon=True)
        self.path = path
        self.waiting: list[Row] = []
        self.committed, self.fault, self.ending = 0, "", False
        self._db: sqlite3.Connection | None = None  # of the thread
        self._wake, self._tried = threading.Event(), threading.Condition()
        self.start()

    def run(self) -> None:
        failing_since, warned, last = math.inf, False, False
        while not last:
            self._wake.wait(PERIOD)
            self._wake.clear()
            last = self.ending
            rows = self.waiting[:]
            try:
                if rows:
                    self._commit(rows)
                fault, failing_since, warned = "", math.inf, False
            except StoreError as why:
                fault, failing_since = str(why), min(failing_since, time.monotonic())
            with self._tried:
                if not fault:
                    del self.waiting[: len(rows)]  # others only append
                    self.committed += len(rows)
                self.fault = fault
                self._tried.notify_all()
            if time.monotonic() - failing_since > PROMISE and not warned:
                warned = True
                text = f"{self.path}: {len(rows)} transitions wait to be written: {fault}"
                warnings.warn(text, RuntimeWarning, stacklevel=1)
        self._disconnect()

    def _commit(self, rows: Sequence[Row]) -> None:
        try:
            with errors_of(self.path):
                self._db = self._db or connect(self.path, timeout=0.2)
                with transaction(self._db) as db:
                    query = "SELECT coalesce(max(n) + 1, 0) FROM transition WHERE run = ?"
                    (n,) = db.execute(query, (RUN,)).fetchone()
                    numbered = ((RUN, n + i, *row) for i, row in enumerate(rows))
                    db.executemany("INSERT INTO transition VALUES (?, ?, ?, ?, ?)", numbered)
        except StoreError:
            self._disconnect()
            raise

    def _disconnect(self) -> None:
        if self._db is not None:
            self._db.close()
            self._db = None

    def flush(self, timeout: float) -> None:
        with self._tried:
            goal = self.committed + len(self.waiting)
            self._wake.set()
            if not self._tried.wait_for(lambda: self.committed >= goal, timeout):
                left = goal - self.committed
                raise StoreError(f"{self.path}: {left} transitions are not written after {timeout:g} s: {self.fault}")

    def end(self) -> None:
        """One last attempt, and no more."""
        self.ending = True
        self._wake.set()
        self.join(5.0)
