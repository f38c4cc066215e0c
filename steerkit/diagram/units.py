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

FACTORS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {"rad": 1.0, "deg": RAD_PER_DEG},
    "rad/s": {"rad/s": 1.0, "deg/s": RAD_PER_DEG, "mrad/s": 1e-3},
    "m": {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3},
    "m/s": {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1852.0 / 3600.0},
    "m/s^2": {"m/s^2": 1.0, "m/s2": 1.0, "g": 9.80665},
    "N m": {"N m": 1.0, "Nm": 1.0},
}
"""SI unit to the units that a file or a bus may give a quantity in, and what one of them is in SI."""


def radians_of(angle_deg: Any) -> Any:
    """Radians of an angle in degrees (floats or arrays)."""
    return angle_deg * RAD_PER_DEG


def degrees_of(angle: Any) -> Any:
    """Degrees of an angle in radians (floats or arrays)."""
    return angle / RAD_PER_DEG
