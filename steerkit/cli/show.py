"""The command `steerkit show`: what came of a learning run, or several runs as one table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from steerkit.cli.options import Machine, Quiet


def show(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Directories of learning runs.")],
    diagnostics: Annotated[
        bool, typer.Option(help="Draw what the net believes, and where and when it failed.")
    ] = False,
    against: Annotated[list[Path] | None, typer.Option(help="Other runs to compare with (with --diagnostics).")] = None,
    film: Annotated[
        Path | None, typer.Option(help="Film of the run to write, from its first second on (.gif).")
    ] = None,
    film_lasts: Annotated[float, typer.Option(help="Length of the film in s, 2 to 120.")] = 20.0,
    quiet: Quiet = False,
    as_json: Machine = False,
) -> None:
    """Show a learning run: counts, episodes, learned against Stanley, and its pictures; several as one table."""
    from steerkit._support.console import console
    from steerkit._support.errors import require
    from steerkit.learning import report

    console.stderr = as_json
    if len(runs) > 1:
        require(not diagnostics, "show --diagnostics", "takes one run; the others go with --against")
        require(film is None, "show --film", "takes one run")
        rows = report.show_several(runs)
        if as_json:
            print(json.dumps({"runs": rows}))
        return
    (run,) = runs
    if film is not None:  # before what takes longer, as its name may be refused
        from steerkit.learning.pictures.film import film_of

        console.print(f"film: {film_of(run, film, lasts=film_lasts)}", soft_wrap=True)
    figures = report.show(run, quiet=quiet)
    if diagnostics:
        from steerkit.learning.pictures.run import draw_all

        drawn = draw_all(run, against=against or ())
        console.print(f"diagnostics: {', '.join(map(str, drawn))}", soft_wrap=True)
    if as_json:
        print(json.dumps(figures))
