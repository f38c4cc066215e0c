"""The circle and the car of a short drive."""

from steerkit.paths.courses import circle
from steerkit.vehicles import vehicle

PATH, PASSAT = circle(), vehicle("vw-passat")
