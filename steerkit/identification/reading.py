"""Readers of recordings: steerkit's own (MCAP, npz, Parquet), MATLAB, CSV."""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import zlib
from collections.abc import Mapping
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np

from steerkit.errors import require
from steerkit.identification.columns import ColumnMap
from steerkit.identification.drive import Drive

Columns = dict[str, np.ndarray]

_SHIPPED = {"genesis": "genesis.csv.gz", "genesis-rfs": "genesis_rfs.csv.gz"}


def shipped_drives() -> tuple[str, ...]:
    """Names of the recorded drives that come with steerkit: those of the courses `genesis` and `genesis-rfs`."""
    return tuple(_SHIPPED)


def read_drive(
    file: str | Path,
    columns: ColumnMap | Mapping[str, Any] | None = None,
    *,
    dt: float | None = None,
    trusted: bool = False,
) -> Drive:
    """A recorded drive from a file, or a shipped one by name.

    file: .mcap of a car server, .npz or .parquet of a Log, .mat of MATLAB (up to version 7.2), .csv or .csv.gz
    with a row of names. columns: which column is what (default: columns of well-known names). dt, trusted: see
    `Drive.of`. Raises ValueError, saying what to do, for a file that is not there, broken, of another kind, lacks a
    quantity or holds nonsense; what could be repaired is in the drive's `notes`.
    """
    if str(file) in _SHIPPED and not Path(file).exists():
        with as_file(files(__package__) / "drives" / _SHIPPED[str(file)]) as place:
            return read_drive(place, columns, dt=dt, trusted=trusted)
    path = Path(file)
    kind = "".join(path.suffixes[-2:]) if path.suffix == ".gz" else path.suffix
    if kind not in _READERS:
        known = ", ".join((*_READERS, *_SHIPPED))
        raise ValueError(f"{path}: a recording ends in one of, or is called, {known}")
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from error
    require(raw, str(path), "the file is empty")
    notes: list[str] = []
    recorded = _READERS[kind](path, raw, notes)
    given = columns if isinstance(columns, ColumnMap) else ColumnMap.of(columns or {})
    used = given.with_guesses(recorded, where=str(path))
    notes.insert(0, f"read {used.told()}")
    values = used.in_si(recorded, where=str(path))
    digest = hashlib.sha256(raw).hexdigest()
    return Drive.of(**values, name=path.name, dt=dt, trusted=trusted, notes=tuple(notes), digest=digest)


def _csv(path: Path, raw: bytes, notes: list[str]) -> Columns:
    """Rows of numbers under a row of names; `,`, `;` or tab between them, `#` before comments."""
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    require(len(lines) >= 2, str(path), "no rows under a row of names")
    mark = max(";\t,", key=lambda c: (lines[0].count(c), c == ";"))
    names = [name.strip() for name in next(csv.reader([lines[0]], delimiter=mark))]
    require(
        not all(_is_number(name) for name in names),
        str(path),
        f"the first row holds numbers ({lines[0][:60]}), no names",
    )
    require(len(set(names)) == len(names), str(path), f"two columns of one name: {', '.join(names)}")
    rows = list(csv.reader(lines[1:], delimiter=mark))
    whole = [row for row in rows if len(row) == len(names)]
    if len(whole) < len(rows):
        where = "the last one: the file is cut off" if rows[-1:] != whole[-1:] else "in the middle of the file"
        notes.append(f"dropped {len(rows) - len(whole)} rows without {len(names)} entries, among them {where}")
    comma = mark == ";" and any("," in cell for row in whole[:100] for cell in row)
    numbers = np.array([[_number(cell, comma) for cell in row] for row in whole], dtype=float)
    require(len(numbers) >= 2, str(path), f"no rows with {len(names)} entries, as the row of names has")
    return dict(zip(names, numbers.T))


def _is_number(text: str) -> bool:
    return np.isfinite(_number(text, comma=False))


def _number(text: str, comma: bool) -> float:
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return float("nan")


def _csv_gz(path: Path, raw: bytes, notes: list[str]) -> Columns:
    stream, text = gzip.GzipFile(fileobj=io.BytesIO(raw)), b""
    try:
        while part := stream.read(1 << 16):
            text += part
    except (EOFError, zlib.error) as error:
        require(b"\n" in text, str(path), f"a broken gzip file ({error})")
        notes.append("the compressed file is cut off or broken: what comes before is used")
    except OSError as error:
        raise ValueError(f"{path}: not a gzip file ({error})") from error
    return _csv(path, text, notes)


def _mat(path: Path, raw: bytes, notes: list[str]) -> Columns:
    from scipy.io import loadmat

    try:
        data = loadmat(io.BytesIO(raw))
    except NotImplementedError as error:
        raise ValueError(f"{path}: MATLAB 7.3 is not read; save(..., '-v7') in MATLAB writes what is") from error
    except Exception as error:  # scipy's reader lets anything out when the bytes are not what it expects
        raise ValueError(f"{path}: no MATLAB file, or cut off ({type(error).__name__}: {error})") from error
    columns = {name: np.asarray(value) for name, value in data.items() if not name.startswith("__")}
    numeric = {name: np.ravel(a).astype(float) for name, a in columns.items() if a.dtype.kind in "fiub" and a.size > 1}
    require(numeric, str(path), f"no arrays of numbers in it; it holds {', '.join(columns) or 'nothing'}")
    return numeric


def _npz(path: Path, raw: bytes, notes: list[str]) -> Columns:
    from steerkit.simulation import Log

    return _one_car(path, Log.load(path).columns())


def _parquet(path: Path, raw: bytes, notes: list[str]) -> Columns:
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise ValueError(f"{path}: Parquet needs pyarrow: pip install 'steerkit-control[bench]'") from None
    try:
        table = parquet.read_table(io.BytesIO(raw))
    except Exception as error:  # pyarrow's errors have no base of their own
        raise ValueError(f"{path}: no Parquet file, or cut off ({error}); its index is at the end") from error
    columns = {name: table[name].to_numpy() for name in table.column_names}
    return _one_car(path, {name: a.astype(float) for name, a in columns.items() if a.dtype.kind in "fiub"})


def _one_car(path: Path, columns: Columns) -> Columns:
    batch = "car.v[0]" in columns
    require(not batch, str(path), "it holds a batch of cars; save one: Log(t, {name: a[:, i] ...}, units)")
    return columns


def _mcap(path: Path, raw: bytes, notes: list[str]) -> Columns:
    """The frames of a real car's recording, decoded by the configuration that is in it; on the pose's clock."""
    try:
        from steerkit.plants.real_car import recording
    except ImportError:
        raise ValueError(f"{path}: MCAP needs the car's packages: pip install 'steerkit-control[car]'") from None
    recorded = recording.read(path)
    if not recorded.whole:
        notes.append(f"the recording is damaged or cut short, what is intact is used: {recorded.kept()}")
    config = recording.config_of(recorded)
    readers = {reader.frame_id: reader for reader in config.readers}
    counters: dict[int, int | None] = dict.fromkeys(readers)
    series: dict[str, list[tuple[float, float]]] = {}
    bad = 0
    for frame in recorded.of("/can/rx"):
        reader = readers.get(frame["id"])
        if reader is None:
            continue
        checked = reader.read(bytes.fromhex(frame["data"]), counters[frame["id"]])
        counters[frame["id"]] = checked.counter
        if checked.error or not all(np.isfinite(v) for v in checked.values.values()):
            bad += 1
            continue
        for name, value in checked.values.items():
            series.setdefault(name, []).append((min(frame["arrived"], frame["t"]), value))
    if bad:
        notes.append(f"left out {bad} frames that were broken or held no value")
    known = [name for name in ("delta_sw", "v", "r", "psi") if name in series]
    require(
        {"delta_sw", "v"} <= set(known), str(path), f"no steering angle or speed; read: {', '.join(series) or 'none'}"
    )
    clock = max((np.array(series[name])[:, 0] for name in known), key=len)
    columns: Columns = {"t": clock}
    for name in known:
        at, value = np.array(series[name]).T
        columns[name] = np.interp(clock, at, np.unwrap(value) if name == "psi" else value)
        gap = np.diff(at) > 0.25  # a signal that pauses while others go on
        for before, after in zip(at[:-1][gap], at[1:][gap]):
            columns[name][(clock > before) & (clock < after)] = np.nan
        columns[name][(clock < at[0]) | (clock > at[-1])] = np.nan
    return columns


_READERS = {".mcap": _mcap, ".npz": _npz, ".parquet": _parquet, ".mat": _mat, ".csv": _csv, ".csv.gz": _csv_gz}
