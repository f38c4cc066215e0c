"""What a log's file holds, channels with clocks, and which of them are the quantities of a drive: the column map."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import known, require
from steerkit._support.files import read_toml
from steerkit.diagram.units import FACTORS, RAD_PER_DEG

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Channel:
    """One number over time, as the file has it."""

    name: str
    """`speed` of a table, `/vehicle/status.longitudinal_velocity` of a bag, `SPEED.SPEED` of a CAN log."""
    t: Array
    """When it was sampled, in the file's own time (n,) [s]."""
    values: Array
    """In the file's own unit (n,)."""
    unit: str = ""
    """As the file names it; empty where it does not."""
    means: str = ""
    """The quantity that it is, where the kind of message settles that: `delta` for an Autoware steering report."""

    @property
    def rate(self) -> float:
        """Samples a second, by the usual step; 0 for a single one [Hz]."""
        steps = np.diff(self.t)
        step = float(np.median(steps)) if len(steps) else 0.0
        return 1.0 / step if step > 0.0 else 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Table:
    """Columns that were sampled together: a CSV file, a topic, a CAN message, a channel group."""

    columns: Mapping[str, Array]
    """By name, all of one length."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Of those columns whose unit the file names."""
    means: Mapping[str, str] = field(default_factory=dict)
    """Of those columns whose quantity the kind of message settles."""
    t: Array | None = None
    """Their times (n,) [s]; None where one of the columns is the time."""


QUANTITIES = {
    "t": "s",
    "delta_sw": "rad",
    "delta": "rad",
    "v": "m/s",
    "r": "rad/s",
    "psi": "rad",
    "x": "m",
    "y": "m",
    "lat_deg": "deg",
    "lon_deg": "deg",
}
"""What a drive is made of: time, steering-wheel angle (or delta, the road wheels'), speed, yaw rate, heading (one of r
and psi, or both), and where it was, if the log knows."""

UNITS: dict[str, dict[str, float]] = {**FACTORS, "deg": {"deg": 1.0, "rad": 1.0 / RAD_PER_DEG}}
"""SI unit (degrees for a place on Earth) to the units that a column may have, and what one of them is in it."""

_SPELLINGS = {
    "s": "s sec seconds",
    "ms": "ms",
    "us": "us",
    "ns": "ns",
    "m": "m meter metre",
    "m/s": "mps m_s m/sec",
    "km/h": "kmh kph km/hr",
    "mph": "mph",
    "deg": "deg ° degree degrees grad",
    "deg/s": "deg_s degs dps °/s deg/sec degrees/s deg/second",
    "rad": "rad radian radians",
    "rad/s": "rad_s radps rads rad/sec",
}
_SPELT = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings.split()}
"""Units as files spell them, or as names end in them."""

_COMMANDS = "safety.delta_sw supervisor.delta_sw doe.delta_sw controller.delta_sw"
_KNOWN_AS = {
    "t": "t time timestamp timestamps stamp time_stamp elapsed_time log_time t_abs",
    "delta_sw": f"{_COMMANDS} delta_sw steering_wheel_angle steering_wheel steer_wheel_angle steering_angle "
    "steer_angle sw_angle str_ang lws_angle sas_angle",
    "delta": "delta steering_tire_angle steering_tyre_angle road_wheel_angle tire_angle df",
    "v": "v sensors.v car.v wheel_speeds.mean vehicle_speed longitudinal_velocity veh_spd v_ego speed velocity v_x vx "
    "linear.x",
    "r": "r wz yaw_rate sensors.r car.r yawrate heading_rate psi_dot yaw_dot w_z omega_z gyro_z angular.z "
    "angular_velocity.z",
    "psi": "psi sensors.psi car.psi orientation.yaw",
    "x": "x car.x position.x pos_x position_x",
    "y": "y car.y position.y pos_y position_y",
    "lat_deg": "lat latitude gps_lat gps_latitude",
    "lon_deg": "lon lng longitude gps_lon gps_longitude",
}
_NAMES = {quantity: tuple(names.split()) for quantity, names in _KNOWN_AS.items()}
"""Names that need no map, best first; those with a dot are the end of a longer one, or steerkit's own signals, the
command before the angle. Capitals, blanks and dashes do not count, nor does a unit at the end."""

_WISHES = ("cmd", "command", "desired", "target", "request", "setpoint", "control", "trajectory", "planning")
"""Words in the name of a topic or message that holds what was wanted, not what was."""


def is_command(name: str) -> bool:
    """Does a channel of that name hold what the steering was asked for, and not what the wheel did?"""
    own = any(words(name).endswith(command) for command in _COMMANDS.split())
    return own or any(word in re.split(r"[^a-z0-9]", words(name)) for word in _WISHES)


def candidates(quantity: str, channels: Mapping[str, Channel]) -> list[str]:
    """The channels that may be that quantity, best first: by kind of message, by name, then by rate."""
    ranked = [
        (rank, -channel.rate, k, name)
        for k, (name, channel) in enumerate(channels.items())
        if (rank := _rank(quantity, channel)) is not None
    ]
    return [name for *_, name in sorted(ranked)]


def is_time(name: str) -> bool:
    """Does a column of that name hold the time?"""
    return _place("t", name) is not None


def _rank(quantity: str, channel: Channel) -> int | None:
    place = _place(quantity, channel.name)
    if channel.means:
        place = -1 if channel.means == quantity else None
    if place is None or (channel.unit and not unit_of(quantity, channel)):
        return None
    own = words(channel.name) in _NAMES[quantity]
    wished = not own and any(word in re.split(r"[^a-z0-9]", words(channel.name)) for word in _WISHES)
    return place + 100 * wished


def _place(quantity: str, name: str) -> int | None:
    """Where in the list of known names this one stands: whole, or its last parts."""
    parts = re.split(r"[./]", words(name).strip("./"))
    tails = [".".join(parts[k:]) for k in range(len(parts))]
    units = [ending for ending, unit in _SPELT.items() if unit in UNITS[QUANTITIES[quantity]]]
    for place, name_there in enumerate(_NAMES[quantity]):
        whole = tails if len(name_there) > 1 else tails[:1]  # a letter alone is the end of many names
        if any(tail == name_there or tail in [f"{name_there}_{unit}" for unit in units] for tail in whole):
            return place
    return None


def words(name: str) -> str:
    """`SteeringWheelAngle`, `steering-wheel angle` and `STEERING_WHEEL_ANGLE` are one name."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return re.sub(r"[^0-9a-z./]+", "_", parted.lower()).strip("_")


def unit_of(quantity: str, channel: Channel) -> str:
    """The channel's unit as the table of units has it; empty where the file says none, or one of something else."""
    unit = channel.unit.strip()
    unit = _SPELT.get(unit.lower(), unit if unit in UNITS[QUANTITIES[quantity]] else unit.lower())
    return unit if unit in UNITS[QUANTITIES[quantity]] else ""


def ended_unit(quantity: str, name: str) -> str:
    """The unit that a name ends in, if it is one of that quantity; else empty."""
    lower, units = name.lower(), UNITS[QUANTITIES[quantity]] if quantity in QUANTITIES else {}
    ends = [unit for ending, unit in _SPELT.items() if lower.endswith(f"_{ending}")]
    return max((unit for unit in ends if unit in units), key=len, default="")


@dataclass(frozen=True)
class Column:
    """One column: value in SI = scale * (unit in SI) * number + offset."""

    name: str
    """Name in the file."""
    unit: str = ""
    """Unit in the file; empty for the SI unit, or for one that the name ends in: `speed_kmh`, `angle_deg`."""
    scale: float = 1.0
    """A factor: -1 where right is positive, the steering ratio where the file has road-wheel angles."""
    offset: float = 0.0
    """Added, in SI."""

    def unit_for(self, quantity: str) -> str:
        """The unit that is stated, or that the name ends in, or else the SI unit."""
        return self.unit or ended_unit(quantity, self.name) or QUANTITIES[quantity]

    def factor(self, quantity: str, where: str) -> float:
        """What a number of the column is in SI; raises ValueError for a unit of something else."""
        units, unit = UNITS[QUANTITIES[quantity]], self.unit_for(quantity)
        require(unit in units, where, f"{quantity}: unit '{unit}' is not known; valid: {', '.join(units)}")
        require(self.scale != 0.0, where, f"{quantity}: scale = 0, expected another number")
        return self.scale * units[unit]

    def in_si(self, quantity: str, values: Array, where: str) -> Array:
        """The column's values (n,) in SI."""
        factor = self.factor(quantity, where)
        return values if (factor, self.offset) == (1.0, 0.0) else factor * values + self.offset


@dataclass(frozen=True)
class ColumnMap:
    """Quantity to column; `ColumnMap.load(file)`, `ColumnMap.of(table)` or `guessed(names)` make one."""

    columns: Mapping[str, Column]

    @classmethod
    def load(cls, file: str | Path) -> ColumnMap:
        """A map from a TOML file with a table `[columns]`; raises ValueError saying what is wrong where."""
        data = read_toml(file, f"--map {file}")
        require("columns" in data, f"--map {file}", f"no table [columns]; it holds {', '.join(data) or 'nothing'}")
        return cls.of(data["columns"], where=f"--map {file}")

    @classmethod
    def of(cls, table: Mapping[str, Any], *, where: str = "column map") -> ColumnMap:
        """A map from `{quantity: name}` or `{quantity: {column, unit, scale, offset}}`."""
        columns = {}
        for quantity, entry in table.items():
            known(quantity, QUANTITIES, f"{where}: quantity")
            given = {"column": entry} if isinstance(entry, str) else dict(entry) if isinstance(entry, dict) else {}
            for key in given:
                known(key, ("column", "unit", "scale", "offset"), f"{where}: key of {quantity}")
            require("column" in given, where, f"{quantity} = {entry!r}; give a name or {{ column = ..., unit = ... }}")
            columns[quantity] = Column(
                str(given["column"]),
                str(given.get("unit", "")),
                float(given.get("scale", 1.0)),
                float(given.get("offset", 0.0)),
            )
            columns[quantity].factor(quantity, where)
        return cls(columns)

    @classmethod
    def parsed(cls, words: Iterable[str]) -> ColumnMap:
        """A map from words such as `delta_sw=steering_angle:deg` or `delta_sw=df:rad:15.87` (unit, then scale)."""
        table: dict[str, Any] = {}
        for word in words:
            quantity, sign, source = word.partition("=")
            name, *more = source.rsplit(":", 2) if source.count(":") >= 2 else source.split(":")
            require(sign and name, "--column", f"'{word}', expected QUANTITY=COLUMN[:UNIT[:SCALE]]")
            table[quantity] = {"column": name, "unit": more[0] if more else ""}
            if len(more) > 1:
                try:
                    table[quantity]["scale"] = float(more[1])
                except ValueError:
                    raise ValueError(f"--column: '{word}': scale '{more[1]}' is no number") from None
        return cls.of(table, where="--column")

    def with_guesses(self, channels: Mapping[str, Channel], *, where: str) -> ColumnMap:
        """This map, completed with channels of well-known names or kinds, each with the unit that the file names.

        Raises ValueError when something that a drive needs is missing.
        """
        given = {quantity: column for quantity, column in self.columns.items() if quantity != "t"}
        columns = {quantity: _found(quantity, column, channels, where) for quantity, column in given.items()}
        for quantity in QUANTITIES:
            options = candidates(quantity, channels)
            other = {"delta": "delta_sw", "delta_sw": "delta"}.get(quantity)
            if quantity not in ("t", *columns) and other not in columns and options:
                columns[quantity] = Column(options[0], unit_of(quantity, channels[options[0]]))
        for pair in (("x", "y"), ("lat_deg", "lon_deg")):
            if len(columns.keys() & set(pair)) == 1:
                columns.pop(*(columns.keys() & set(pair)))
        missing = [] if {"delta_sw", "delta"} & columns.keys() else ["delta_sw"]
        missing += [] if "v" in columns else ["v"]
        missing += [] if {"r", "psi"} & columns.keys() else ["r or psi"]
        require(
            not missing,
            where,
            f"which column is {', '.join(missing)}? Columns: {', '.join(channels)}. Say so in a map, such as "
            'delta_sw = { column = "steering_angle", unit = "deg" }, or with --column delta_sw=steering_angle:deg',
        )
        return ColumnMap(columns)

    def text(self) -> str:
        """The map in words, for notes: which column was read as what."""
        return ", ".join(
            f"{quantity} = {f'{c.scale:g} * ' if c.scale != 1.0 else ''}{c.name} [{c.unit_for(quantity)}]"
            for quantity, c in self.columns.items()
        )


def _found(quantity: str, column: Column, channels: Mapping[str, Channel], where: str) -> Column:
    """The column that a user named, under its full name, with the unit that it has."""
    name = column.name
    if name not in channels:
        bare = name.partition(" [")[0]
        ends = [full for full in channels if full == bare or full.endswith((f"/{name}", f".{name}"))]
        require(len(ends) < 2, where, f"'{name}' for {quantity} may be {' or '.join(ends)}; give the whole name")
        name = ends[0] if ends else known(name, channels, f"{where}: column for {quantity}")
    said = channels[name].unit
    unit = column.unit or unit_of(quantity, channels[name])
    if said and not unit:
        units = ", ".join(UNITS[QUANTITIES[quantity]])
        raise ValueError(f"{where}: {name} is in '{said}', and {quantity} may be in {units}; say unit in the map")
    return replace(column, name=name, unit=unit)
