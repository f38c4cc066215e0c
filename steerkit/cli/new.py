"""`steerkit new`: files to begin with."""

from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from steerkit._support.errors import known, require
from steerkit._support.files import write_text
from steerkit.cli import WORDS

_FILES: dict[str, list[str]] = WORDS["new"]
"""By kind: its file among the templates, and what to call with it."""


def new(
    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"One of {', '.join(_FILES)}.")],
    out: Annotated[Path | None, typer.Option(help="Where to write it (my_KIND, with its ending).")] = None,
) -> None:
    """Write a file that works as it is, to be changed into your own: a controller, agent, vehicle, course, ..."""
    name, after = _FILES[known(kind, _FILES, "new")]
    ending = Path(name.removesuffix(".txt")).suffix
    place = out or Path(f"my_{kind}{ending}")
    require(place.suffix == ending, f"--out {place}", f"a {kind}'s file ends in {ending}")
    require(not place.exists(), str(place), "is there already and is left as it is; another name: --out")
    write_text(place, (files("steerkit.cli") / "templates" / name).read_text(encoding="utf-8"))
    print(f"wrote {place}; next: {after.format(place)}")
