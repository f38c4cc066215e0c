"""A report of a command as one HTML page: verdict, pictures, and all that it printed; nothing else is loaded."""

from __future__ import annotations

import base64
import shlex
import sys
import time
from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import Any

from steerkit import __version__
from steerkit._support.files import write_text
from steerkit.plots.notebook import png

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>body {{ font-family: sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em }}
img {{ max-width: 100% }} pre {{ overflow-x: auto; line-height: 1.15 }}</style></head>
<body><h1>{title}</h1>
<ul>{verdict}</ul>
{pictures}
<pre>{text}</pre>
<p><code>{command}</code>, steerkit {version}, {date}. Simulated or computed from the recording; no car was driven.</p>
</body></html>
"""


def write_page(file: Path, console: Any, title: str, verdict: Iterable[str], figures: Iterable[Any]) -> None:
    """Write the report of a command.

    console: a `rich.console.Console(record=True)` to which it printed. verdict: sentences. figures: of matplotlib.
    """
    images = [base64.b64encode(png(figure)).decode() for figure in figures]
    page = _PAGE.format(
        title=escape(title),
        verdict="".join(f"<li>{escape(sentence)}</li>" for sentence in verdict),
        pictures="\n".join(f"<img alt='{escape(title)}' src='data:image/png;base64,{image}'>" for image in images),
        text=console.export_html(inline_styles=True, code_format="{code}"),
        command=escape(shlex.join(["steerkit", *sys.argv[1:]])),
        version=__version__,
        date=time.strftime("%Y-%m-%d %H:%M"),
    )
    write_text(file, page)
