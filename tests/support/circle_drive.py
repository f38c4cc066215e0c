"""The circle and the car of a short drive."""

from __future__ import annotations

from steerkit.paths.courses import circle
from steerkit.vehicles import vehicle

PATH, PASSAT = circle(), vehicle("vw-passat")
