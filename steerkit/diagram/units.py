"""The only place where degrees and kilometres an hour meet radians and metres a second."""

import tomllib
from pathlib import Path
from typing import Any

RAD_PER_DEG = 0.017453292519943295

_TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
UNITS: frozenset[str] = frozenset(_TABLE["ports"])
"""The units a port may carry; "1" is a pure number, a flag or a count."""
FACTORS: dict[str, dict[str, float]] = _TABLE["factors"]
"""SI unit to the units that a file or a bus may give a quantity in, and what one of them is in SI."""


def radians_of(angle_deg: Any) -> Any:
    """Radians of an angle in degrees (floats or arrays)."""
    return angle_deg * RAD_PER_DEG


def degrees_of(angle: Any) -> Any:
    """Degrees of an angle in radians (floats or arrays)."""
    return angle / RAD_PER_DEG
