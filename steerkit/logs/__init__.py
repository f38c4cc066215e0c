"""Logs of any program: what is in them (`read_log`), and the drive that they hold (`read_drive`)."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit._support.files import LARGEST, opened, refuse_workbook
from steerkit._support.quantities import place
from steerkit.logs import can_frames, ros, tables
from steerkit.logs.channels import Channel, Column, ColumnMap, Contents, Table, is_command
from steerkit.logs.drive import ODD, Drive, aligned, in_metres, odd_values

__all__ = ["Channel", "Column", "ColumnMap", "Drive", "RawLog", "drive_of", "read_drive", "read_log", "shipped_drives"]


_DAY = 86400.0
"""[s]"""
_SPARSE = 0.75
"""A column of a table that is empty in more rows than these leave has rows of its own."""
_DRIVES = Path(__file__).parent / "drives"
_SHIPPED = {"genesis": _DRIVES / "genesis.csv.gz", "genesis-rfs": _DRIVES / "genesis_rfs.csv.gz"}

STEER_RATIO = 15.0
"""Steering-wheel angle over the road wheels' where a log has only these, and no ratio is given."""


def shipped_drives() -> tuple[str, ...]:
    """Names of the recorded drives that come with steerkit: those of the courses `genesis` and `genesis-rfs`."""
    return tuple(_SHIPPED)


@dataclass(frozen=True, eq=False, kw_only=True)
class RawLog:
    """The channels of one or more files, each on its own clock; `read_log` makes one."""

    name: str
    """Of the files, for messages."""
    where: str
    """The files with their folders, for errors."""
    channels: Mapping[str, Channel]
    """By name; `FILE/NAME` where two files have one of the same name."""
    notes: tuple[str, ...]
    """What was repaired in which file, in words."""
    digest: str
    """SHA-256 of the file; of the digests of several."""


Files = str | Path | Iterable[str | Path]


def read_log(files: Files, *, dbc: str | Path | Iterable[str | Path] = (), time: Column | None = None) -> RawLog:
    """Everything that is in one or more files of a log, as channels.

    files: see docs/logs.md. dbc: files, or names of the package opendbc, that say what is in CAN frames. time: which
    column of a table is the time (default: one of a well-known name). Raises ValueError, saying what to do, for a
    file that is not there, broken, or of another kind.
    """
    databases = tuple(str(one) for one in _many(dbc))
    paths = [Path(file) for file in _many(files)]
    paths = [path if path.exists() else _SHIPPED.get(str(path), path) for path in paths]
    require(paths, "read_log", "no files, expected one or more")
    found, notes, digests = list[tuple[Path, Channel]](), list[str](), list[str]()
    for path in paths:
        made = list[str]()
        digests.append(_digest(path))
        held = _contents(path, databases, made)
        of_file = _channels(held, time, str(path)) if isinstance(held, Table) else held
        found += [(path, channel) for channel in of_file]
        notes += [note if len(paths) == 1 else f"{path.name}: {note}" for note in made]
    names = Counter(channel.name for _, channel in found)
    channels: dict[str, Channel] = {}
    for path, channel in found:
        alone = names[channel.name] == 1 or len(paths) == 1
        name = again = channel.name if alone else f"{path.name}/{channel.name}"
        count = 2
        while again in channels:
            again, count = f"{name} #{count}", count + 1
        channels[again] = replace(channel, name=again)
    return RawLog(
        name=", ".join(path.name for path in paths),
        where=", ".join(map(str, paths)),
        channels=channels,
        notes=tuple(notes),
        digest=_of_all(digests),
    )


def read_drive(
    file: Files,
    columns: ColumnMap | Mapping[str, Any] | None = None,
    *,
    dbc: str | Path | Iterable[str | Path] = (),
    steer_ratio: float | None = None,
    dt: float | None = None,
    trusted: bool = False,
) -> Drive:
    """A recorded drive from a file, from several of one clock, or a shipped one by name.

    file: see `read_log`. columns: which channel is what (default: those of well-known names and kinds). dbc: what is
    in CAN frames. steer_ratio: of the car, for logs that have the road wheels' angle only (default: 15, with a note).
    dt, trusted: see `Drive.of`. Raises ValueError, saying what to do, for a file that is not there, broken, of
    another kind, lacks a quantity or holds nonsense; what could be repaired is in the drive's `notes`.
    """
    paths = [str(one) for one in _many(file)]
    given = columns if isinstance(columns, ColumnMap) else ColumnMap.of(columns or {})
    time = given.columns.get("t")  # nothing here holds the log, so that `drive_of` can let go of it
    return drive_of(read_log(paths, dbc=dbc, time=time), given, steer_ratio=steer_ratio, dt=dt, trusted=trusted)


def drive_of(
    log: RawLog, columns: ColumnMap, *, steer_ratio: float | None = None, dt: float | None = None, trusted: bool = False
) -> Drive:
    """The drive in a log that was read: see `read_drive`."""
    where = log.where
    used = columns.with_guesses(log.channels, where=where)
    clock = columns.columns.get("t")
    read = f"read {', '.join(([f't = {clock.name}'] if clock else []) + [used.text()])}"
    notes = [read, *log.notes]
    values = {quantity: c.in_si(quantity, log.channels[c.name].values, where) for quantity, c in used.columns.items()}
    times = {quantity: log.channels[column.name].t for quantity, column in used.columns.items()}
    name, digest = log.name, log.digest
    del log  # a long one may be larger than its drive
    notes += odd_values({quantity: values[quantity] for quantity in ODD if quantity in values}, times)
    if "delta" in values and "delta_sw" not in values:
        ratio = STEER_RATIO if steer_ratio is None else steer_ratio
        require(0.0 < ratio < 100.0, where, f"steer_ratio = {ratio:g}, expected more than 0, such as 15")
        values["delta_sw"], times["delta_sw"] = ratio * values.pop("delta"), times.pop("delta")
        kind = "not known: say steer_ratio" if steer_ratio is None else "as given"
        notes.append(f"delta_sw = {ratio:g} * the road wheels' angle: the log has no other; the ratio is {kind}")
    if {"lat_deg", "lon_deg"} <= values.keys():
        in_metres(values, times, notes)
    commanded = "delta_sw" in used.columns and is_command(used.columns["delta_sw"].name)
    return Drive.of(
        aligned(values, times, where, notes),
        name=name,
        dt=dt,
        trusted=trusted,
        notes=notes,
        digest=digest,
        commanded=commanded,
    )


def _many(files: Any) -> list[Any]:
    return [files] if isinstance(files, str | Path) else list(files)


def _contents(path: Path, dbc: tuple[str, ...], notes: list[str]) -> Contents:
    kind = "".join(path.suffixes[-2:]).lower() if path.suffix.lower() == ".gz" else path.suffix.lower()
    refuse_workbook(path)
    if not (kind in _READERS or path.is_dir()):
        known = f"{', '.join(_READERS)}, a drive that ships ({', '.join(_SHIPPED)})"
        raise ValueError(f"{path}: no recording; expected a file that ends in {known}, or a ROS 2 bag's folder")
    require(path.is_dir() or path.stat().st_size, str(path), "the file is empty")
    try:
        return (ros.read_ros if path.is_dir() else _READERS[kind])(path, dbc, notes)
    except ValueError:
        raise
    except Exception as error:  # of a library that did not expect these bytes
        raise ValueError(f"{path}: broken, or not what its name says ({type(error).__name__}: {error})") from error


def _digest(path: Path) -> str:
    """SHA-256 of a file, or of the digests of the files of a folder in the order of their names."""
    try:
        if path.is_dir():
            return _of_all([_digest(file) for file in sorted(path.iterdir()) if file.is_file()])
        with opened(path, 64 * LARGEST) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from error


def _of_all(digests: list[str]) -> str:
    return digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()


def _channels(table: Table, time: Column | None, where: str) -> Iterable[Channel]:
    clock = _clock(table, time, where)
    column = Column(clock) if time is None or time.name != clock else time
    column = replace(column, unit=column.unit or table.units.get(clock, ""))
    t = column.in_si("t", table.columns[clock], where)
    if np.nanmin(t, initial=0.0) >= 0.0 and np.nanmax(t, initial=0.0) < _DAY:  # of the clock, maybe past midnight
        t = t + _DAY * np.cumsum(np.diff(t, prepend=t[:1]) < -0.5 * _DAY)
    rises = bool((t[np.isfinite(t)] != t[np.isfinite(t)][:1]).any())
    require(rises, where, f"column {clock} holds no times that rise, expected numbers or 2026-11-26T10:00:00.5")
    for name, values in table.columns.items():
        if name != clock:
            numbers = np.asarray(values, dtype=float)
            known = np.isfinite(numbers)
            own = 0.0 < known.mean() < _SPARSE  # signals on rows of their own
            at, numbers = (t[known], numbers[known]) if own else (t, numbers)
            yield Channel(name=name, t=at, values=numbers, unit=table.units.get(name, ""))


def _clock(table: Table, time: Column | None, where: str) -> str:
    """The column that holds the time."""
    if time is not None and time.name in table.columns:
        return time.name
    known = [name for name in table.columns if place("t", name) is not None]
    cure = 'Say so in a map, such as t = { column = "stamp", unit = "ms" }, or with --column t=stamp:ms'
    require(known, where, f"which column is t? Columns: {', '.join(table.columns)}. {cure}")
    return known[0]


def _mcap(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Channel]:
    with path.open("rb") as stream:
        head = stream.read(64)
    other = head.startswith(b"\x89MCAP0\r\n") and b"steerkit" not in head  # a spoilt head may be a car server's
    return (ros.read_ros if other else tables.read_own)(path, dbc, notes)


_READERS: dict[str, Callable[[Path, tuple[str, ...], list[str]], Contents]] = {
    ".mcap": _mcap,
    ".npz": tables.read_npz,
    ".parquet": tables.read_parquet,
    ".mat": tables.read_mat,
    ".csv": tables.read_csv,
    ".csv.gz": tables.read_csv,
    ".db3": ros.read_ros,
    ".bag": ros.read_ros,
    ".mf4": tables.read_mf4,
    ".blf": can_frames.read_blf,
    ".asc": can_frames.read_asc,
    ".asc.gz": can_frames.read_asc,
    ".trc": can_frames.read_trc,
    ".log": can_frames.read_candump,
    ".log.gz": can_frames.read_candump,
}
