"""A car's file with its course, on the file's bus or another: what every process of a car begins with.

It imports nothing of the learner, so that a car server is up soon and depends on little.
"""

from __future__ import annotations

import re
from typing import Any

from steerkit.car.config.config import CarConfig
from steerkit.car.config.reading import load
from steerkit.paths.courses import course
from steerkit.paths.path import Path


def loaded(config: str, channel: str = "") -> tuple[CarConfig, Path]:
    """A configuration, on another bus if `channel` says so, and its course."""
    loaded_config = load(config, bus=bus_of(channel))
    return loaded_config, course_of(loaded_config)


def bus_of(channel: str) -> dict[str, Any] | None:
    """The arguments of `can.Bus` for `INTERFACE:CHANNEL`, or for a serial device or socket:// of slcan; None for ""."""
    if not channel:
        return None
    other = re.fullmatch(r"([a-z_0-9]+):(?!//)(.+)", channel)
    if other:
        return {"interface": other[1], "channel": other[2]}
    return {"interface": "slcan", "channel": channel, "bitrate": 500000, "sleep_after_open": 0.0}


def course_of(config: CarConfig) -> Path:
    """The path that a configuration names; raises ValueError, saying where, for a name that is not known."""
    if "name" not in config.course:
        return config.course["path"]
    try:
        return course(config.course["name"])
    except ValueError as error:
        raise ValueError(f"{config.file}: [course] name: {error}") from error
