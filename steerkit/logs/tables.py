"""Readers of tables: CSV, MATLAB, npz, Parquet, MDF 4, and the recording of a car server."""

import gzip
import io
import sys
import zlib
from array import array
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import optional, require
from steerkit._support.files import Bounded, atomic_write, decoded, parted, text_table
from steerkit._support.files import read_npz as arrays_of
from steerkit.car import recording
from steerkit.car.config import DIMENSION
from steerkit.diagram.simulation import Log
from steerkit.logs.can_frames import database
from steerkit.logs.channels import Channel, Table

Columns = dict[str, np.ndarray]

NAN = float("nan")


def read_csv(path: Path, dbc: tuple[str, ...], notes: list[str]) -> Table:
    """Rows of numbers under a row of names such as `v` or `v [m/s]`; `,`, `;` or tab between, `#` before comments.

    Compressed or not; of a file that is cut off, what comes before.
    """
    opener: Any = gzip.open if path.suffix.lower() == ".gz" else open
    with opener(path, "rb") as stream:
        return _table(path, _ended(_lines(stream, notes), notes), notes)


def _lines(stream: Any, notes: list[str]) -> Iterator[str]:
    """Lines, ended by any of the usual signs."""
    try:
        for line in decoded(stream):
            yield from line.splitlines(keepends=True)
    except (EOFError, zlib.error):
        notes.append("the compressed file is cut off or broken: what comes before is used")


def _ended(lines: Iterator[str], notes: list[str]) -> Iterator[str]:
    """Without the last line, if nothing ends it: its last number may be cut short."""
    for line in lines:
        if line.endswith(("\n", "\r")):
            yield line
        else:
            notes.append("left out the last line, which no line end closes: it may be cut off")


def _table(path: Path, lines: Iterator[str], notes: list[str]) -> Table:
    names, rows = text_table(lines, str(path))
    require(len(set(names)) == len(names), str(path), f"two columns of one name: {', '.join(names)}")
    values, odd, last = array("d"), 0, False  # as text all of it would take many times the memory
    for _, _, numbers in rows:
        last = len(numbers) != len(names)
        odd += last
        if not last:
            values.extend([NAN if number is None else number for number in numbers])
    if odd:
        where = "the last one: the file is cut off" if last else "in the middle of the file"
        notes.append(f"dropped {odd} rows without {len(names)} entries, among them {where}")
    columns = np.frombuffer(values).reshape(-1, len(names)).T
    require(columns.shape[1] >= 2, str(path), f"no rows under a row of names, or not of {len(names)} entries as it has")
    return with_units({name: column.copy() for name, column in zip(names, columns)})


def with_units(columns: Columns) -> Table:
    """The columns, with the unit that a name ends in taken off it: `car.v [m/s]`, `speed (km/h)`."""
    parts = {name: parted(name) for name in columns}
    distinct = len({bare for bare, _ in parts.values()}) == len(columns)
    parts = {name: (bare if distinct else name, unit) for name, (bare, unit) in parts.items()}
    return Table(
        columns={parts[name][0]: values for name, values in columns.items()}, units=dict(filter(all, parts.values()))
    )


def read_mat(path: Path, dbc: tuple[str, ...], notes: list[str]) -> Table:
    """Arrays of a MATLAB file by name; those of the commonest length."""
    from scipy.io import loadmat

    try:
        data = loadmat(str(path), appendmat=False)
    except NotImplementedError as error:
        raise ValueError(f"{path}: MATLAB 7.3 is not read; save(..., '-v7') in MATLAB writes what is") from error
    except Exception as error:  # scipy's reader lets anything out when the bytes are not what it expects
        raise ValueError(f"{path}: no MATLAB file, or cut off ({type(error).__name__}: {error})") from error
    arrays = {name: np.asarray(value) for name, value in data.items() if not name.startswith("__")}
    return one_length(arrays, path, notes)


def one_length(arrays: Columns, path: Path, notes: list[str]) -> Table:
    """A table of the arrays of numbers that have the commonest length; a note names those of another."""
    columns = {name: np.ravel(a).astype(float, copy=False) for name, a in _numeric(arrays, path).items()}
    lengths = [len(values) for values in columns.values()]
    n = max(set(lengths), key=lambda length: (lengths.count(length), length))
    odd = [f"{name} ({len(values)})" for name, values in columns.items() if len(values) != n]
    if odd:
        notes.append(f"left out {', '.join(odd)}: not of the others' length, {n}")
    return with_units({name: values for name, values in columns.items() if len(values) == n})


def _numeric(arrays: Columns, path: Path) -> Columns:
    found = {name: a for name, a in arrays.items() if a.dtype.kind in "fiub" and a.size > 1}
    require(found, str(path), f"no arrays of numbers in it; it holds {', '.join(arrays) or 'nothing'}")
    return found


def read_npz(path: Path, dbc: tuple[str, ...], notes: list[str]) -> Table:
    """A Log that was saved, or arrays of one length by name."""
    arrays = arrays_of(path, "read_drive")
    if {"t", "units"} <= arrays.keys():
        log = Log.load(path)
        return _one_car(path, log.columns(), {"t": "s", **log.units})
    return one_length(arrays, path, notes)


def read_parquet(path: Path, dbc: tuple[str, ...], notes: list[str]) -> Table:
    """Columns of numbers; units from the fields' metadata."""
    parquet = optional("pyarrow.parquet", f"{path}: Parquet", "logs")
    try:
        table = parquet.read_table(str(path), page_checksum_verification=True)
    except Exception as error:  # pyarrow's errors have no base of their own
        raise ValueError(f"{path}: no Parquet file, or cut off ({error}); its index is at the end") from error
    units = {f.name: (f.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") for f in table.schema}
    columns = {name: table[name].to_numpy() for name in table.column_names}
    numbers = {name: a.astype(float, copy=False) for name, a in _numeric(columns, path).items()}
    return _one_car(path, numbers, units)


def _one_car(path: Path, columns: Columns, units: dict[str, str]) -> Table:
    batch = "car.v[0]" in columns
    require(not batch, str(path), "it holds a batch of cars; save one: Log(t, {name: a[:, i] ...}, units)")
    table = with_units(columns)
    return Table(columns=table.columns, units={**table.units, **{k: u for k, u in units.items() if u}})


_MEANS = {**{name: name for name in ("delta_sw", "v", "r", "psi", "x", "y")}, "lat": "lat_deg", "lon": "lon_deg"}
"""Name in the configuration to the quantity of a drive; the units there are those of `DIMENSION`."""


def read_own(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Channel]:
    """What the car's frames say of steering wheel, speed, yaw rate, heading and place, each on its own clock."""
    optional("cantools", f"{path}: the recording of a car", "car")
    recorded = recording.read(path)
    if not recorded.whole:
        notes.append(f"the recording is damaged or cut short, what is intact is used: {recorded.kept()}")
    config = recording.config_of(recorded)
    readers = {reader.frame_id: reader for reader in config.readers}
    counters: dict[int, int | None] = dict.fromkeys(readers)
    series: dict[str, list[tuple[float, float]]] = {}
    bad = 0
    for frame in recorded.of("/can/rx"):
        reader = readers.get(frame["frame_id"])
        if reader is None:
            continue
        checked = reader.read(bytes.fromhex(frame["data"]), counters[frame["frame_id"]])
        counters[frame["frame_id"]] = checked.counter
        if checked.error or not all(np.isfinite(v) for v in checked.values.values()):
            bad += 1
            continue
        for name, value in checked.values.items():
            series.setdefault(name, []).append((min(frame["arrived"], frame["t"]), value))
    if bad:
        notes.append(f"left out {bad} frames that were broken or held no value")
    lacks = f"no steering angle or speed; read: {', '.join(series) or 'none'}"
    require({"delta_sw", "v"} <= set(series), str(path), lacks)
    channels = []
    for name, points in series.items():
        t, values = np.array(points).T
        means = _MEANS.get(name, "")
        channels.append(Channel(name=name, t=t, values=values, unit=DIMENSION[name] if means else "", means=means))
    return channels


def read_mf4(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Channel]:
    """The channels that are numbers, with the file's units; needs asammdf."""
    asammdf = optional("asammdf", f"{path}: MF4", "logs")
    trouble, channels = "", list[Channel]()
    with _silent():
        try:
            with Bounded(path) as stream, asammdf.MDF(stream) as file:
                channels = _channels(file, notes)
                if dbc:
                    databases = {"CAN": [(database(name), 0) for name in dbc]}
                    with file.extract_bus_logging(database_files=databases) as signals:
                        channels += _channels(signals, notes)
        except Exception as error:  # asammdf lets anything out when the bytes are not what it expects
            trouble = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    require(not trouble, str(path), f"no MDF 4 file, cut off, or spoilt ({trouble})")
    held = "; its CAN frames need --dbc" if not dbc else ""
    require(channels, str(path), f"no channels of numbers in it{held}")
    return channels


def write_mf4(log: Log, file: Path) -> None:
    """Write a log as MDF 4.10, a channel for each of its columns, with units; needs asammdf."""
    asammdf = optional("asammdf", f"{file}: MF4", "logs")
    units = {"t": "s", **log.units}
    columns = {name: values for name, values in log.columns().items() if name != "t"}
    signals = [
        asammdf.Signal(samples=np.asarray(values), timestamps=log.t, name=name, unit=units[name.split("[")[0]])
        for name, values in columns.items()
    ]
    with atomic_write(file) as draft, draft.open("wb") as stream, _silent(), asammdf.MDF(version="4.10") as mdf:
        mdf.append(signals, comment="steerkit")
        mdf.save(stream)


@contextmanager
def _silent() -> Iterator[None]:
    """What asammdf prints of a spoilt file, and reports when a file that it could not open is forgotten."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        sys.unraisablehook = hook


def _channels(file: Any, notes: list[str]) -> list[Channel]:
    channels, lost = [], 0
    for g, group in enumerate(file.groups):
        if getattr(group, "channel_group", None) is not None and group.channel_group.flags & 0x2:
            continue  # frames of a bus, not signals
        t = None
        for c in (c for c in range(len(group.channels)) if c != file.masters_db.get(g)):
            signal = file.get(group=g, index=c)
            values = np.asarray(signal.samples)
            if values.dtype.kind not in "fiub" or values.ndim != 1:
                continue
            if len(values) != len(signal.timestamps):
                lost += 1
                continue
            numbers = values.astype(float)
            if signal.invalidation_bits is not None:
                numbers[np.asarray(signal.invalidation_bits, dtype=bool)] = np.nan
            t = np.array(signal.timestamps, dtype=float) if t is None else t
            channels.append(Channel(name=signal.name, t=t, values=numbers, unit=signal.unit or ""))
    if lost:
        notes.append(f"left out {lost} channels that have not as many values as times")
    return channels
