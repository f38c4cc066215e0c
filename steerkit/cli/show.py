"""The command `steerkit show`: a learning run's story."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from steerkit.cli.options import Machine, Quiet


def show(
    run: Annotated[Path, typer.Argument(help="Directory of a learning run.")],
    diagnostics: Annotated[
        bool, typer.Option(help="Draw what the net believes, and where and when it failed.")
    ] = False,
    against: Annotated[list[Path] | None, typer.Option(help="Other runs to compare with (with --diagnostics).")] = None,
    quiet: Quiet = False,
    as_json: Machine = False,
) -> None:
    """Show a learning run: its counts, its episodes, learned against Stanley, and its pictures."""
    from steerkit.learning import report

    report.console.stderr = as_json
    figures = report.show(run, quiet=quiet)
    if diagnostics:
        from steerkit.learning.pictures.run import draw_all

        pictures = draw_all(run, against=against or ())
        report.console.print(f"diagnostics: {', '.join(map(str, pictures))}", soft_wrap=True)
    if as_json:
        print(json.dumps(figures))
