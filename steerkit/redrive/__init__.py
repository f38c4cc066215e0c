"""A recorded drive, driven again in simulation by another controller: where would it have steered otherwise::

drive = read_drive("genesis")
again = redrive(drive, "mpc", car=Steered.of(vehicle("my-car.toml")))
print(again.figures())
"""

from __future__ import annotations

from steerkit.redrive.again import Redriven, Steered, redrive

__all__ = ["Redriven", "Steered", "redrive"]
