"""Cars: their numbers, by name, drawn from a fleet, or from a file."""

import csv
import dataclasses
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np

from steerkit._support.errors import made_of, nearest, require, require_within
from steerkit._support.files import read_text, toml_of
from steerkit._support.random import seed_state, uniform
from steerkit.diagram.maths import Scalar
from steerkit.task import STOP

G = 9.81
"""Gravity [m/s^2], as CommonRoad has it."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A car as a single track: what the plants, the controllers and the model predictions need to know of it.

    Every number may be an `(N,)` array, for a batch of N different cars. L = l_f + l_r; at rest the axles carry
    F_zf = m g l_r/L and F_zr = m g l_f/L; the axle forces are c_f alpha_f and c_r alpha_r at small slip angles, with
    alpha_f = delta - beta - l_f r/v and alpha_r = -beta + l_r r/v. Raises ValueError for a number that no car has.
    """

    name: str
    """Name, for messages and plots."""
    m: Scalar
    """Mass [kg]."""
    i_z: Scalar
    """Yaw inertia [kg m^2]."""
    l_f: Scalar
    """Centre of gravity to front axle [m]."""
    l_r: Scalar
    """Centre of gravity to rear axle [m]."""
    c_f: Scalar
    """Cornering stiffness of the front axle, both wheels [N/rad], > 0."""
    c_r: Scalar
    """Cornering stiffness of the rear axle, both wheels [N/rad], > 0."""
    steer_ratio: Scalar
    """Steering-wheel angle over road-wheel angle [1]."""
    mu: Scalar = 1.0
    """Friction coefficient between tyres and road [1]."""
    delta_sw_max: float = STOP
    """Mechanical stop of the steering wheel, to either side [rad]."""

    def __post_init__(self) -> None:
        where = f"Vehicle '{self.name}'"
        for name, unit, low, high, hint in (
            ("m", "kg", 0.5, 1e5, ""),
            ("l_f", "m", 0.02, 20.0, ""),
            ("l_r", "m", 0.02, 20.0, ""),
            ("steer_ratio", "1", 1.0, 50.0, "a pure number, steering-wheel angle over road-wheel angle, such as 15.6"),
            ("mu", "1", 0.01, 3.0, "dry asphalt is about 1, ice 0.1"),
            ("delta_sw_max", "rad", 0.01, 30.0, "radians: radians_of(520)"),
        ):
            require_within(where, name, getattr(self, name), unit, low, high, hint)
        for name, share in (("c_f", self.l_r), ("c_r", self.l_f)):
            load = self.m * G * share / self.wheelbase
            hint = "2 to 100 times the axle's load; positive, per axle (both wheels), per radian and not per degree"
            require_within(where, name, getattr(self, name), "N/rad", 2.0 * load, 100.0 * load, hint)
        point = self.m * self.l_f * self.l_r
        require_within(where, "i_z", self.i_z, "kg m^2", 0.2 * point, 5.0 * point, "0.2 to 5 times m l_f l_r")

    @property
    def wheelbase(self) -> Scalar:
        """L = l_f + l_r [m]"""
        return self.l_f + self.l_r

    @property
    def tightest(self) -> Scalar:
        """Radius of the centre of gravity with the wheel at its stop, rolling: sqrt((L/tan delta_max)^2 + l_r^2) [m]"""
        return np.hypot(self.wheelbase / np.tan(np.minimum(self.delta_sw_max / self.steer_ratio, 1.5)), self.l_r)

    @property
    def understeer_gradient(self) -> Scalar:
        """K = m (c_r l_r - c_f l_f) / (c_f c_r L) [rad s^2/m]

        Steady driving needs delta = L kappa + K v^2 kappa; then r/delta = v/(L + K v^2). K > 0 understeers.
        Source: Rajamani 2012, section 3.3.
        """
        return self.m * (self.c_r * self.l_r - self.c_f * self.l_f) / (self.c_f * self.c_r * self.wheelbase)

    def wheel_per_a_y(self, v: Scalar) -> Scalar:
        """Steering-wheel angle over steady lateral acceleration at v > 0 [m/s]: i (L + K v^2)/v^2 [rad s^2/m].

        Source: Rajamani 2012, section 3.3.
        """
        return self.steer_ratio * (self.wheelbase + self.understeer_gradient * v * v) / (v * v)


def require_vehicle(vehicle: object, where: str) -> None:
    """Raise ValueError, in the name of `where`, unless this is a `Vehicle`: a name is none yet."""
    if not isinstance(vehicle, Vehicle):
        what = f"vehicle = {vehicle!r:.60}, expected a Vehicle; by name or from a file: vehicle('vw-passat')"
        raise ValueError(f"{where}: {what}")


def _commonroad(name: str, m: float, i_z: float, l_f: float, l_r: float) -> Vehicle:
    """A car of CommonRoad with c_f = mu C m g l_r/L, c_r = mu C m g l_f/L; mu C = 21.92, the tyre's p_ky1."""
    per_metre = 21.92 * m * G / (l_f + l_r)
    return Vehicle(
        name=name, m=m, i_z=i_z, l_f=l_f, l_r=l_r, c_f=per_metre * l_r, c_r=per_metre * l_f, mu=1.0489, steer_ratio=16.0
    )


def scaled(name: str, m: float, wheelbase: float, steer_ratio: float = 15.6, mu: float = 0.9) -> Vehicle:
    """A car scaled from a measured one (m 1462, L 2.7, l_f 0.4 L, c_f 192150, c_r 202500, i_z 2500), l_f = 0.45 L.

    m [kg], wheelbase [m]. For a car of which little more is known; the way of opendbc.
    """
    size = m / 1462.0
    return Vehicle(
        name=name,
        m=m,
        i_z=2500.0 * size * (wheelbase / 2.7) ** 2,
        l_f=0.45 * wheelbase,
        l_r=0.55 * wheelbase,
        c_f=192150.0 * size * (0.55 / 0.6),
        c_r=202500.0 * size * (0.45 / 0.4),
        mu=mu,
        steer_ratio=steer_ratio,
    )


VW_PASSAT = scaled("vw-passat", m=1503.0 + 136.0, wheelbase=2.71, steer_ratio=15.6, mu=0.9)
"""VW Passat (B6), the paper's car: no value of it was published; none of these is measured on it.

wheelbase 2.71 m: manufacturer. m = 1503 kg + 136 kg of load, steer_ratio 15.6, centre of gravity at 0.45 of the
wheelbase: opendbc, `car/volkswagen/values.py` (Passat NMS). c_f = 197 kN/rad, c_r = 255 kN/rad, i_z = 2824 kg m^2:
scaled by mass and wheelbase from another car, as opendbc does (`car/interfaces.py`, `scale_rot_inertia`,
`scale_tire_stiffness`). mu = 0.9: assumed, dry asphalt.
"""

BMW_320I = _commonroad("bmw-320i", m=1093.2952334674046, i_z=1791.5995300122856, l_f=1.1561957064, l_r=1.4227170936)
"""BMW 320i of CommonRoad (vehicle 2): Althoff, Wuersching 2020, table 6; tyre of table 7.

The steer_ratio of 16 is assumed (CommonRoad steers the road wheels); all other values are theirs.
"""

FORD_ESCORT = _commonroad("ford-escort", m=1225.8878467253344, i_z=1538.8533713561394, l_f=0.88392, l_r=1.50876)
"""Ford Escort of CommonRoad (vehicle 1): Althoff, Wuersching 2020, table 6; tyre of table 7.

The steer_ratio of 16 is assumed (CommonRoad steers the road wheels); all other values are theirs.
"""

VEHICLES = {car.name: car for car in (VW_PASSAT, BMW_320I, FORD_ESCORT)}
"""The named cars."""


FORMAT = "steerkit vehicle 1"
_REMARKS = {
    "vehicle": "  # SI and radians; cornering stiffness per axle",
    "steering": "  # from the command, or the recorded angle, to the road wheels: s, s, rad",
    "estimates": "  # 95 % intervals",
}


def vehicle_of(text: str, where: str) -> Vehicle:
    """The car in the text of a vehicle file; raises ValueError naming `where`, the key and what is valid."""
    table = table_of(text, "vehicle", where)
    odd = [key for key, value in table.items() if key != "name" and type(value) not in (int, float)]
    require(not odd, where, f"[vehicle] {', '.join(odd)}, expected numbers")
    made: Vehicle = made_of(Vehicle, table, f"{where}: [vehicle]")
    return made


def vehicle_text(car: Vehicle, **more: Mapping[str, Any] | None) -> str:
    """The text of a vehicle file; numbers come back bit for bit.

    more: its tables `steering` (delay, lag [s], offset [rad]), `estimates` (intervals by name) and `provenance`.
    """
    rows = [f"format = {json.dumps(FORMAT)}"]
    for name, table in ({"vehicle": dataclasses.asdict(car)} | more).items():
        if table:
            rows += ["", f"[{name}]{_REMARKS.get(name, '')}", *rows_of(table)]
    return "\n".join(rows) + "\n"


def rows_of(table: Mapping[str, Any]) -> list[str]:
    """A table in lines of TOML, without what is None."""
    return [f"{key} = {_value(value)}" for key, value in table.items() if value is not None]


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {_value(v)}' for key, v in value.items())} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str | bool):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(float(value))


def table_of(text: str, name: str, where: str) -> dict[str, Any]:
    """One table of a vehicle file; raises ValueError naming the file and what it lacks."""
    tables = tables_of(text, where)
    require(isinstance(tables.get(name), dict), where, f"no table [{name}]; it holds {', '.join(tables)}")
    return tables[name]


def tables_of(text: str, where: str) -> dict[str, Any]:
    """All that is in the text of a vehicle file; raises ValueError for another format."""
    data = toml_of(text, where)
    written = data.get("format")
    require(written == FORMAT, where, f"format = {written!r}, expected {FORMAT!r}: a file of `steerkit identify`")
    return data


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
