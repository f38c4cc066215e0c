"""Which production cars can be steered through opendbc, as a table, and a car's file for one of them."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit._support.files import write_text
from steerkit.car.config import shipped
from steerkit.car.production.platforms import limits_of, listed, platform
from steerkit.vehicles import vehicle

AT = 15.0
"""Speed at which the table gives limits [m/s]."""


def rows() -> list[dict[str, Any]]:
    """A row for each platform, SI: name, maker, by, slowest [m/s], delay [s], the largest lateral acceleration [m/s^2]
    and its fastest change [m/s^3] at `AT`, and why it cannot be steered, or "". Raises ValueError without opendbc."""
    table = list[dict[str, Any]]()
    for found in listed().values():
        row = {"name": found.name, "maker": found.maker, "by": found.steered_by, "slowest": found.slowest}
        row |= {"delay": found.delay, "a_y": None, "jerk": None, "obstacle": found.obstacle}
        if not found.obstacle:
            car = vehicle(found.name.lower().replace("_", "-"))
            limits = limits_of(found, car)
            length = car.wheelbase + car.understeer_gradient * AT * AT
            per_wheel = AT * AT / (float(car.steer_ratio) * float(length))
            speeds, rates = np.reshape(limits.rates, (-1, 2)).T
            turning = float(np.interp(AT, speeds, rates)) if limits.rates else limits.rate_max
            row["a_y"] = min(limits.a_y_max, limits.delta_max * per_wheel)
            row["jerk"] = min(limits.jerk_max, turning * per_wheel)
        table.append(row)
    return table


def lines(those: Sequence[dict[str, Any]]) -> list[str]:
    """The table for people."""
    head = f"{'platform':36} {'by':10} {'from':>8} {'delay':>7} {'a_y':>10} {'a_y rate':>11}"
    text = [head]
    for row in those:
        start = f"{row['name']:36} {row['by']:10}"
        if row["obstacle"]:
            text.append(f"{start} not steered: {row['obstacle']}")
            continue
        text.append(
            f"{start} {row['slowest']:4.1f} m/s {row['delay']:5.2f} s {row['a_y']:4.1f} m/s^2 {row['jerk']:5.1f} m/s^3"
        )
    drives = sum(not row["obstacle"] for row in those)
    return [*text, f"{drives} of {len(those)} can be steered; a_y and its rate: at most, at {AT:g} m/s"]


def write(name: str, out: Path) -> None:
    """Write a car's file for that platform; raises ValueError for one that cannot be steered, or a file that exists."""
    require(bool(name), "--out", "expected the name of a platform too, such as TESLA_MODEL_3")
    found = platform(name)
    require(not out.exists(), f"{out}", "exists already; choose another name")
    text = shipped("production-car.toml").read_text(encoding="utf-8")
    write_text(out, re.sub(r'(?m)^opendbc = "\w+"', f'opendbc = "{found.name}"', text))
