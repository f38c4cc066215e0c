"""What a log's file holds, channels with clocks, and which of them are the quantities of a drive: the column map."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import known, require
from steerkit._support.files import read_toml
from steerkit._support.quantities import COMMANDS, NAMES, QUANTITIES, SPELT, UNITS, ended_unit, place, words

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
    """Columns that were sampled together, one of which is the time: a CSV file, say."""

    columns: Mapping[str, Array]
    """By name, all of one length."""
    units: Mapping[str, str]
    """Of those columns whose unit the file names."""


Contents = Table | list[Channel]
"""What a reader finds in a file. Channels that were sampled together (a topic, a CAN message) share their `t`."""


_WISHES = ("cmd", "command", "desired", "target", "request", "setpoint", "control", "trajectory", "planning")
"""Words in the name of a topic or message that holds what was wanted, not what was."""


def is_command(name: str) -> bool:
    """Does a channel of that name hold what the steering was asked for, and not what the wheel did?"""
    own = any(words(name).endswith(command) for command in COMMANDS.split())
    return own or any(word in re.split(r"[^a-z0-9]", words(name)) for word in _WISHES)


def candidates(quantity: str, channels: Mapping[str, Channel]) -> list[str]:
    """The channels that may be that quantity, best first: by kind of message, by name, then by rate."""
    ranked = [
        (rank, -channel.rate, k, name)
        for k, (name, channel) in enumerate(channels.items())
        if (rank := _rank(quantity, channel)) is not None
    ]
    return [name for *_, name in sorted(ranked)]


def _rank(quantity: str, channel: Channel) -> int | None:
    found = place(quantity, channel.name)
    if channel.means:
        found = -1 if channel.means == quantity else None
    if found is None or (channel.unit and not unit_of(quantity, channel)):
        return None
    own = words(channel.name) in NAMES[quantity]
    wished = not own and any(word in re.split(r"[^a-z0-9]", words(channel.name)) for word in _WISHES)
    return found + 100 * wished


def unit_of(quantity: str, channel: Channel) -> str:
    """The channel's unit as the table of units has it; empty where the file says none, or one of something else."""
    unit = channel.unit.strip()
    unit = SPELT.get(unit.lower(), unit if unit in UNITS[QUANTITIES[quantity]] else unit.lower())
    return unit if unit in UNITS[QUANTITIES[quantity]] else ""


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
    def load(cls, file: str | Path) -> "ColumnMap":
        """A map from a TOML file with a table `[columns]`; raises ValueError saying what is wrong where."""
        data = read_toml(file, f"--map {file}")
        require("columns" in data, f"--map {file}", f"no table [columns]; it holds {', '.join(data) or 'nothing'}")
        return cls.of(data["columns"], where=f"--map {file}")

    @classmethod
    def of(cls, table: Mapping[str, Any], *, where: str = "column map") -> "ColumnMap":
        """A map from `{quantity: name}` or `{quantity: {column, unit, scale, offset}}`."""
        columns = {}
        for quantity, entry in table.items():
            known(quantity, QUANTITIES, f"{where}: quantity")
            given = {"column": entry} if isinstance(entry, str) else dict(entry) if isinstance(entry, dict) else {}
            for key in given:
                known(key, ("column", "unit", "scale", "offset"), f"{where}: key of {quantity}")
            require("column" in given, where, f"{quantity} = {entry!r}; give a name or {{ column = ..., unit = ... }}")
            unit, scale, offset = given.get("unit", ""), given.get("scale", 1.0), given.get("offset", 0.0)
            columns[quantity] = Column(str(given["column"]), str(unit), float(scale), float(offset))
            columns[quantity].factor(quantity, where)
        return cls(columns)

    @classmethod
    def parsed(cls, words: Iterable[str]) -> "ColumnMap":
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

    def with_guesses(self, channels: Mapping[str, Channel], *, where: str) -> "ColumnMap":
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
        which = f"which column is {', '.join(missing)}? Columns: {', '.join(channels)}. Say so in a map, such as "
        cure = 'delta_sw = { column = "steering_angle", unit = "deg" }, or with --column delta_sw=steering_angle:deg'
        require(not missing, where, which + cure)
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
