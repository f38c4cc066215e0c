"""Which column of a recording is what, in which unit and sign: the column map."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from steerkit.errors import require
from steerkit.files import read_toml
from steerkit.units import RAD_PER_DEG

QUANTITIES = {"t": "s", "delta_sw": "rad", "v": "m/s", "r": "rad/s", "psi": "rad"}
"""What a drive is made of, in SI: time, steering-wheel angle, speed, yaw rate, heading (one of r and psi, or both)."""

UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {"rad": 1.0, "deg": RAD_PER_DEG},
    "m/s": {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1852.0 / 3600.0},
    "rad/s": {"rad/s": 1.0, "deg/s": RAD_PER_DEG, "mrad/s": 1e-3},
}
"""SI unit to the units that a column may have, and what one of them is in SI."""

_NAMES = {
    "t": ("t", "time", "timestamp", "time_s"),
    "delta_sw": (
        "delta_sw",
        "supervisor.delta_sw",
        "doe.delta_sw",
        "controller.delta_sw",
        "actuator.delta_sw",
        "car.delta_sw",
    ),
    "v": ("v", "sensors.v", "car.v"),
    "r": ("r", "wz", "yaw_rate", "sensors.r", "car.r"),
    "psi": ("psi", "sensors.psi", "car.psi"),
}
"""Names that need no map, best first; those with a dot are steerkit's own signals, the command before the angle."""


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
            require(quantity in QUANTITIES, where, f"'{quantity}' is no quantity{_near(quantity, QUANTITIES)}")
            given = {"column": entry} if isinstance(entry, str) else dict(entry) if isinstance(entry, dict) else {}
            known = ("column", "unit", "scale", "offset")
            bad = next((key for key in given if key not in known), "")
            require(not bad, where, f"{quantity}.{bad} is not known; valid: {', '.join(known)}")
            require("column" in given, where, f"{quantity} = {entry!r}; give a name or {{ column = ..., unit = ... }}")
            columns[quantity] = Column(
                str(given["column"]),
                str(given.get("unit", "")),
                float(given.get("scale", 1.0)),
                float(given.get("offset", 0.0)),
            )
            _factor(quantity, columns[quantity], where)
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

    def with_guesses(self, names: Iterable[str], *, where: str) -> ColumnMap:
        """This map, completed with columns of well-known names; raises ValueError when something needed is missing."""
        present = list(names)
        columns = dict(self.columns)
        for quantity, column in columns.items():
            require(
                column.name in present, where, f"no column '{column.name}' for {quantity}{_near(column.name, present)}"
            )
        for quantity, known in _NAMES.items():
            endings = ("", *(f"_{ending}" for ending in _ENDINGS))
            options = [name + ending for name in known for ending in endings if name + ending in present]
            if quantity not in columns and options:
                columns[quantity] = Column(options[0])
        missing = [name for name in ("t", "delta_sw", "v") if name not in columns]
        missing += [] if {"r", "psi"} & columns.keys() else ["r or psi"]
        require(
            not missing,
            where,
            f"which column is {', '.join(missing)}? Columns: {', '.join(present)}. Say so in a map, such as "
            'delta_sw = { column = "steering_angle", unit = "deg" }, or with --column delta_sw=steering_angle:deg',
        )
        return ColumnMap(columns)

    def in_si(self, columns: Mapping[str, Any], *, where: str) -> dict[str, Any]:
        """The mapped columns as arrays in SI units."""
        return {
            quantity: _factor(quantity, column, where) * columns[column.name] + column.offset
            for quantity, column in self.columns.items()
        }

    def told(self) -> str:
        """The map in words, for notes: which column was read as what."""
        return ", ".join(
            f"{quantity} = {f'{c.scale:g} * ' if c.scale != 1.0 else ''}{c.name} [{_unit(quantity, c)}]"
            for quantity, c in self.columns.items()
        )


_ENDINGS = {
    "deg": "deg",
    "deg_s": "deg/s",
    "degs": "deg/s",
    "kmh": "km/h",
    "kph": "km/h",
    "mph": "mph",
    "ms": "ms",
    "us": "us",
    "ns": "ns",
    "s": "s",
    "mps": "m/s",
    "rad": "rad",
    "rad_s": "rad/s",
}


def _unit(quantity: str, column: Column) -> str:
    if column.unit:
        return column.unit
    si = QUANTITIES[quantity]
    ends = [unit for ending, unit in _ENDINGS.items() if column.name.lower().endswith(f"_{ending}")]
    return next((unit for unit in ends if unit in UNITS[si]), si)


def _factor(quantity: str, column: Column, where: str) -> float:
    units, unit = UNITS[QUANTITIES[quantity]], _unit(quantity, column)
    require(unit in units, where, f"{quantity}: unit '{unit}' is not known; valid: {', '.join(units)}")
    require(column.scale != 0.0, where, f"{quantity}: scale = 0, expected another number")
    return column.scale * units[unit]


def _near(name: str, options: Iterable[str]) -> str:
    options = list(options)
    near = difflib.get_close_matches(name, options, n=1)
    hint = f" (did you mean '{near[0]}'?)" if near else ""
    return f"{hint}; valid: {', '.join(options)}"
