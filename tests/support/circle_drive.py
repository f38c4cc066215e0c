"""The circle and the car of a short drive."""

from __future__ import annotations

from steerkit.courses import circle
from steerkit.vehicles import vehicle

PATH, PASSAT = circle(), vehicle("vw-passat")
