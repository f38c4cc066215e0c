"""The commands `steerkit log` and `steerkit plot`: what is in a log of any program, and its signals over time."""

import json
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from steerkit.cli.options import Machine, Picture, Quiet, written
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.logs import ColumnMap, read_drive
from steerkit.logs.contents import contents, picture
from steerkit.logs.reading import read_log
from steerkit.plots.diagram import telling
from steerkit.plots.style import save

Dbc = Annotated[
    list[str] | None,
    typer.Option(help="What is in CAN frames: FILE.dbc, or a name of the package opendbc; repeatable."),
]
Map = Annotated[Path | None, typer.Option("--map", help="TOML file: which column is what, its unit.")]
Columns = Annotated[list[str] | None, typer.Option("--column", help="QUANTITY=COLUMN[:UNIT[:SCALE]]; repeatable.")]
SteerRatio = Annotated[
    float | None, typer.Option(help="The car's steering ratio, for logs of the road wheels' angle; default: 15.")
]


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
    found = contents(read_log(files, dbc=dbc or (), time=given.columns.get("t")), given, steer_ratio=steer_ratio)
    more = [word for one in dbc or () for word in ("--dbc", one)] + (["--map", str(columns)] if columns else [])
    more += [word for one in column or () for word in ("--column", one)]
    more += ["--steer-ratio", f"{steer_ratio:g}"] if steer_ratio else []
    _report(console, found, shlex.join([*files, *more]))
    if plot is not None:
        save(picture(found), plot)
        console.print(f"picture: {plot}", soft_wrap=True)
    if as_json:
        rows = [{k: v if v == v else None for k, v in row.items()} for row in found.rows]
        answer = {"channels": rows, "notes": list(found.notes), "trouble": found.trouble}
        print(json.dumps(answer | {"seconds": float(found.drive.t[-1]) if found.drive else None}))


def column_map(file: Path | None, words: list[str] | None) -> ColumnMap:
    """What --map and --column say together."""
    table = {} if file is None else ColumnMap.load(file).columns
    return ColumnMap({**table, **ColumnMap.parsed(words or ()).columns})


def _report(console: Any, found: Any, said: str) -> None:
    columns = ("unit", "samples", "rate", "from", "to", "gaps", "range", "read as")
    table = Table(Column("channel", overflow="fold"), *columns, title=found.log.name)
    for row in found.rows:
        gaps = "{gaps}, {longest:.3g} s" if row["gaps"] else "none"
        spoilt = ", {invalid} no number" if row["invalid"] else ""
        texts = ("{samples}", "{rate:.4g} Hz", "{begin:.10g}", "{end:.10g}", gaps, "{low:.4g} to {high:.4g}" + spoilt)
        numbers = [text.format(**row) for text in texts]
        table.add_row(escape(row["name"]), escape(row["unit"] or "?"), *numbers, row["quantity"])
    console.print(table)
    for note in found.notes:
        console.print(escape(note), soft_wrap=True, highlight=False)
    if found.drive is None:
        console.print(f"no drive in it: {escape(found.trouble)}", soft_wrap=True, highlight=False)
        return
    drive = found.drive
    console.print(f"a drive of {drive.t[-1]:.1f} s at {1.0 / drive.dt:.0f} Hz", highlight=False)
    if drive.turns:
        console.print(f"next: steerkit identify {escape(said)} --out my-car.toml", soft_wrap=True, highlight=False)


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
    save(record.plot(*(signals or telling(record))), drawn)
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
