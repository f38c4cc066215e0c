"""The transition store: what a car experienced, on disk within half a second, whole after any crash.

A file of rows of one length under a line of JSON. `append` only puts a row into memory; a thread of the store's own
appends to the file what has come in, four times a second, and waits for the disk: the thread can, the loop never does,
and a car's power is cut as often as a process is killed. What a crash leaves half written stands at the end, and its
checksum tells.
"""

from __future__ import annotations

import errno
import fcntl
import json
import math
import os
import struct
import threading
import time
import warnings
import weakref
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path as FilePath
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from steerkit._support.files import read_bytes, write_text
from steerkit.controllers.state_description import StateDescription
from steerkit.learning.data.transitions import Transitions

FORMAT = "steerkit transitions 4"
PERIOD = 0.25
"""Time between two commits while rows come in [s]; at most this much, and one commit, is lost by a kill."""
PROMISE = 1.0
"""Age of an unwritten row from which the writer complains [s]."""

TAIL = 200
"""Rows at the end that may be broken by a crash, and are left out; more are damage: 10 s."""


class StoreError(ValueError):
    """A store that cannot be used: damaged, foreign, of another format, run or other names, or not writable."""


class TransitionStore:
    """Transitions of a run in a file, to append to while driving.

    path: the file. run: label of the run to append to; a missing file is created, that of the same run is continued.
    Without `run` the store is only read. names: the state's columns; checked against the file's (default for a new
    file: the standard six).

    A kill of the process loses the rows of the last second at most; everything older is there, and the file opens
    again. Any number of stores may read a file while one writes to it. Close it, or use it in a `with`.
    Raises StoreError for a file that is missing (without `run`), damaged, another program's, of another format, of
    other names or another run, or that another store writes to.
    """

    def __init__(self, path: str | os.PathLike[str], *, run: str | None = None, names: Sequence[str] | None = None):
        self.path, self.run = FilePath(path), run
        if run is not None and not (self.path.exists() and self.path.stat().st_size):
            head = {"format": FORMAT, "run": run, "names": list(names or StateDescription().names)}
            write_text(self.path, json.dumps(head) + "\n")
        kept = self._head()
        self.names = tuple(kept["names"])
        same = names is None or tuple(names) == self.names
        self._require(same, f"holds the columns {', '.join(self.names)}, expected {', '.join(names or ())}")
        self._require(run in (None, kept["run"]), f"holds the run {kept['run']!r}, expected {run!r}")
        n = len(self.names)
        row = [("episode", "<i8"), ("s", "<f8", n), ("a", "<f8"), ("s_next", "<f8", n), ("own", "<f8")]
        self._kind, self._pack = np.dtype([("row", row), ("crc", "<u4")]), struct.Struct(f"<q{2 * n + 2}d").pack
        self.writer: _Writer | None = None
        """What is `waiting` in it, and how many rows it has `committed`; None: the store is only read, or closed."""
        if run is not None:
            self.writer = _Writer(self.path, lambda: self._begin + self._rows().nbytes)
            self._end = weakref.finalize(self, _Writer.end, self.writer)  # also when the program ends unclosed

    def _require(self, ok: bool, what: str) -> None:
        if not ok:
            raise StoreError(f"{self.path}: {what}; use a new file")

    def _head(self) -> dict[str, Any]:
        """What the file says of itself; where its rows begin is known then."""
        if not self.path.exists():
            raise StoreError(f"{self.path}: there is no store; make one with TransitionStore(path, run='a label')")
        line, end, _ = read_bytes(self.path).partition(b"\n")
        self._begin, self._seed = len(line) + len(end), zlib.crc32(line)
        try:
            head = json.loads(line)
            self._require(head["format"] == FORMAT, f"format {head['format']!r}, expected {FORMAT!r}")
            return {"run": str(head["run"]), "names": [str(name) for name in head["names"]]}
        except (ValueError, TypeError, KeyError) as why:
            if isinstance(why, StoreError):
                raise
            raise StoreError(f"{self.path}: damaged at its begin, or not a transition store; use a new file") from why

    def _rows(self) -> NDArray[Any]:
        """All rows, with their checksums; what a crash has left behind them is no row."""
        data, size = read_bytes(self.path)[self._begin :], self._kind.itemsize
        rows = np.frombuffer(data[: len(data) // size * size], self._kind)
        broken = (
            np.array([zlib.crc32(row.tobytes(), self._seed) for row in rows["row"]], dtype=np.uint32) != rows["crc"]
        )
        if not broken.any():
            return rows
        first = int(broken.argmax())
        if len(rows) - first > TAIL or not broken[first:].all():
            raise StoreError(f"{self.path}: transition {first} is damaged; use a copy")
        text = f"{self.path}: the last {len(rows) - first} transitions were not wholly written, and are left out"
        warnings.warn(text, RuntimeWarning, stacklevel=3)
        return rows[:first]

    # ---- writing --------------------------------------------------------------------------------------------

    def append(self, s: Sequence[float], a: float, s_next: Sequence[float], episode: int, own: bool = True) -> None:
        """Record one transition; returns at once, whatever the disk does.

        s, s_next: the state's columns (SI); a: action [rad]; episode: its number; own: did the
        learner steer? Raises ValueError for a wrong length or a non-finite number, StoreError when the store was opened
        for reading or closed.
        """
        n = len(self.names)
        if len(s) != n or len(s_next) != n:
            fault = f"s has {len(s)}, s_next has {len(s_next)} entries, expected {n}: {', '.join(self.names)}"
            raise ValueError(f"TransitionStore: {fault}")
        numbers = (*s, a, *s_next)
        if not all(map(math.isfinite, numbers)):
            columns = (*self.names, "a", *(f"{name}_next" for name in self.names))
            bad = next(f"{c} = {x}" for c, x in zip(columns, numbers) if not math.isfinite(x))
            raise ValueError(f"TransitionStore: {bad}, expected a finite number; end the episode before it")
        row = self._pack(episode, *numbers, own)
        self._writing().waiting.append(row + zlib.crc32(row, self._seed).to_bytes(4, "little"))

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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def fault(self) -> str:
        """Why the last commit did not succeed; empty when it did. The rows wait, and the writer tries again."""
        return self.writer.fault if self.writer else ""

    def _writing(self) -> _Writer:
        if self.writer is None:
            raise StoreError(f"{self.path}: closed, or opened for reading; to append, open it with run='a label'")
        return self.writer

    # ---- reading --------------------------------------------------------------------------------------------

    def next_episode(self) -> int:
        """The first episode number that the run has not used: where to go on counting."""
        return int(self.transitions().episode.max(initial=-1)) + 1

    def transitions(self) -> Transitions:
        """All committed transitions in the order of recording; raises StoreError for damaged rows."""
        rows = self._rows()["row"]
        return Transitions(self.names, *(rows[name] for name in ("s", "a", "s_next", "episode", "own")))


class _Writer(threading.Thread):
    """Commits what waits, every PERIOD; a disk that is full or gone makes the rows wait, never the loop."""

    def __init__(self, path: FilePath, size: Callable[[], int]):
        super().__init__(name="steerkit store", daemon=True)
        self.path, self.waiting, self.committed = path, list[bytes](), 0
        self.fault, self.ending = "", False
        try:
            self._file = open(path, "r+b", buffering=0)  # noqa: SIM115
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as why:
            busy = "another store writes to it" if isinstance(why, BlockingIOError) else why.strerror
            raise StoreError(f"{path}: {busy}; close that, or use a new file") from None
        self._size = size()
        self._file.truncate(self._size)
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
                    self._commit(b"".join(rows))
                fault, failing_since, warned = "", math.inf, False
            except OSError as why:
                fault, failing_since = f"{why.strerror}", min(failing_since, time.monotonic())
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
        self._file.close()

    def _commit(self, data: bytes) -> None:
        """Whole or, at the next attempt, anew in the same place."""
        self._file.seek(self._size)
        if self._file.write(data) != len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(self._file.fileno())
        self._size += len(data)

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
