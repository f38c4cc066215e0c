"""What is in a log: its channels, what each is read as, the drive they make, and a picture of it."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from steerkit._support.quantities import QUANTITIES, ended_unit
from steerkit.diagram.units import degrees_of
from steerkit.logs.channels import Channel, ColumnMap, candidates
from steerkit.logs.drive import Drive
from steerkit.logs.reading import RawLog, drive_of
from steerkit.plots.style import COLOURS, new_figure, style

Row = dict[str, Any]
"""One channel in numbers: name, unit, samples, rate by the usual step [Hz], begin and end in the file's time [s], gaps
(steps of more than five usual ones, and 0.25 s), the longest step [s], low, high, samples that are invalid, and the
quantity that a drive takes it for; empty: none. In brackets: it could, another one is better. NaN: not known."""


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
    """What was read as what, and what was repaired."""


def contents(log: RawLog, columns: ColumnMap | None = None, *, steer_ratio: float | None = None) -> Contents:
    """Everything about a log: rows by channel, and the drive in it or why there is none.

    columns: what a user says of it. steer_ratio: as for `read_drive`.
    """
    given = columns or ColumnMap({})
    taken = {name: f"({q})" for q in reversed(QUANTITIES) for name in candidates(q, log.channels)}
    drive, trouble, used = None, "", given.columns
    try:
        used = given.with_guesses(log.channels, where=log.name).columns
        drive = drive_of(log, given, steer_ratio=steer_ratio)
    except ValueError as error:
        trouble = str(error)
    taken |= {column.name: quantity for quantity, column in used.items()}
    rows = tuple(_row(channel, taken.get(name, "")) for name, channel in log.channels.items())
    return Contents(log=log, rows=rows, drive=drive, trouble=trouble, notes=drive.notes if drive else log.notes)


def _row(channel: Channel, quantity: str) -> Row:
    t = channel.t[np.isfinite(channel.t)]
    steps = np.abs(np.diff(t)) if len(t) > 1 else np.zeros(1)
    values = channel.values[np.isfinite(channel.values)]
    begin, end = (float(t[0]), float(t[-1])) if len(t) else (math.nan, math.nan)
    low, high = (float(values.min()), float(values.max())) if len(values) else (math.nan, math.nan)
    return Row(
        name=channel.name,
        unit=channel.unit or ended_unit(quantity.strip("()"), channel.name),
        samples=len(channel.t),
        rate=channel.rate,
        begin=begin,
        end=end,
        gaps=int(np.sum(steps > max(5.0 * float(np.median(steps)), 0.25))),
        longest=float(steps.max()),
        low=low,
        high=high,
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
    shown = sorted(found.rows, key=lambda row: not row["quantity"])[:MOST]
    figure, axes = new_figure(len(shown), map_beside=False, title=f"{found.log.name}: no drive in it")
    for ax, row in zip(axes, shown):
        channel = found.log.channels[row["name"]]
        ax.plot(channel.t, channel.values, color=COLOURS["learned"], lw=0.8)
        ax.set_title(f"{row['name']} [{row['unit'] or '?'}]", fontsize=7, loc="left")
    axes[-1].set_xlabel("t [s], as in the file")
    return figure
