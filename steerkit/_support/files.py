"""Files that are written whole or not at all, arrays in .npz files, and tables of numbers in text."""

import codecs
import csv
import errno
import io
import itertools
import math
import os
import re
import stat
import sys
import threading
import tomllib
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path as FilePath
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require

File = str | os.PathLike[str]


LARGEST = 1 << 32
"""Bytes that a file may have, and its arrays in memory, by default."""
LARGEST_TEXT = 1 << 26
"""Bytes that a text may have, such as a configuration."""


def opened(file: File, largest: int = LARGEST) -> io.BufferedReader:
    """A file, open to be read; raises ValueError for a device or a pipe, which might never end, and one too large.

    OSError as it is; that of a folder too.
    """
    number = os.open(file, os.O_RDONLY | os.O_NONBLOCK)  # else a pipe waits for who writes to it
    try:
        status = os.fstat(number)
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
        require(stat.S_ISREG(status.st_mode), str(file), "is a device or a pipe, expected a file")
        many = f"has {status.st_size / 1e6:.0f} MB, expected at most {largest / 1e6:.0f} MB"
        require(status.st_size <= largest, str(file), many)
        return open(number, "rb")
    except BaseException:
        os.close(number)
        raise


def read_bytes(file: File, largest: int = LARGEST) -> bytes:
    """What was in a file when it was opened, not what /proc/kmsg and its like go on giving; raises as `opened`."""
    with opened(file, largest) as stream:
        return stream.read(os.fstat(stream.fileno()).st_size)


class Bounded(io.BufferedReader):
    """A file of which a spoilt length cannot ask for more than there is."""

    def __init__(self, path: FilePath):
        super().__init__(opened(path, sys.maxsize).detach())
        self._length = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """As many bytes, or what is left."""
        left = max(0, self._length - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


@contextmanager
def atomic_write(file: File, *, durable: bool = True) -> Iterator[FilePath]:
    """A name beside `file` to write to; where the `with` block ends well, that becomes `file`, else all is as before.

    For whatever must not be found half written: after an error, a full disk or a kill, `file` is the old one or the new
    one. durable: wait until the disk has it, so that this also holds when the power is cut; False for a thread that may
    not wait. A link is followed. Raises ValueError where `file` is a folder or a device, FileNotFoundError where its
    folder is missing, and what the block raises, with a note that `file` is as it was.
    """
    target = FilePath(os.path.realpath(file))
    require(not target.exists() or target.is_file(), f"{file}", "is a folder or a device, expected a file's name")
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "there is no such folder", str(target.parent))
    draft = target.with_name(f".{target.name}.{os.getpid()}-{threading.get_ident()}.tmp")
    draft.unlink(missing_ok=True)  # of an earlier process of this number, killed
    try:
        yield draft
        if durable:
            with draft.open("rb") as stream:
                sync(stream)
        os.replace(draft, target)
    except BaseException as error:
        error.add_note(f"{file} was not written; what was there before is unchanged")
        raise
    finally:
        draft.unlink(missing_ok=True)


def write_text(file: File, text: str, *, durable: bool = True) -> None:
    """Write a text file (UTF-8), whole or not at all: see `atomic_write`."""
    with atomic_write(file, durable=durable) as draft:
        draft.write_text(text, encoding="utf-8")


def write_rows(file: File, head: Iterable[str], columns: Sequence[NDArray[Any]]) -> None:
    """Write columns (n,) as CSV under a row of names, every number to its last bit: see `atomic_write`."""
    rows = np.column_stack(columns).tolist()
    write_text(file, "\n".join([",".join(head), *(",".join(map(repr, row)) for row in rows), ""]))


_AS_CSV = "save its sheet as CSV (UTF-8)"
_NO_TEXT = {
    b"PK\x03\x04": f"an Excel workbook or another ZIP archive; {_AS_CSV}",
    b"\xd0\xcf\x11\xe0": f"an Excel workbook of old; {_AS_CSV}",
    b"\x1f\x8b": "compressed by gzip; unpack it",
    b"\x89PNG": "a picture",
    b"%PDF": "a PDF",
}
"""How files begin that are often taken for text."""


_WIDE = (b"\xff\xfe", b"\xfe\xff")


def read_text(file: File, where: str, *, latin: bool = False) -> str:
    """The text of a file in UTF-8 or UTF-16, without the byte-order mark that some programs put before it.

    latin: read it as Latin-1 where it is not. Raises ValueError, in the name of `where`, for a file that cannot be
    read, and for what is no such text, saying what it looks like.
    """
    try:
        data = read_bytes(file, LARGEST_TEXT)
    except OSError as error:
        raise ValueError(f"{where}: {file} cannot be read ({error.strerror})") from error
    known, wide = _no_text(data), data.startswith(_WIDE)
    what = known or ("binary" if b"\0" in data and not wide else "")
    require(not what, where, f"{file} is {what}, expected text in UTF-8" if not known else f"{file} is {known}")
    try:
        return data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        if latin and not wide:
            return data.decode("latin-1")
        line = data.count(b"\n", 0, error.start) + 1
        what = f"{file}, line {line}: byte {data[error.start]:#x} is not UTF-8 (Latin-1?); save the file as UTF-8"
        raise ValueError(f"{where}: {what}") from error


def refuse_workbook(file: File) -> None:
    """ValueError for what its name says to be an Excel workbook, saying what to do."""
    require(not FilePath(file).suffix.lower().startswith(".xls"), f"{file}", f"an Excel workbook; {_AS_CSV}")


def _no_text(head: bytes) -> str:
    return next((what for start, what in _NO_TEXT.items() if head.startswith(start)), "")


def decoded(stream: Any) -> Iterator[str]:
    """The lines of a stream of bytes with `peek`: UTF-8 or UTF-16, or else, line by line, as Windows writes them.

    Raises ValueError for what is no text, saying what it looks like.
    """
    head = stream.peek(4)[:4]
    require(not _no_text(head), f"{stream.name}", f"is {_no_text(head)}")
    if head.startswith(_WIDE):
        yield from codecs.getreader("utf-16")(stream, "replace")
        return
    for k, raw in enumerate(stream):
        line = raw.removeprefix(b"\xef\xbb\xbf") if k == 0 else raw
        try:
            yield line.decode("utf-8")
        except UnicodeDecodeError:
            yield line.decode("latin-1")


def read_toml(file: File, where: str) -> dict[str, Any]:
    """What a TOML file holds; raises ValueError, in the name of `where`, for one that cannot be read or is no TOML."""
    return toml_of(read_text(file, where), where)


def toml_of(text: str, where: str) -> dict[str, Any]:
    """What a text in TOML says; raises ValueError, in the name of `where`, for one that is no TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a number of 5000 digits is a ValueError too
        raise ValueError(f"{where}: not TOML ({error!s:.200})") from error


def write_npz(file: File, arrays: Mapping[str, Any], *, compressed: bool = False, durable: bool = True) -> None:
    """Write arrays by name to an .npz file without pickle, whole or not at all: see `atomic_write`."""
    for name, values in arrays.items():
        require(not np.asarray(values).dtype.hasobject, f"{file}", f"{name} holds objects, expected numbers or text")
    save = np.savez_compressed if compressed else np.savez
    with (
        atomic_write(file, durable=durable) as draft,
        draft.open("wb") as stream,
    ):  # given a name, savez would append .npz
        try:
            save(stream, **arrays)
        except ValueError as error:  # what zipfile says of a file that Ctrl-C left open hides the Ctrl-C
            if isinstance(error.__context__, KeyboardInterrupt):
                raise KeyboardInterrupt from error
            raise


def read_npz(file: File, where: str, *, largest: int = LARGEST) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file by name; nothing in it is ever executed.

    largest: bytes that they may take in memory; a small file may ask for a lot. Raises ValueError, in the name of
    `where`, for any other file, one that is cut short, one that holds objects and one that is too large;
    FileNotFoundError, IsADirectoryError and PermissionError as they are.
    """
    try:
        with opened(file) as stream, np.lib.npyio.NpzFile(stream, allow_pickle=False) as data:
            assert data.zip is not None
            _check_sizes(data.zip, largest)
            return {key: data[key] for key in data.files}
    except (FileNotFoundError, IsADirectoryError, PermissionError):
        raise
    except Exception as error:  # zipfile, zlib and NumPy's parser of headers let many kinds out
        raise ValueError(f"{where}: {file} is no NumPy .npz file, or a broken one ({error!s:.200})") from error


def _check_sizes(archive: zipfile.ZipFile, largest: int) -> None:
    """Raise ValueError where the arrays' headers ask for more memory than is allowed, or than their data has."""
    total = 0
    for member in archive.infolist():
        with archive.open(member) as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(stream)
        size = math.prod(shape) * dtype.itemsize
        if size > member.file_size:
            raise ValueError(f"{member.filename} says that it has {size} bytes, and has {member.file_size}")
        total += size
    if total > largest:
        raise ValueError(f"its arrays take {total / 1e6:.0f} MB, expected at most {largest / 1e6:.0f} MB")


def write_arrays(file: File, kind: str, arrays: Mapping[str, Any], *, durable: bool = True) -> None:
    """`write_npz`, with the kind of thing that the arrays are, such as `policy`, written beside them."""
    write_npz(file, {"format": f"steerkit {kind} 1", **arrays}, durable=durable)


def read_arrays(file: File, kind: str, *, largest: int = LARGEST) -> dict[str, NDArray[Any]]:
    """The arrays that `write_arrays` wrote; raises ValueError for another kind of thing, else as `read_npz`."""
    try:
        arrays = read_npz(file, kind, largest=largest)
    except ValueError as why:
        hint = f"it is cut short or not a steerkit {kind} file; write it again with save()"
        raise ValueError(f"{file}: cannot be read ({why.__cause__!s:.200}); {hint}") from why
    kept = str(arrays.get("format", "an .npz of another program"))
    require(kept == f"steerkit {kind} 1", str(file), f"holds '{kept}', expected 'steerkit {kind} 1'")
    return arrays


def sync(stream: IO[bytes]) -> None:
    """Wait until the disk has what was written to an open file, as far as the operating system has it."""
    os.fsync(stream.fileno())


_UNIT = re.compile(r"^(?P<name>.*\S)\s*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)")


def text_table(lines: Iterable[str], where: str) -> tuple[list[str], Iterator[tuple[int, str, list[float | None]]]]:
    """The table in lines of text, with one row of names: the first row, or the last comment above rows of numbers.

    Returns the names as they stand, with their units, and the rows as they are read: number of the line, the line, and
    its cells, None for what is no number.
    Columns are parted by `;`, tab, `,`, `|` or, where there is none of them, blanks; decimal commas are read where the
    comma does not part columns. A cell may be a time: ISO 8601 (seconds since 1970), or hours, minutes and seconds
    (seconds since midnight). `#` begins a comment. Raises ValueError for a table without a row of names.
    """
    numbered = ((k, line.strip("\r\n")) for k, line in enumerate(lines, 1) if line.strip())
    comments, first, number = list[str](), "", 0
    for number, first in numbered:  # noqa: B007
        if not first.lstrip().startswith(("#", "sep=")):  # Excel's word on what parts its columns
            break
        comments.append(first.lstrip(" \t#"))
    else:
        first = ""
    require(first, where, "no rows under a row of names, such as 'x,y' or 't,v'")
    require("\0" not in first, where, "holds NUL bytes: UTF-16 without its mark, or binary; save it as UTF-8")
    mark = max(";\t,|", key=lambda c: (first.count(c), c == ";"))
    mark = mark if mark in first else " "
    names = [name.strip() for name in cells_of(first, mark)]
    rows = itertools.chain([(number, first)], numbered)
    if _numbers(names, mark)[0] is not None:
        many = len(names)
        above = ([name.strip() for name in cells_of(text, mark)] for text in reversed(comments))
        names = next((found for found in above if len(found) == many and None in _numbers(found, mark)), [])
        what = f"line {number} holds numbers ({first[:60]}), no names; put a row of {many} names above them"
        require(names, where, f"{what}, with units, such as 'x [m]', 'lat', 't [ms]'")
    else:
        next(rows)
    return names, (  # to Python 1_5 would be 15
        (k, line, _numbers(cells_of(line.replace("_", "?"), mark), mark))
        for k, line in rows
        if not line.lstrip().startswith("#")
    )


def parted(name: str) -> tuple[str, str]:
    """A column's name and its unit, where it has one: `car.v [m/s]`, `speed (km/h)`."""
    found = _UNIT.match(name)
    return (found["name"], found["unit"].strip()) if found else (name, "")


def cells_of(line: str, mark: str) -> list[str]:
    """One line at a time, so that a stray quote spoils no other line."""
    if mark == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=mark), [])
    except csv.Error:  # a cell beyond csv's limit of 131,072 characters
        return [line]


def _numbers(cells: list[str], mark: str) -> list[float | None]:
    if mark != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    try:
        return [float(cell) for cell in cells]  # as nearly always
    except ValueError:
        return [_number(cell.strip()) for cell in cells]


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        pass
    if not text[:1].isdigit() or ":" not in text:
        return None
    clock = _CLOCK.fullmatch(text)
    if clock:
        return 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3].replace(",", "."))
    return seconds_of(text)


def seconds_of(text: str) -> float | None:
    """Seconds since 1970 of a time in ISO 8601, UTC where it does not say; None for what is none."""
    try:
        when = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
