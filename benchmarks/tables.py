"""How studies show their figures to people: a line for each result as it comes, tables, and figures by name."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table


def cell(value: Any) -> str:
    """A figure with three digits; anything else as it is."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def as_line(row: Any) -> str:
    """A result, a mapping or a dataclass, in one line."""
    return ", ".join(f"{name} {cell(value)}" for name, value in _named(row).items())


def say(text: str) -> None:
    """A line on the error output: how far a study is."""
    Console(stderr=True).print(text, soft_wrap=True, markup=False, highlight=False)


def show(title: str, rows: Sequence[Any]) -> None:
    """A table of results with the same names; nothing where there are none."""
    every = [_named(row) for row in rows]
    if not every:
        return
    table = Table(*[escape(name.replace("_", " ")) for name in every[0]], title=escape(title), title_justify="left")
    for row in every:
        table.add_row(*[escape(cell(value)) for value in row.values()])
    (Console() if Console().is_terminal else Console(width=200)).print(table)


def show_figures(figures: Mapping[str, Any]) -> None:
    """A line a figure; those that are tables themselves are left out."""
    for name, value in figures.items():
        if not isinstance(value, (Mapping, list, tuple)):
            print(f"{name:30s} {cell(value)}")


def _named(row: Any) -> dict[str, Any]:
    """What a result tells by name, but for what is a mapping itself."""
    values = row if isinstance(row, Mapping) else asdict(row)
    return {name: value for name, value in values.items() if not isinstance(value, Mapping)}
