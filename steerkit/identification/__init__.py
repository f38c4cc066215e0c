"""From a recorded drive to the model of the car: `read_drive`, `identify`, and the vehicle file that the plants load::

drive = read_drive("lap.mat", ColumnMap.load("lap.toml"))
found = identify(drive, base=vehicle("vw-passat"))
found.save("my-car.toml")            # vehicle("my-car.toml") is the car
"""

from __future__ import annotations

from steerkit.identification.estimate import Estimate, Identified, Prediction
from steerkit.identification.fit import identify
from steerkit.logs import Column, ColumnMap, Drive, read_drive, shipped_drives

__all__ = [
    "Column",
    "ColumnMap",
    "Drive",
    "Estimate",
    "Identified",
    "Prediction",
    "identify",
    "read_drive",
    "shipped_drives",
]
