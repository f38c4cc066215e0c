"""Built-in courses by name, courses from files, and courses by formula.

`course(name)` gives one of `names()`, or that of a file; `circle`, `straight`,
`figure_eight`, `random_course`, `bends`, `lane_change`, `slalom` and `curvature_step` make others.
"""

import contextlib
import functools
import hashlib
from collections.abc import Callable
from functools import cache, partial
from importlib.metadata import version
from importlib.resources import files

import numpy as np

from steerkit._support import native
from steerkit._support.errors import known
from steerkit._support.files import read_npz, write_npz
from steerkit.diagram.maths import Array, Table
from steerkit.paths.courses.shapes import bends as bends
from steerkit.paths.courses.shapes import circle as circle
from steerkit.paths.courses.shapes import curvature_step as curvature_step
from steerkit.paths.courses.shapes import figure_eight as figure_eight
from steerkit.paths.courses.shapes import lane_change as lane_change
from steerkit.paths.courses.shapes import paper
from steerkit.paths.courses.shapes import random_course as random_course
from steerkit.paths.courses.shapes import slalom as slalom
from steerkit.paths.courses.shapes import straight as straight
from steerkit.paths.path import Path
from steerkit.paths.waypoints import read_columns


def names() -> tuple[str, ...]:
    """The names that `course` knows."""
    return tuple(_COURSES)


def course(name: str) -> Path:
    """The built-in course called `name`, made once, since paths are immutable; or that of a file: see `read_course`.

    * paper: closed, 795 m, like the course of the NFQ steering experiments (`shapes.paper`);
    * genesis: a recorded real lap, 3.7 km, bends down to 24 m, open: it ends 102 m short of its start;
    * genesis-rfs: a shorter drive, 477 m with one right bend down to 18 m, open;
    * iso3888-1, iso3888-2: lane changes for 9 m/s and 3 m/s^2 (`manoeuvres.lane_change`), open;
    * calibration: a figure of eight, 100 m by 35 m, bends down to 17 m, for `steerkit car calibrate`;
    * highway: closed, 6 km, bends down to 400 m, for speeds of 12 to 30 m/s;
    * bends-250: closed, two straights of 300 m and two bends of 250 m, for lane keeping at 80 km/h;
    * circle, straight, figure-eight, slalom, curvature-step: the formulas with their default sizes.

    Raises ValueError for another name, with the nearest one, and for a file of which no course can be made.
    """
    if name not in _COURSES:
        from steerkit.paths.importers.reading import KINDS, is_file, read_course  # a car's server does without

        if is_file(name):
            return read_course(name).path
        known(name, _COURSES, "course", also=f"FILE{', '.join(KINDS)}")
    return _built_in(name)


@cache
def _built_in(name: str) -> Path:
    return kept(name, _COURSES[name])


def recorded_speed(name: str) -> tuple[Array, Array]:
    """The speed that was driven on a recorded course: s (n,) [m] along `course(name)` and v (n,) [m/s].

    Raises ValueError unless it is one of the recorded courses.
    """
    v = _columns(_RECORDED[known(name, _RECORDED, "recorded course")])["v"]
    return np.linspace(0.0, course(name).length, len(v)), v  # the rows are evenly spaced


def _recorded(name: str) -> Path:
    columns = _columns(_RECORDED[name])
    return Path.from_waypoints(np.column_stack((columns["x"], columns["y"])), closed=False, name=name)


def _columns(file: str) -> dict[str, Array]:
    return read_columns((files(__name__) / file).read_text(encoding="utf-8"), file)


_RECORDED = {"genesis": "genesis.csv", "genesis-rfs": "genesis_rfs.csv"}
_COURSES: dict[str, Callable[[], Path]] = {
    "paper": paper,
    **{name: partial(_recorded, name) for name in _RECORDED},
    "highway": partial(random_course, 3, length=6000.0, max_kappa=0.0025, name="highway"),
    "bends-250": partial(bends, [(300.0, 180.0, 250.0, 66.0)] * 2, name="bends-250"),
    "circle": circle,
    "straight": straight,
    "figure-eight": figure_eight,
    "calibration": partial(figure_eight, 100.0, name="calibration"),
    "iso3888-1": partial(lane_change, 1),
    "iso3888-2": partial(lane_change, 2),
    "slalom": slalom,
    "curvature-step": curvature_step,
}


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
