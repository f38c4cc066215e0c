"""Whose a run's directory is while a run is being learned in it: one process at a time writes there."""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path as FilePath

from steerkit._support.files import write_text

LOCK, HOLDER = ".lock", ".learner"
"""The lock, which ends with its process, however that ends; and a line that says whose it is."""


@contextmanager
def held(place: FilePath) -> Iterator[None]:
    """Hold a run's directory for learning in it; reading needs no such thing.

    place: an existing directory. Raises ValueError, naming the process, while another one learns there; a process that
    was killed holds nothing.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(place / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout as why:
        what = f"{place} is being learned by {holder(place)}"
        raise ValueError(f"learn: {what}; wait for its end, stop it, or choose another directory") from why
    try:
        write_text(place / HOLDER, this_process(), durable=False)
        yield
    finally:
        (place / HOLDER).unlink(missing_ok=True)
        lock.release()


def this_process() -> str:
    """The line that says whose something is: "process 4711 (steerkit learn) since 2026-11-22 09:00:00"."""
    command = shlex.join([FilePath(sys.argv[0]).name, *sys.argv[1:]])
    return f"process {os.getpid()} ({command}) since {time.strftime('%Y-%m-%d %H:%M:%S')}"


def holder(place: FilePath) -> str:
    """Who holds a directory, or held it last when it was killed."""
    try:
        return (place / HOLDER).read_text(encoding="utf-8")
    except OSError:
        return "another process"


def is_free(place: FilePath) -> bool:
    """Is there nothing in a directory but what `held` leaves there?"""
    return all(file.name in (LOCK, HOLDER) for file in place.iterdir())
