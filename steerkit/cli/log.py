"""The commands `steerkit log` and `steerkit plot`: what is in a log of any program, and its signals over time."""

import json
import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from steerkit._support.quantities import QUANTITIES, ended_unit
from steerkit.cli.options import Machine, Picture, Quiet, written
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.logs import RawLog, drive_of, read_drive, read_log
from steerkit.logs.channels import Channel, ColumnMap, candidates
from steerkit.logs.drive import Drive
from steerkit.plots.diagram import telling
from steerkit.plots.style import COLOURS, new_figure, styled

Dbc = Annotated[
    list[str] | None,
    typer.Option(help="What is in CAN frames: FILE.dbc, or a name of the package opendbc; repeatable."),
]
Map = Annotated[Path | None, typer.Option("--map", help="TOML file: which column is what, its unit.")]
Columns = Annotated[list[str] | None, typer.Option("--column", help="QUANTITY=COLUMN[:UNIT[:SCALE]]; repeatable.")]
SteerRatio = Annotated[
    float | None, typer.Option(help="The car's steering ratio, for logs of the road wheels' angle; default: 15.")
]


Row = dict[str, Any]
"""One channel in numbers: name, unit, samples, rate by the usual step [Hz], begin and end in the file's time [s], gaps
(steps of more than five usual ones, and 0.25 s), the longest step [s], low, high, samples that are invalid, and the
quantity that a drive takes it for; empty: none. In brackets: it could, another one is better. NaN: not known."""


def log(
    files: Annotated[list[str], typer.Argument(help="Files of one drive, on one clock; or the folder of a ROS 2 bag.")],
    columns: Map = None,
    column: Columns = None,
    dbc: Dbc = None,
    steer_ratio: SteerRatio = None,
    plot: Picture = None,
    quiet: Quiet = False,
    as_json: Machine = False,
) -> None:
    """Show what is in a log: its channels with rates, gaps and ranges, what each is read as, and the drive they make.

    Reads CSV, MATLAB, npz, Parquet, MCAP (a car server's, or ROS 2), ROS bags (.db3, .bag, a folder), MF4, and CAN logs
    (candump .log, .asc, .blf) with --dbc.
    """
    given = column_map(columns, column)
    console = Console(stderr=as_json, quiet=quiet and not as_json)
    console = console if console.is_terminal else Console(stderr=as_json, width=130, quiet=quiet)
    read = read_log(files, dbc=dbc or (), time=given.columns.get("t"))
    rows, drive, trouble = contents(read, given, steer_ratio=steer_ratio)
    notes = drive.notes if drive else read.notes
    more = [word for one in dbc or () for word in ("--dbc", one)] + (["--map", str(columns)] if columns else [])
    more += [word for one in column or () for word in ("--column", one)]
    more += ["--steer-ratio", f"{steer_ratio:g}"] if steer_ratio else []
    console.print(_table(read.name, rows))
    for note in notes:
        console.print(escape(note), soft_wrap=True, highlight=False)
    if drive is None:
        console.print(f"no drive in it: {escape(trouble)}", soft_wrap=True, highlight=False)
    else:
        console.print(f"a drive of {drive.t[-1]:.1f} s at {1.0 / drive.dt:.0f} Hz", highlight=False)
    if drive and drive.turns:
        said = escape(shlex.join([*files, *more]))
        console.print(f"next: steerkit identify {said} --out my-car.toml", soft_wrap=True, highlight=False)
    if plot is not None:
        picture(read, rows).savefig(plot)
        console.print(f"picture: {plot}", soft_wrap=True)
    if as_json:
        channels = [{k: v if v == v else None for k, v in row.items()} for row in rows]
        answer = {"channels": channels, "notes": list(notes), "trouble": trouble}
        print(json.dumps(answer | {"seconds": float(drive.t[-1]) if drive else None}))


def column_map(file: Path | None, words: list[str] | None) -> ColumnMap:
    """What --map and --column say together."""
    table = {} if file is None else ColumnMap.load(file).columns
    return ColumnMap({**table, **ColumnMap.parsed(words or ()).columns})


def _table(title: str, rows: Sequence[Row]) -> Table:
    columns = ("unit", "samples", "rate", "from", "to", "gaps", "range", "read as")
    table = Table(Column("channel", overflow="fold"), *columns, title=title)
    for row in rows:
        gaps = "{gaps}, {longest:.3g} s" if row["gaps"] else "none"
        spoilt = ", {invalid} no number" if row["invalid"] else ""
        texts = ("{samples}", "{rate:.4g} Hz", "{begin:.10g}", "{end:.10g}", gaps, "{low:.4g} to {high:.4g}" + spoilt)
        numbers = [text.format(**row) for text in texts]
        table.add_row(escape(row["name"]), escape(row["unit"] or "?"), *numbers, row["quantity"])
    return table


def plot(
    log: Annotated[
        Path, typer.Argument(help="A log of ours, drive.npz; of any program; or the directory of a learning run.")
    ],
    signals: Annotated[
        list[str] | None, typer.Argument(help="Signals, such as path.e car.v; default: the most informative.")
    ] = None,
    out: Annotated[Path | None, written("Picture to write; default: beside the log", ".png", ".pdf", ".svg")] = None,
    quiet: Quiet = False,
) -> None:
    """Plot signals of a log over time."""
    drawn = out or (log / "signals.png" if log.is_dir() else log.with_name(f"{log.stem}-signals.png"))
    record = record_of(log)
    record.plot(*(signals or telling(record))).savefig(drawn)
    if not quiet:
        print(f"{record!r}\npicture: {drawn}")


def record_of(place: Path) -> Log:
    """The signals of a learning run's directory, of a log of ours, or of the drive in one of another program."""
    if (place / "run.json").exists():
        return rundir.drive_log(place)
    if place.suffix == ".npz":
        return Log.load(place)
    try:
        return read_drive(place).to_log()
    except ValueError as error:
        raise ValueError(f"{error}; for its channels as they are: steerkit log {place} --plot log.png") from error


def contents(log: RawLog, given: ColumnMap, *, steer_ratio: float | None = None) -> tuple[list[Row], Drive | None, str]:
    """What is in a log: a row a channel; the drive that `read_drive` makes of it, if it makes one; and why not, else.

    given: what a user says of its columns. steer_ratio: as for `read_drive`.
    """
    taken = {name: f"({q})" for q in reversed(QUANTITIES) for name in candidates(q, log.channels)}
    drive, trouble, used = None, "", given.columns
    try:
        used = given.with_guesses(log.channels, where=log.name).columns
        drive = drive_of(log, given, steer_ratio=steer_ratio)
    except ValueError as error:
        trouble = str(error)
    taken |= {column.name: quantity for quantity, column in used.items()}
    return [_row(channel, taken.get(name, "")) for name, channel in log.channels.items()], drive, trouble


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
"""Channels that are drawn."""


@styled
def picture(log: RawLog, rows: Sequence[Row]) -> Any:
    """The matplotlib figure of a log: its channels as they are, those of a drive first."""
    shown = sorted(rows, key=lambda row: not row["quantity"])[:MOST]
    figure, axes = new_figure(len(shown), title=log.name)
    for ax, row in zip(axes, shown):
        channel = log.channels[row["name"]]
        ax.plot(channel.t, channel.values, color=COLOURS["learned"], lw=0.8)
        ax.set_title(f"{row['name']} [{row['unit'] or '?'}]", fontsize=7, loc="left")
    axes[-1].set_xlabel("t [s], as in the file")
    return figure
