"""A report as one HTML page that loads nothing: its look, its tables and its pictures, on a phone, a desk or paper."""

import base64
import time
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from steerkit._support.version import version
from steerkit.plots.style import png

DPI = 190
"""Of a picture: sharp where it is 5 inches wide on paper."""
_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}</style></head>
<body>
{body}
<footer>{command}steerkit {version}, {date}. {closing}</footer>
</body></html>
"""


class Html(str):
    """Text that is markup already; any other is escaped."""


def html(text: object) -> Html:
    """Text as markup."""
    return text if isinstance(text, Html) else Html(escape(str(text)))


def document(title: str, body: str, *, command: str = "", closing: str = "") -> str:
    """A whole page. body: markup; command: that wrote it; closing: its last sentence."""
    return _PAGE.format(
        title=html(title),
        style=Path(__file__).with_name("page.css").read_text(encoding="utf-8"),
        body=body,
        command=f"<code>{html(command)}</code>, " if command else "",
        version=version(),
        date=time.strftime("%Y-%m-%d %H:%M"),
        closing=html(closing),
    )


def picture(figure: Any, caption: str = "", *, alt: str = "") -> Html:
    """A figure of matplotlib, in the page itself."""
    data = base64.b64encode(png(figure, DPI)).decode()
    below = f"<figcaption>{html(caption)}</figcaption>" if caption else ""
    return Html(f"<figure><img alt='{html(alt or caption)}' src='data:image/png;base64,{data}'>{below}</figure>")


def table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> Html:
    """Rows under names; a narrow window scrolls the table, not the page."""
    top = "".join(f"<th>{html(name)}</th>" for name in head)
    cells = ["".join(f"<td>{html(cell)}</td>" for cell in row) for row in rows]
    body = "\n".join(f"<tr>{row}</tr>" for row in cells)
    return Html(f"<div class=wide><table><thead><tr>{top}</tr></thead>\n<tbody>{body}</tbody></table></div>\n")
