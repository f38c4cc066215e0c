"""The command `steerkit plot`: signals of a drive's log over time, as a picture or as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steerkit.cli.options import Quiet

PICTURES = (".png", ".svg", ".pdf")


def plot(
    log: Annotated[Path, typer.Argument(help="A log, such as drive.npz, or the directory of a learning run.")],
    signals: Annotated[
        list[str] | None, typer.Argument(help="Signals, such as path.e car.v; default: those that tell most.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Picture: .png, .svg or .pdf; default: beside the log.")] = None,
    table: Annotated[Path | None, typer.Option(help="Write all signals as a table too: .csv or .parquet.")] = None,
    quiet: Quiet = False,
) -> None:
    """Plot signals of a log over time; --table writes it for other programs."""
    from steerkit._support.errors import require
    from steerkit.diagram.simulation import Log
    from steerkit.learning import rundir
    from steerkit.plots.notebook import telling
    from steerkit.plots.style import save

    picture = out or (log / "signals.png" if log.is_dir() else log.with_name(f"{log.stem}-signals.png"))
    require(picture.suffix in PICTURES, f"--out {picture}", f"expected a name that ends in {', '.join(PICTURES)}")
    tables = table is None or table.suffix in (".csv", ".parquet")
    require(tables, f"--table {table}", "expected a name that ends in .csv or .parquet")
    record = rundir.drive_log(log) if log.is_dir() else Log.load(log)
    save(record.plot(*(signals or telling(record))), picture)
    if table is not None:
        record.save(table)
    if not quiet:
        print(f"{record!r}\npicture: {picture}{f', table: {table}' if table else ''}")
