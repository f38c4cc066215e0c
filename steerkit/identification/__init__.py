"""From a recorded drive to the model of the car: `read_drive`, `identify`, and the vehicle file that the plants load::

drive = read_drive("lap.mat", ColumnMap.load("lap.toml"))
found = identify(drive, base=vehicle("vw-passat"))
found.save("my-car.toml")            # vehicle("my-car.toml") is the car
tyres = identify_tyres(drive, vehicle("vw-passat"))   # Pacejka's
"""

from steerkit.identification.fit import identify
from steerkit.identification.tyres import identify_tyres
from steerkit.logs import Drive, read_drive, shipped_drives

__all__ = ["Drive", "identify", "identify_tyres", "read_drive", "shipped_drives"]
