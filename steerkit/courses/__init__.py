"""Built-in courses by name, and courses by formula.

`course(name)` gives one of `names()`; `circle`, `straight`, `figure_eight`, `random_course`, `bends`, `lane_change`,
`slalom` and `curvature_step` make others.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from functools import cache, partial
from importlib.resources import files
from typing import TypeVar

import numpy as np

from steerkit.courses.manoeuvres import curvature_step, lane_change, slalom
from steerkit.courses.shapes import bends, circle, figure_eight, paper, random_course, straight
from steerkit.path import Array, Path, read_columns

_T = TypeVar("_T")

__all__ = [
    "bends",
    "circle",
    "course",
    "curvature_step",
    "figure_eight",
    "lane_change",
    "names",
    "random_course",
    "recorded_speed",
    "slalom",
    "straight",
]


def names() -> tuple[str, ...]:
    """The names that `course` knows."""
    return tuple(_COURSES)


@cache
def course(name: str) -> Path:
    """The built-in course called `name`; made once, since paths are immutable.

    * paper: closed, 795 m, like the course of the NFQ steering experiments (`shapes.paper`);
    * genesis: a recorded real lap, 3.7 km, bends down to 24 m, open: it ends 102 m short of its start;
    * genesis-rfs: a shorter drive, 477 m with one right bend down to 18 m, open;
    * iso3888-1, iso3888-2: lane changes for 9 m/s and 3 m/s^2 (`manoeuvres.lane_change`), open;
    * circle, straight, figure-eight, slalom, curvature-step: the formulas with their default sizes.

    Raises ValueError for another name, with the nearest one.
    """
    return _known(name, _COURSES)()


def recorded_speed(name: str) -> tuple[Array, Array]:
    """The speed that was driven on a recorded course: s (n,) [m] along `course(name)` and v (n,) [m/s].

    Raises ValueError unless it is one of the recorded courses.
    """
    v = _columns(_known(name, _RECORDED))["v"]
    return np.linspace(0.0, course(name).length, len(v)), v  # the rows are evenly spaced


def _recorded(name: str) -> Path:
    columns = _columns(_RECORDED[name])
    xy = [*zip(columns["x"], columns["y"])]
    return Path.from_waypoints(xy, closed=False, name=name)


def _columns(file: str) -> dict[str, Array]:
    return read_columns((files(__name__) / file).read_text(encoding="utf-8"), file)


def _known(name: str, table: dict[str, _T]) -> _T:
    if name not in table:
        near = difflib.get_close_matches(name, table, n=1, cutoff=0.4)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        raise ValueError(f"course: {name!r} is not known{hint} (valid: {', '.join(table)})")
    return table[name]


_RECORDED = {"genesis": "genesis.csv", "genesis-rfs": "genesis_rfs.csv"}
_COURSES: dict[str, Callable[[], Path]] = {
    "paper": paper,
    **{name: partial(_recorded, name) for name in _RECORDED},
    "circle": circle,
    "straight": straight,
    "figure-eight": figure_eight,
    "iso3888-1": partial(lane_change, 1),
    "iso3888-2": partial(lane_change, 2),
    "slalom": slalom,
    "curvature-step": curvature_step,
}
