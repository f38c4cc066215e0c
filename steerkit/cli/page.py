"""A report of a command as one HTML page: verdict, pictures, and all that it printed; nothing else is loaded."""

import shlex
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from steerkit._support.files import write_text
from steerkit.plots.page import document, html, picture


def write_page(file: Path, console: Any, title: str, verdict: Iterable[str], figures: Iterable[Any]) -> None:
    """Write the report of a command.

    console: a `rich.console.Console(record=True)` to which it printed. verdict: sentences. figures: of matplotlib.
    """
    sentences = "".join(f"<li>{html(sentence)}</li>" for sentence in verdict)
    pictures = "\n".join(picture(figure, alt=title) for figure in figures)
    printed = console.export_html(inline_styles=True, code_format="{code}")
    page = document(
        title,
        f"<h1>{html(title)}</h1>\n<ul>{sentences}</ul>\n{pictures}\n<pre>{printed}</pre>",
        command=shlex.join(["steerkit", *sys.argv[1:]]),
        closing="Simulated or computed from the recording; no car was driven.",
    )
    write_text(file, page)
