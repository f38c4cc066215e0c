"""Cars: their numbers, by name, drawn from a fleet, or from a file."""

import re

from steerkit._support.errors import nearest
from steerkit._support.files import read_text
from steerkit.vehicles.parameters import (
    BMW_320I,
    FORD_ESCORT,
    VEHICLES,
    VW_PASSAT,
    FleetCar,
    G,
    Vehicle,
    drawn_car,
    fleet,
    require_vehicle,
    scaled,
    vehicle_of,
)

__all__ = [
    "BMW_320I",
    "FORD_ESCORT",
    "VEHICLES",
    "VW_PASSAT",
    "FleetCar",
    "G",
    "Vehicle",
    "drawn_car",
    "fleet",
    "require_vehicle",
    "scaled",
    "vehicle",
    "vehicle_of",
]


def vehicle(name: str) -> Vehicle:
    """The car of that name, or in the vehicle file of that name (`.toml`, written by `steerkit identify`).

    name: one of `VEHICLES`; one of `fleet()`, such as `toyota-rav4-prime` (`steerkit vehicles` lists them); `fleet-17`
    and the like, a car of the fleet drawn by that seed. Case does not matter, nor does `_` or a space for `-`. Raises
    ValueError otherwise, with the nearest name.
    """
    if name.endswith(".toml"):
        return vehicle_of(read_text(name, "vehicle"), name)
    key = name.strip().lower().replace("_", "-").replace(" ", "-")
    if key in VEHICLES:
        return VEHICLES[key]
    if drawn := re.fullmatch(r"fleet-(\d{1,18})", key):
        return drawn_car(int(drawn[1])).vehicle
    if key not in fleet():
        hint = nearest(key, [*VEHICLES, *fleet()])
        valid = f"{', '.join(VEHICLES)}, a car of the fleet (steerkit vehicles), fleet-17, FILE.toml"
        raise ValueError(f"vehicle: '{name}' is not known{hint}; valid: {valid}")
    return fleet()[key].vehicle
