"""Which column of a recording is what, in which unit and sign: the column map."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from steerkit._support.errors import require
from steerkit._support.files import read_toml
from steerkit.logs.channels import Channel
from steerkit.logs.names import QUANTITIES, UNITS, candidates, ended_unit, told_unit


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

    def with_guesses(self, channels: Mapping[str, Channel], *, where: str) -> ColumnMap:
        """This map, completed with channels of well-known names or kinds, each with the unit that the file tells.

        Raises ValueError when something that a drive needs is missing.
        """
        given = {quantity: column for quantity, column in self.columns.items() if quantity != "t"}
        columns = {quantity: _found(quantity, column, channels, where) for quantity, column in given.items()}
        for quantity in QUANTITIES:
            options = candidates(quantity, channels)
            other = {"delta": "delta_sw", "delta_sw": "delta"}.get(quantity)
            if quantity not in ("t", *columns) and other not in columns and options:
                columns[quantity] = Column(options[0], told_unit(quantity, channels[options[0]]))
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

    def in_si(self, columns: Mapping[str, Any], *, where: str) -> dict[str, Any]:
        """The mapped columns as arrays in SI units."""
        values = {}
        for quantity, column in self.columns.items():
            factor, number = _factor(quantity, column, where), columns[column.name]
            values[quantity] = number if (factor, column.offset) == (1.0, 0.0) else factor * number + column.offset
        return values

    def told(self) -> str:
        """The map in words, for notes: which column was read as what."""
        return ", ".join(
            f"{quantity} = {f'{c.scale:g} * ' if c.scale != 1.0 else ''}{c.name} [{_unit(quantity, c)}]"
            for quantity, c in self.columns.items()
        )


def _found(quantity: str, column: Column, channels: Mapping[str, Channel], where: str) -> Column:
    """The column that a user named, under its full name, with the unit that it has."""
    name = column.name
    if name not in channels:
        bare = name.partition(" [")[0]
        ends = [full for full in channels if full == bare or full.endswith((f"/{name}", f".{name}"))]
        require(len(ends) < 2, where, f"'{name}' for {quantity} may be {' or '.join(ends)}; give the whole name")
        require(len(ends) == 1, where, f"no column '{name}' for {quantity}{_near(name, channels)}")
        name = ends[0]
    said = channels[name].unit
    unit = column.unit or told_unit(quantity, channels[name])
    if said and not unit:
        units = ", ".join(UNITS[QUANTITIES[quantity]])
        raise ValueError(f"{where}: {name} is in '{said}', and {quantity} may be in {units}; say unit in the map")
    return replace(column, name=name, unit=unit)


def _unit(quantity: str, column: Column) -> str:
    return column.unit or ended_unit(quantity, column.name) or QUANTITIES[quantity]


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
