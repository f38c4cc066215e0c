"""The fleet: production cars by name, with the steering delay that their production software assumes."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType

from steerkit._support.random import seed_state, uniform
from steerkit.vehicles.parameters import Vehicle

MU = 0.9
"""Friction coefficient that every car of the fleet gets: assumed, dry asphalt."""
_STREAM = 21  # of `seed_state`: which car is drawn


@dataclass(frozen=True, kw_only=True)
class FleetCar:
    """A production car: its numbers, and what its interface for lane keeping does with a command."""

    vehicle: Vehicle
    """The car. Mass, wheelbase, l_f and ratio are its own; yaw inertia and stiffness are scaled from another car's;
    mu = 0.9 and stops at 520 degrees are assumed."""
    steer_delay: float
    """From a steering command to the car's answer, as production software assumes it [s]."""
    slowest: float
    """Slowest speed at which the maker's interface takes commands [m/s]; the models take them at any."""
    interface: str
    """`torque` or `angle`: what a command is to the maker's interface."""


@cache
def fleet() -> Mapping[str, FleetCar]:
    """The production cars by name, 243 of them, such as `toyota-rav4-prime`; read from the shipped table once.

    Source: commaai/opendbc 0.3.1, the car parameters of its interfaces (MIT, `LICENSE.opendbc` beside the table).
    """
    text = (files("steerkit.vehicles") / "fleet.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    cars = [_car(row) for row in rows]
    return MappingProxyType({car.vehicle.name: car for car in cars})


def drawn_car(number: int) -> FleetCar:
    """A car of the fleet drawn by its seed: the same number, the same car; all cars are equally likely.

    Raises ValueError unless the number is a whole one, >= 0.
    """
    u, _ = uniform(seed_state(number, stream=_STREAM))
    cars = list(fleet().values())
    return cars[int(u * len(cars))]


def _car(row: dict[str, str]) -> FleetCar:
    name, interface = row.pop("name").lower().replace("_", "-"), row.pop("interface")
    numbers = {key: float(value) for key, value in row.items()}
    wheelbase, steer_delay, slowest = (numbers.pop(key) for key in ("wheelbase", "steer_delay", "slowest"))
    vehicle = Vehicle(name=name, l_r=wheelbase - numbers["l_f"], mu=MU, **numbers)
    return FleetCar(vehicle=vehicle, steer_delay=steer_delay, slowest=slowest, interface=interface)
