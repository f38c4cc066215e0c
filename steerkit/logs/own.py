"""The recording of a car server: frames decoded by the configuration that is in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from steerkit._support.errors import require
from steerkit.logs.channels import Options, Table

_KNOWN = {
    "delta_sw": ("delta_sw", "rad"),
    "v": ("v", "m/s"),
    "r": ("r", "rad/s"),
    "psi": ("psi", "rad"),
    "x": ("x", "m"),
    "y": ("y", "m"),
    "lat": ("lat_deg", "rad"),
    "lon": ("lon_deg", "rad"),
}
"""Name in the configuration to the quantity of a drive and the unit that it has there."""


def is_own(head: bytes) -> bool:
    """Do these first bytes of an .mcap begin a recording of a car server, or nothing that another program wrote?"""
    return b"steerkit" in head or not head.startswith(b"\x89MCAP0\r\n")


def read_own(path: Path, options: Options, notes: list[str]) -> list[Table]:
    """What the car's frames say of steering wheel, speed, yaw rate, heading and place, each on its own clock."""
    try:
        from steerkit.car import recording
    except ImportError:
        raise ValueError(f"{path}: MCAP needs the car's packages: pip install 'steerkit-control[car]'") from None
    recorded = recording.read(path)
    if not recorded.whole:
        notes.append(f"the recording is damaged or cut short, what is intact is used: {recorded.kept()}")
    config = recording.config_of(recorded)
    readers = {reader.frame_id: reader for reader in config.readers}
    counters: dict[int, int | None] = dict.fromkeys(readers)
    series: dict[str, list[tuple[float, float]]] = {}
    bad = 0
    for frame in recorded.of("/can/rx"):
        reader = readers.get(frame["id"])
        if reader is None:
            continue
        checked = reader.read(bytes.fromhex(frame["data"]), counters[frame["id"]])
        counters[frame["id"]] = checked.counter
        if checked.error or not all(np.isfinite(v) for v in checked.values.values()):
            bad += 1
            continue
        for name, value in checked.values.items():
            series.setdefault(name, []).append((min(frame["arrived"], frame["t"]), value))
    if bad:
        notes.append(f"left out {bad} frames that were broken or held no value")
    require(
        {"delta_sw", "v"} <= set(series), str(path), f"no steering angle or speed; read: {', '.join(series) or 'none'}"
    )
    tables = []
    for name, points in series.items():
        t, values = np.array(points).T
        quantity, unit = _KNOWN.get(name, ("", ""))
        means, units = ({name: quantity}, {name: unit}) if quantity else ({}, {})
        tables.append(Table(columns={name: values}, units=units, means=means, t=t))
    return tables
