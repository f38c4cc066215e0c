"""Reader of MDF 4 (ASAM), with the signals of recorded buses where there is a DBC."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit._support.files import Bounded
from steerkit.logs.channels import Options, Table

_PIECE = 1 << 13
"""Values that are read at a time."""


def read_mf4(path: Path, options: Options, notes: list[str]) -> list[Table]:
    """The channels that are numbers, a table a channel group, with the file's units; needs asammdf."""
    try:
        from asammdf import MDF
    except ImportError:
        raise ValueError(f"{path}: MF4 needs asammdf: pip install 'steerkit-control[logs]'") from None
    trouble, tables = "", list[Table]()
    with _silent():
        try:
            with Bounded(path) as stream, MDF(stream) as file:
                tables = _tables(file, notes)
                if options.dbc:
                    tables += _buses(file, options, notes)
        except Exception as error:  # asammdf lets anything out when the bytes are not what it expects
            trouble = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    require(not trouble, str(path), f"no MDF 4 file, cut off, or spoilt ({trouble})")
    held = "; its CAN frames need --dbc" if not options.dbc else ""
    require(tables, str(path), f"no channels of numbers in it{held}")
    return tables


@contextmanager
def _silent() -> Iterator[None]:
    """What asammdf prints of a spoilt file, and reports when a file that it could not open is forgotten."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        sys.unraisablehook = hook


def _tables(file: Any, notes: list[str]) -> list[Table]:
    tables, lost = [], 0
    for g, group in enumerate(file.groups):
        if getattr(group, "channel_group", None) is not None and group.channel_group.flags & 0x2:
            continue  # frames of a bus, not signals
        master = file.masters_db.get(g)
        columns, units, t = dict[str, np.ndarray](), dict[str, str](), None
        for c, channel in enumerate(group.channels):
            if c == master:
                continue
            read = _channel(file, g, c)
            if read is None:
                continue
            times, numbers, unit = read
            if len(numbers) != len(times):
                lost += 1
                continue
            t = times if t is None else t
            columns[channel.name], units[channel.name] = numbers, unit
        if t is not None:
            tables.append(Table(columns=columns, units=units, t=t))
    if lost:
        notes.append(f"left out {lost} channels that have not as many values as times")
    return tables


def _channel(file: Any, group: int, index: int) -> tuple[np.ndarray, np.ndarray, str] | None:
    """Times, values and unit of a channel, read piece by piece, as asammdf takes several times what it reads; None for
    one that holds no numbers."""
    times, parts, unit, place = list[np.ndarray](), list[np.ndarray](), "", 0
    while True:
        signal = file.get(group=group, index=index, record_offset=place, record_count=_PIECE)
        values = np.asarray(signal.samples)
        if values.dtype.kind not in "fiub" or values.ndim != 1:
            return None
        numbers = values.astype(float)
        if signal.invalidation_bits is not None:
            numbers[np.asarray(signal.invalidation_bits, dtype=bool)] = np.nan
        times.append(np.array(signal.timestamps, dtype=float))
        parts.append(numbers)
        unit, place = signal.unit or "", place + _PIECE
        if len(numbers) < _PIECE:
            return np.concatenate(times), np.concatenate(parts), unit


def _buses(file: Any, options: Options, notes: list[str]) -> list[Table]:
    """What a DBC says of the frames of recorded buses."""
    from steerkit.logs.can_frames import database

    databases = {"CAN": [(database(name), 0) for name in options.dbc]}
    with file.extract_bus_logging(database_files=databases) as signals:
        return _tables(signals, notes)
