"""Readers of raw CAN logs (BLF, ASC, TRC, candump), and what a DBC says of the frames, whatever file they came in."""

import gzip
import logging
import math
import re
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import known, optional, require
from steerkit._support.files import LARGEST_TEXT, Bounded, opened
from steerkit.car.ports import python_can
from steerkit.logs.channels import Channel

_CANDUMP = re.compile(
    r"\((\d+\.\d+)\) +\S+ +([0-9A-F]+)#(?:#[0-9A-F])?(R\d*|(?:[0-9A-F]{2})*)( [RT])?\s*", re.IGNORECASE
)
"""A line of candump: time, identifier, data; R: a remote frame."""
_ERROR = 0x20000000
"""Bit of the identifiers that candump gives error frames."""
_FEW = 50
"""From this number of frames on, a sum that nearly all of a message hold is its check sum."""

Frame = tuple[float, int, bool, bytes]
"""Time [s], identifier, is it extended, data."""


def read_candump(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Channel]:
    """`candump -L`, compressed or not: lines that are none are left out."""
    odd = 0

    def frames(stream: Any) -> Iterator[Frame]:
        nonlocal odd
        for line in stream:
            found = _CANDUMP.fullmatch(line)
            odd += bool(not found and line.strip())
            if found and found[3][:1] not in ("R", "r") and not int(found[2], 16) & _ERROR:
                yield float(found[1]), int(found[2], 16), len(found[2]) > 3, bytes.fromhex(found[3])

    with _opened(path) as stream:
        channels = _decoded(frames(stream), path, dbc, notes)
    if odd:
        notes.append(f"left out {odd} lines that are no frames")
    return channels


def read_asc(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Channel]:
    """Vector's text form, compressed or not."""
    reader = python_can(f"{path}: a CAN log").ASCReader
    with _opened(path) as stream:
        return _decoded(_frames(reader(stream, relative_timestamp=True)), path, dbc, notes)


def read_trc(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Channel]:
    """PEAK's text form: lines that are none are left out."""
    reader, odd, log = python_can(f"{path}: a CAN log").TRCReader, list[str](), logging.getLogger("can.io.trc")

    def told(record: logging.LogRecord) -> bool:  # python-can only logs what it leaves out
        odd.extend([record.getMessage()] * (record.levelno >= logging.WARNING))
        return not odd

    log.addFilter(told)
    try:
        with _opened(path) as stream:
            channels = _decoded(_frames(reader(stream)), path, dbc, notes)
    finally:
        log.removeFilter(told)
    if odd:
        notes.append(f"left out {len(odd)} lines that are no frames")
    return channels


def read_blf(path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Channel]:
    """Vector's binary form."""
    reader = python_can(f"{path}: a CAN log").BLFReader
    with Bounded(path) as stream:
        try:
            messages = reader(stream)
        except Exception as error:  # struct's, and whatever a date may be
            raise ValueError(f"{path}: no BLF file ({type(error).__name__}: {error})") from error
        return _decoded(_frames(messages), path, dbc, notes)


def _opened(path: Path) -> Any:
    opener: Any = gzip.open if path.suffix.lower() == ".gz" else open
    return opener(path, "rt", encoding="latin-1")


def _frames(messages: Iterable[Any]) -> Iterator[Frame]:
    """The data frames among messages of python-can."""
    for m in messages:
        if not (m.is_error_frame or m.is_remote_frame):
            yield m.timestamp, m.arbitration_id, m.is_extended_id, bytes(m.data)


def _decoded(frames: Iterable[Frame], path: Path, dbc: tuple[str, ...], notes: list[str]) -> list[Channel]:
    """What a DBC says of frames, up to where their reader fails: none of them says what it may raise."""
    decoder = Decoder(dbc)
    try:
        for frame in frames:
            decoder.add(*frame)
    except Exception as error:
        notes.append(f"cut off or broken: what comes before is used ({type(error).__name__}: {str(error)[:80]})")
    return decoder.channels(path, notes)


class Decoder:
    """Takes frames as they come, and gives the signals that a DBC says are in them, a channel each."""

    def __init__(self, dbc: tuple[str, ...]):
        self._dbc, self.seen = dbc, Counter[tuple[int, bool]]()
        messages = (m for one in dbc for m in database(one).messages)
        self._messages = {(m.frame_id, m.is_extended_frame): m for m in messages}
        self._rows: dict[tuple[int, bool], array[float]] = {}
        """By identifier: time, does it hold the check sum (NaN: cannot be decoded), signals; of the next frame ..."""

    def add(self, t: float, identifier: int, extended: bool, data: bytes) -> None:
        """One more frame."""
        key = identifier, extended
        self.seen[key] += 1
        message = self._messages.get(key)
        if message is None:
            return
        total = sum(divmod(identifier, 256)) + len(data) + sum(data[:-1])  # as the last byte is in many cars
        values, held = dict[str, Any](), float(len(data) > 1 and total % 256 == data[-1])
        try:
            values = message.decode(data, decode_choices=False)
        except Exception:  # cantools, bitstruct: a frame too short, a multiplexer of no meaning
            held = math.nan
        row = self._rows.setdefault(key, array("d"))
        row.extend((t, held, *(float(values.get(signal.name, math.nan)) for signal in message.signals)))

    def channels(self, path: Path, notes: list[str]) -> list[Channel]:
        """The signals of all frames that the DBC knows; a note names the others."""
        require(self.seen, str(path), f"no CAN frames in it{'; ' + notes[-1] if notes else ''}")
        seen = ", ".join(f"0x{frame:X} ({count})" for (frame, _), count in sorted(self.seen.items())[:12])
        held = f"CAN frames of {len(self.seen)} identifiers ({seen}{', ...' if len(self.seen) > 12 else ''})"
        cure = "--dbc FILE.dbc, or --dbc NAME of the package opendbc, such as toyota_nodsu_pt_generated"
        require(self._dbc, str(path), f"{held}; say what is in them with {cure}")
        other = f"none of its identifiers ({seen}) is in {', '.join(self._dbc)}: of another car?"
        require(self._rows, str(path), other)
        unknown = [f"0x{frame:X}" for frame, extended in sorted(self.seen) if (frame, extended) not in self._messages]
        if unknown:
            some = ", ".join(unknown[:8]) + (", ..." if len(unknown) > 8 else "")
            notes.append(f"{len(unknown)} identifiers are not in the DBC: {some}")
        of_each = [_channels(self._messages[key], self._rows.pop(key), notes) for key in sorted(self._rows)]
        return [channel for channels in of_each for channel in channels]


def database(name: str) -> Any:
    """The DBC in a file, or that of the package opendbc of that name; raises ValueError for one that is neither."""
    cantools = optional("cantools", f"--dbc {name}: a DBC", "logs")
    try:
        if name.endswith(".dbc") or Path(name).exists():
            opened(name, LARGEST_TEXT).close()
            return cantools.database.load_file(name, strict=False)
        text = _opendbc(name)
        return cantools.database.load_string(text, "dbc", strict=False)
    except OSError as error:
        raise ValueError(f"--dbc {name}: cannot be read ({error.strerror})") from error
    except Exception as error:  # whatever the parser makes of what is no DBC
        raise ValueError(f"--dbc {name}: no DBC ({' '.join(str(error).split())[:200]})") from error


def _opendbc(name: str) -> str:
    opendbc = optional("opendbc", f"--dbc {name}: no such file; a name without .dbc", "production")
    folder, made = Path(opendbc.DBC_PATH), opendbc.get_generated_dbcs()
    names = sorted({*made, *(file.stem for file in folder.glob("*.dbc"))})
    known(name, names, "--dbc")
    return made[name] if name in made else (folder / f"{name}.dbc").read_text(encoding="utf-8", errors="replace")


def _channels(message: Any, rows: "array[float]", notes: list[str]) -> list[Channel]:
    """A message's signals over time, without frames that do not decode, or lack a check sum that nearly all hold."""
    whole = np.frombuffer(rows).reshape(-1, 2 + len(message.signals))
    held = whole[:, 1]
    summed = len(held) >= _FEW and np.sum(held == 1.0) >= 0.9 * len(held)
    good = whole[held == 1.0 if summed else np.isfinite(held)]
    if len(good) < len(whole):
        bad = f"{len(whole) - len(good)} of {len(whole)} frames of {message.name}"
        notes.append(f"left out {bad}: check sum or length are wrong")
    if not len(good):
        return []
    t, columns = good[:, 0].copy(), {}
    for signal, values in zip(message.signals, good[:, 2:].T):
        name = f"{message.name}.{signal.name}"
        columns[name] = Channel(name=name, t=t, values=_decimal(values, signal), unit=signal.unit or "")
    return [*columns.values(), *_sums(message, columns)]


def _decimal(values: np.ndarray, signal: Any) -> np.ndarray:
    """The nearest number to raw * scale + offset as decimals, as somebody would write it: 0.3, not 0.1 * 3."""
    digits = [-int(Decimal(repr(part)).as_tuple().exponent) for part in (signal.scale, signal.offset)]
    return np.round(values, max(digits)) if 0 < max(digits) <= 9 else values.copy()


def _sums(message: Any, columns: dict[str, Channel]) -> Iterator[Channel]:
    """What a message holds in parts: a coarse angle and its fraction; four wheels."""
    coarse, fine = (columns.get(f"{message.name}.{part}") for part in ("STEER_ANGLE", "STEER_FRACTION"))
    if coarse and fine:
        total = _decimal(coarse.values + fine.values, message.get_signal_by_name("STEER_FRACTION"))
        yield replace(coarse, name=f"{coarse.name} + STEER_FRACTION", values=total, means="delta_sw")
    wheels = [columns[name] for name in columns if re.fullmatch(r".*\.WHEEL_SPEED_(FL|FR|RL|RR)", name)]
    if len(wheels) == 4 and len({wheel.unit for wheel in wheels}) == 1:
        mean = np.mean([wheel.values for wheel in wheels], axis=0)
        yield replace(wheels[0], name=f"{message.name}.mean", values=mean, means="v")
