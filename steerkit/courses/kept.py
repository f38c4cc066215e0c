"""Built-in courses kept on disk once they are made: fitting their splines anew loads SciPy, a third of a second."""

from __future__ import annotations

import contextlib
import functools
import hashlib
from collections.abc import Callable
from importlib.metadata import version
from importlib.resources import files

import numpy as np

from steerkit import native
from steerkit.files import read_npz, write_npz
from steerkit.maths import Table
from steerkit.path import Path


def kept(name: str, make: Callable[[], Path]) -> Path:
    """The course `make()`, to the bit: from the file that an earlier process kept of it, else made and kept.

    The file stands beside the compiled loops (`steerkit.native.directory`); its name tells the state of all code and
    data that courses are made from, so that a changed one is made anew. One that is broken, or cannot be written, is
    only not used.
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
    here = sorted((file for file in (package / "courses").iterdir() if file.is_file()), key=lambda file: file.name)
    for file in [package / "path.py", package / "waypoints.py", package / "maths.py", *here]:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
