"""Readers of raw CAN logs (BLF, ASC, candump), and what a DBC says of the frames, whatever file they came in."""

from __future__ import annotations

import gzip
import io
import math
import re
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import known, require
from steerkit._support.files import Bounded
from steerkit.car.ports import python_can
from steerkit.logs.channels import Table

_NEEDS = "CAN logs need python-can and cantools: pip install 'steerkit-control[logs]'"
_CANDUMP = re.compile(r"\(\d+\.\d+\) +\S+ +[0-9A-Fa-f]+#(#?[0-9A-Fa-f]*|R\d*)( [RT])?\s*")
_FEW = 50
"""From this number of frames on, a sum that nearly all of a message hold is its check sum."""


@dataclass
class Frames:
    """The frames of one identifier."""

    t: array[float] = field(default_factory=lambda: array("d"))
    sizes: array[int] = field(default_factory=lambda: array("B"))
    payload: bytearray = field(default_factory=bytearray)

    def add(self, t: float, data: bytes) -> None:
        """One more."""
        self.t.append(t)
        self.sizes.append(len(data))
        self.payload += data

    def data(self) -> Iterator[bytes]:
        """What each of them holds."""
        place = 0
        for size in self.sizes:
            yield bytes(self.payload[place : place + size])
            place += size


Log = dict[tuple[int, bool], Frames]
"""(identifier, is it extended) to its frames."""


def read_candump(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Table]:
    """`candump -L`, compressed or not: lines that are none are left out."""
    from_lines = _python_can(path).io.canutils.CanutilsLogReader
    with _opened(path) as stream:
        lines = _Lines(stream, notes)
        log = collected(_messages(from_lines(lines), notes))
    if lines.odd:
        notes.append(f"left out {lines.odd} lines that are no frames")
    return decoded(log, path, dbc, notes)


def read_asc(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Table]:
    """Vector's text form, compressed or not."""
    reader = _python_can(path).ASCReader
    with _opened(path) as stream:
        log = collected(_messages(reader(stream, relative_timestamp=True), notes))
    return decoded(log, path, dbc, notes)


def read_blf(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Table]:
    """Vector's binary form."""
    reader = _python_can(path).BLFReader
    with Bounded(path) as stream:
        try:
            messages = reader(stream)
        except Exception as error:  # struct's, and whatever a date may be
            raise ValueError(f"{path}: no BLF file ({type(error).__name__}: {error})") from error
        log = collected(_messages(messages, notes))
    return decoded(log, path, dbc, notes)


def _python_can(path: Path) -> Any:
    try:
        can = python_can()
        import cantools  # noqa: F401
    except ImportError:
        raise ValueError(f"{path}: {_NEEDS}") from None
    return can


def _opened(path: Path) -> Any:
    opener: Any = gzip.open if path.suffix.lower() == ".gz" else open
    return opener(path, "rt", encoding="latin-1")


class _Lines(io.TextIOBase):
    """The lines of a text that are frames; python-can's reader would end at the first that is none."""

    def __init__(self, stream: Any, notes: list[str]):
        self.stream, self.notes, self.odd = stream, notes, 0

    def __iter__(self) -> Iterator[str]:  # type: ignore[override]
        for line in self.stream:
            if _CANDUMP.fullmatch(line):
                yield line
            elif line.strip():
                self.odd += 1


def _messages(reader: Iterable[Any], notes: list[str]) -> Iterator[Any]:
    """What a reader gives, up to where it fails: none of them says what it may raise."""
    try:
        yield from reader
    except Exception as error:
        notes.append(f"cut off or broken: what comes before is used ({type(error).__name__}: {str(error)[:80]})")


def collected(messages: Iterable[Any]) -> Log:
    """The data frames, by identifier."""
    log: Log = {}
    for message in messages:
        if not (message.is_error_frame or message.is_remote_frame):
            frames = log.setdefault((message.arbitration_id, message.is_extended_id), Frames())
            frames.add(message.timestamp, bytes(message.data))
    return log


def decoded(log: Log, path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Table]:
    """The signals of the frames that the DBC knows, a table a message, taken out of `log`; a note names the others."""
    require(log, str(path), f"no CAN frames in it{'; ' + notes[-1] if notes else ''}")
    seen = ", ".join(f"0x{frame:X} ({len(frames.t)})" for (frame, _), frames in sorted(log.items())[:12])
    require(
        dbc,
        str(path),
        f"CAN frames of {len(log)} identifiers ({seen}{', ...' if len(log) > 12 else ''}); say what is in them with "
        "--dbc FILE.dbc, or --dbc NAME of the package opendbc, such as toyota_nodsu_pt_generated",
    )
    messages = [m for one in dbc for m in database(one).messages]
    by_id = {(m.frame_id, m.is_extended_frame): m for m in messages}
    unknown = [f"0x{frame:X}" for frame, extended in sorted(log) if (frame, extended) not in by_id]
    tables = [_table(by_id[key], log.pop(key), notes) for key in sorted(log) if key in by_id]
    require(tables, str(path), f"none of its identifiers ({seen}) is in {', '.join(dbc)}: of another car?")
    if unknown:
        some = ", ".join(unknown[:8]) + (", ..." if len(unknown) > 8 else "")
        notes.append(f"{len(unknown)} identifiers are not in the DBC: {some}")
    return [table for table in tables if table is not None]


def database(name: str) -> Any:
    """The DBC in a file, or that of the package opendbc of that name; raises ValueError for one that is neither."""
    import cantools

    try:
        if name.endswith(".dbc") or Path(name).exists():
            return cantools.database.load_file(name, strict=False)
        text = _opendbc(name)
        return cantools.database.load_string(text, "dbc", strict=False)
    except OSError as error:
        raise ValueError(f"--dbc {name}: cannot be read ({error.strerror})") from error
    except (cantools.database.Error, cantools.database.UnsupportedDatabaseFormatError, UnicodeDecodeError) as error:
        raise ValueError(f"--dbc {name}: no DBC ({' '.join(str(error).split())[:200]})") from error


def _opendbc(name: str) -> str:
    try:
        import opendbc
    except ImportError:
        raise ValueError(
            f"--dbc {name}: no such file; names without .dbc are those of the package opendbc, which is not installed"
        ) from None
    folder, made = Path(opendbc.DBC_PATH), opendbc.get_generated_dbcs()
    names = sorted({*made, *(file.stem for file in folder.glob("*.dbc"))})
    known(name, names, "--dbc")
    return made[name] if name in made else (folder / f"{name}.dbc").read_text(encoding="utf-8", errors="replace")


def _table(message: Any, frames: Frames, notes: list[str]) -> Table | None:
    """One message's signals over time; frames that do not hold their check sum, or cannot be decoded, are left out."""
    signals = {signal.name: signal for signal in message.signals}
    sound, count, bad = _sound(message.frame_id, frames), 0, 0
    times = np.empty(len(sound))
    numbers = {name: np.empty(len(sound)) for name in signals}
    for t, data, good in zip(frames.t, frames.data(), sound):
        try:
            values = message.decode(data, decode_choices=False) if good else None
        except Exception:  # cantools, bitstruct: a frame too short, a multiplexer of no meaning
            values = None
        if values is None:
            bad += 1
            continue
        times[count] = t
        for name, column in numbers.items():
            column[count] = float(values.get(name, math.nan))
        count += 1
    if bad:
        notes.append(f"left out {bad} of {len(sound)} frames of {message.name}: check sum or length are wrong")
    if not count:
        return None
    columns = {f"{message.name}.{name}": _decimal(column[:count], signals[name]) for name, column in numbers.items()}
    units = {f"{message.name}.{name}": signals[name].unit or "" for name in numbers}
    table = Table(columns=columns, units=units, t=times[:count])
    return _with_sums(table, message)


def _decimal(values: np.ndarray, signal: Any) -> np.ndarray:
    """The nearest number to raw * scale + offset as decimals, as somebody would write it: 0.3, not 0.1 * 3."""
    digits = [-int(Decimal(repr(part)).as_tuple().exponent) for part in (signal.scale, signal.offset)]
    return np.round(values, max(digits), out=values) if 0 < max(digits) <= 9 else values


def _with_sums(table: Table, message: Any) -> Table:
    """With what a message holds in parts: a coarse angle and its fraction; four wheels."""
    columns, units, means = dict(table.columns), dict(table.units), dict(table.means)
    name, signals = message.name, {signal.name: signal for signal in message.signals}
    coarse, fine = (f"{name}.{part}" for part in ("STEER_ANGLE", "STEER_FRACTION"))
    if {coarse, fine} <= columns.keys():
        total = f"{coarse} + STEER_FRACTION"
        columns[total] = _decimal(columns[coarse] + columns[fine], signals["STEER_FRACTION"])
        units[total], means[total] = units[coarse], "delta_sw"
    wheels = [column for column in columns if re.fullmatch(r".*\.WHEEL_SPEED_(FL|FR|RL|RR)", column)]
    if len(wheels) == 4 and len({units[wheel] for wheel in wheels}) == 1:
        mean = f"{name}.mean"
        columns[mean] = np.mean([columns[wheel] for wheel in wheels], axis=0)
        units[mean], means[mean] = units[wheels[0]], "v"
    return Table(columns=columns, units=units, means=means, t=table.t)


def _sound(frame_id: int, frames: Frames) -> bytearray:
    """Which frames hold their check sum, where the message has one: a last byte that is the sum of the identifier, the
    length and all other bytes in nearly every frame."""
    start = sum(divmod(frame_id, 256))
    held = bytearray(len(d) > 1 and (start + len(d) + sum(d[:-1])) % 256 == d[-1] for d in frames.data())
    return held if len(held) >= _FEW and sum(held) >= 0.9 * len(held) else bytearray(b"\1" * len(held))
