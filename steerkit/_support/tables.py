"""Tables of numbers in text: what parts their columns, where their names stand, what a cell holds."""

import csv
import itertools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

from steerkit._support.errors import require

_UNIT = re.compile(r"^(?P<name>.*\S)\s*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)")


@dataclass(frozen=True, eq=False)
class TextTable:
    """The names of a table's columns, and its rows as they are read."""

    names: list[str]
    """As they stand, with their units."""
    rows: Iterator[tuple[int, str, list[float | None]]]
    """Number of the line, the line, and its cells; None for what is no number."""


def text_table(lines: Iterable[str], where: str) -> TextTable:
    """The table in lines of text, with one row of names: the first row, or the last comment above rows of numbers.

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
    return TextTable(
        names,
        (  # to Python 1_5 would be 15
            (k, line, _numbers(cells_of(line.replace("_", "?"), mark), mark))
            for k, line in rows
            if not line.lstrip().startswith("#")
        ),
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
