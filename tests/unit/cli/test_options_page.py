"""A report is one page: what was printed, the pictures, a verdict; nothing is loaded, and nothing of it is markup."""

import re
from pathlib import Path

from rich.console import Console

from steerkit.cli.options import write_page
from steerkit.plots.style import new_figure


def test_a_page_holds_what_was_printed_and_asks_for_nothing_else(tmp_path: Path) -> None:
    console = Console(record=True, quiet=False, width=60, file=(tmp_path / "out").open("w"))
    console.print("a < b", style="bold")
    file = tmp_path / "a.html"
    write_page(file, console, "log <1>.csv", ["fine & well"], [new_figure(1, title="a")[0]])
    page = file.read_text(encoding="utf-8")
    assert page.count("<img") == 1
    for found in ("<li>fine &amp; well</li>", "a &lt; b", "log &lt;1&gt;.csv"):
        assert found in page
    assert not re.search(r"(src|href)=['\"](?!data:)|@import|url\(", page)
