"""The command `steerkit courses`: what can be driven."""

from __future__ import annotations

import json
from typing import Any

from steerkit.cli.options import Machine

ALSO = {
    "random-7": "a random course by its seed: 500 m, radii of 10 m and more",
    "sweeping-7": "one with wide bends by its seed: 2 km, radii of 100 m and more",
    "FILE.csv": "a course of your own: columns x, y [m] or lat, lon [degrees]",
}
"""What else can be named, and what it is."""


def courses(as_json: Machine = False) -> None:
    """List the courses: the built-in ones, and what else can stand for a course's name."""
    from rich.console import Console
    from rich.table import Table

    from steerkit.courses import course, names

    rows: list[dict[str, Any]] = []
    for name in names():
        path = course(name)
        sharpest = float(abs(path.samples.kappa).max())
        radius = 1.0 / sharpest if sharpest > 1e-6 else None
        rows.append({"course": name, "length_m": path.length, "closed": path.closed, "tightest_radius_m": radius})
    if as_json:
        print(json.dumps({"courses": rows, "also": ALSO}))
        return
    table = Table("course", "length (m)", "closed", "tightest radius (m)")
    for name, length, closed, radius in (row.values() for row in rows):
        table.add_row(name, f"{length:.0f}", "yes" if closed else "no", f"{radius:.1f}" if radius else "straight")
    Console().print(table)
    for name, what in ALSO.items():
        print(f"{name:12s} {what}")
