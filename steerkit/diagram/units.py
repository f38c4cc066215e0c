"""The only place where degrees and kilometres an hour meet radians and metres a second."""

from __future__ import annotations

from typing import Any

RAD_PER_DEG = 0.017453292519943295

UNITS = frozenset(
    {
        "1",
        "rad",
        "rad/s",
        "rad/s^2",
        "m",
        "m/s",
        "m/s^2",
        "m/s^3",
        "rad s^2/m",
        "1/m",
        "1/(m s)",
        "s",
        "N",
        "N m",
        "kg",
        "kg m^2",
    }
)
"""The units a port may carry; "1" is a pure number, a flag or a count."""


def radians_of(angle_deg: Any) -> Any:
    """Radians of an angle in degrees (floats or arrays)."""
    return angle_deg * RAD_PER_DEG


def degrees_of(angle: Any) -> Any:
    """Degrees of an angle in radians (floats or arrays)."""
    return angle / RAD_PER_DEG
