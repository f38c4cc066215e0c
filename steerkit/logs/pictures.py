"""A picture of what is in a log."""

from __future__ import annotations

from typing import Any

import numpy as np

from steerkit.diagram.units import degrees_of
from steerkit.logs.contents import Contents
from steerkit.logs.drive import Drive
from steerkit.plots.style import COLOURS, new_figure, style

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
