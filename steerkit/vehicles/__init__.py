"""Cars: their numbers, by name or from a file."""

from __future__ import annotations

import difflib

from steerkit.vehicles.file import read_vehicle, vehicle_of
from steerkit.vehicles.named import BMW_320I, FORD_ESCORT, VEHICLES, VW_PASSAT, scaled
from steerkit.vehicles.parameters import G, Vehicle

__all__ = ["BMW_320I", "FORD_ESCORT", "VEHICLES", "VW_PASSAT", "G", "Vehicle", "scaled", "vehicle", "vehicle_of"]


def vehicle(name: str) -> Vehicle:
    """The car of that name, or in the vehicle file of that name (`.toml`, written by `steerkit identify`).

    Case does not matter, nor does `_` or a space for `-`. Raises ValueError otherwise, with the nearest name.
    """
    if name.endswith(".toml"):
        return read_vehicle(name)
    key = name.strip().lower().replace("_", "-").replace(" ", "-")
    if key not in VEHICLES:
        near = difflib.get_close_matches(key, VEHICLES, n=1, cutoff=0.4)
        hint = f" (did you mean '{near[0]}'?)" if near else ""
        raise ValueError(f"vehicle: '{name}' is not known{hint}; valid: {', '.join(VEHICLES)}, FILE.toml")
    return VEHICLES[key]
