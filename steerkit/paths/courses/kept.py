"""Built-in courses kept on disk once they are made: fitting their splines anew loads SciPy, a third of a second."""

from __future__ import annotations

import contextlib
import functools
import hashlib
from collections.abc import Callable
from importlib.metadata import version
from importlib.resources import files

import numpy as np

from steerkit._support import native
from steerkit._support.files import read_npz, write_npz
from steerkit.diagram.maths import Table
from steerkit.paths.path import Path


def kept(name: str, make: Callable[[], Path]) -> Path:
    """The course `make()`, to the bit: from the file that an earlier process kept of it, else made and kept.

    The file is kept beside compiled loops (`steerkit._support.native.directory`); its name tells the state of all
    code and data that courses are made from, so that a changed one is made anew. One that is broken, or cannot be
    written, is only not used.
    """
    file = native.directory() / f"course-{name}-{_state()}.npz"
    with contextlib.suppress(OSError, ValueError, KeyError):
        stored = read_npz(file, "course")
        return Path(
            table=Table(stored["table"]), length=float(stored["length"]), closed=bool(stored["closed"]), name=name
        )
    path = make()
    if path.name == name and path.origin_deg is None:
        arrays = {"table": path.table.rows, "length": np.array(path.length), "closed": np.array(path.closed)}
        with contextlib.suppress(OSError):
            write_npz(file, arrays, durable=False)
    return path


@functools.cache
def _state() -> str:
    """A digest of what courses are made from."""
    digest = hashlib.sha256("\0".join((version("numpy"), version("scipy"))).encode())
    package = files("steerkit")
    made_by = [package / name for name in ("paths/path.py", "paths/waypoints.py", "diagram/maths.py")]
    courses = (file for file in (package / "paths" / "courses").iterdir() if file.is_file())
    for file in [*made_by, *sorted(courses, key=lambda file: file.name)]:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
