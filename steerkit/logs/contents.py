"""What is in a log: its channels, what each is read as, the drive they make, and a picture of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from steerkit.diagram.units import degrees_of
from steerkit.logs.channels import QUANTITIES, ColumnMap, candidates, ended_unit
from steerkit.logs.drive import Drive
from steerkit.logs.reading import RawLog, drive_of
from steerkit.plots.style import COLOURS, new_figure, style


@dataclass(frozen=True, kw_only=True)
class Row:
    """One channel in numbers."""

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
    """What was read as what, what was repaired, and what else holds the same."""

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


MOST = 8
"""Channels that are drawn where there is no drive."""


def picture(found: Contents) -> Any:
    """The matplotlib figure of a log: the drive in it, with its gaps, or else its channels as they are."""
    with style():
        return _channels(found) if found.drive is None else _drive(found.drive)


def _drive(drive: Drive) -> Any:
    placed = drive.x is not None and drive.y is not None and bool(np.isfinite(drive.x).any())
    figure, axes = new_figure(3, map_beside=placed, title=drive.name)
    if placed:
        where, axes = axes[0], axes[1:]
        where.plot(np.asarray(drive.x), np.asarray(drive.y), color=COLOURS["learned"], lw=1.0)
        where.set(xlabel="x [m]", ylabel="y [m]")
        where.set_aspect("equal", adjustable="datalim")
    curves = (
        ("steering wheel [deg]", degrees_of(drive.delta_sw)),
        ("speed [m/s]", drive.v),
        ("yaw rate [deg/s]", degrees_of(drive.r)),
    )
    for ax, (label, values) in zip(axes, curves):
        ax.plot(drive.t, np.where(drive.measured, values, np.nan), color=COLOURS["learned"], lw=0.9)
        ax.plot(drive.t, np.where(drive.measured, np.nan, values), color=COLOURS["muted"], lw=0.9, ls=":")
        ax.set_ylabel(label)
    axes[-1].set_xlabel("t [s]; dotted: bridged, or within 1 s of a gap")
    return figure


def _channels(found: Contents) -> Any:
    shown = sorted(found.rows, key=lambda row: (not row.quantity, found.rows.index(row)))[:MOST]
    figure, axes = new_figure(len(shown), map_beside=False, title=f"{found.log.name}: no drive in it")
    for ax, row in zip(axes, shown):
        channel = found.log.channels[row.name]
        ax.plot(channel.t, channel.values, color=COLOURS["learned"], lw=0.8)
        ax.set_title(f"{row.name} [{row.unit or '?'}]", fontsize=7, loc="left")
    axes[-1].set_xlabel("t [s], as in the file")
    return figure
