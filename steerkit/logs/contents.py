"""What is in a log: its channels with rates, gaps and ranges, what each would be read as, and what to do next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from steerkit.logs.columns import ColumnMap
from steerkit.logs.drive import Drive
from steerkit.logs.names import QUANTITIES, candidates, ended_unit
from steerkit.logs.reading import RawLog, drive_of


@dataclass(frozen=True, kw_only=True)
class Row:
    """One channel, told."""

    name: str
    unit: str
    samples: int
    rate: float
    """By the usual step [Hz]."""
    begin: float
    """Of the first sample, in the file's time [s]."""
    end: float
    gaps: int
    """Steps of more than five usual ones, and 0.25 s."""
    longest: float
    """The longest step [s]."""
    low: float
    high: float
    invalid: int
    """Samples that are no number."""
    quantity: str
    """What a drive takes it for; empty: nothing. In brackets: it could, another one is better."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Contents:
    """What is in a log; `contents(read_log(...))` makes one."""

    log: RawLog
    rows: tuple[Row, ...]
    drive: Drive | None
    """The drive that `read_drive` makes of it; None where it makes none."""
    trouble: str
    """Why it makes none."""
    notes: tuple[str, ...]
    """What was read as what, what was repaired, and what else tells the same."""

    def table(self) -> list[dict[str, Any]]:
        """The rows as a program would read them."""
        return [{k: v if v == v else None for k, v in vars(row).items()} for row in self.rows]


def contents(log: RawLog, columns: ColumnMap | None = None, **how: Any) -> Contents:
    """Everything about a log: rows by channel, and the drive in it or why there is none.

    columns: what a user says of it. how: `steer_ratio`, `dt`, `trusted` as for `read_drive`.
    """
    given = columns or ColumnMap({})
    drive, trouble, notes = None, "", log.notes
    try:
        drive = drive_of(log, given, **how)
        notes = drive.notes
    except ValueError as error:
        trouble = str(error)
    taken = _taken(log, given)
    rows = tuple(_row(name, log, taken.get(name, "")) for name in log.channels)
    return Contents(log=log, rows=rows, drive=drive, trouble=trouble, notes=notes)


def _taken(log: RawLog, given: ColumnMap) -> dict[str, str]:
    """Channel to the quantity that it is, or could be."""
    taken: dict[str, str] = {}
    for quantity in QUANTITIES:
        for name in candidates(quantity, log.channels):
            taken.setdefault(name, f"({quantity})")
    try:
        used = given.with_guesses(log.channels, where=log.name).columns
    except ValueError:
        used = {q: c for q, c in given.columns.items() if c.name in log.channels}
    return taken | {column.name: quantity for quantity, column in used.items()}


def _row(name: str, log: RawLog, quantity: str) -> Row:
    channel = log.channels[name]
    t = channel.t[np.isfinite(channel.t)]
    steps = np.abs(np.diff(t)) if len(t) > 1 else np.zeros(1)
    values = channel.values[np.isfinite(channel.values)]
    nothing = float("nan")
    return Row(
        name=name,
        unit=channel.unit or ended_unit(quantity.strip("()"), name),
        samples=len(channel.t),
        rate=channel.rate,
        begin=float(t[0]) if len(t) else nothing,
        end=float(t[-1]) if len(t) else nothing,
        gaps=int(np.sum(steps > max(5.0 * float(np.median(steps)), 0.25))),
        longest=float(steps.max()),
        low=float(values.min()) if len(values) else nothing,
        high=float(values.max()) if len(values) else nothing,
        invalid=len(channel.values) - len(values),
        quantity=quantity,
    )
