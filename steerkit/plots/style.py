"""One style for all pictures; matplotlib is loaded only when it is used.

The figures are plain `matplotlib.figure.Figure` objects, made without pyplot: nothing global is touched, nothing
opens a window; `figure.savefig(...)`, or show them in a notebook.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CYCLE = "#1f6fa8 #d2691e #3a8258 #8a5aa8 #b8445a #7a6a53 #2a9d9d #a98a1d #5b6f95 #c0579a #6f9a2d #455a64"
PALETTE = tuple(_CYCLE.split())
"""Colours for one thing beside another, in this order."""

COLOURS = {
    "learned": PALETTE[0],
    "analytic": PALETTE[1],
    "wheel": PALETTE[2],
    "goal": "#8fc3a0",
    "recovery": "#f0c7ac",
    "limit": "#b5382c",
    "ink": "#24303c",
    "muted": "#8794a2",
    "grid": "#e6eaee",
    "paper": "#ffffff",
}
"""Colours with a meaning: who steers, the goal band, limits; and what the style is made of."""

DPI = 110


@contextmanager
def style() -> Iterator[None]:
    """A context in which matplotlib draws in the style of `steerkit.mplstyle`."""
    import matplotlib.style

    with matplotlib.style.context(Path(__file__).with_name("steerkit.mplstyle")):
        yield


styled = style()
"""A decorator: the function draws in that style."""


def png(figure: Any, dpi: int = DPI) -> bytes:
    """A figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()


def new_figure(
    rows: int = 1, *, title: str = "", map_beside: bool = False, width: float = 9.0, height: float | None = None
) -> "tuple[Figure, tuple[Axes, ...]]":
    """A figure with `rows` panels over a shared x axis; with `map_beside`, a square panel on the left comes first."""
    from matplotlib.figure import Figure

    with style():
        size = (width + (3.0 if map_beside else 0.0), height or (0.7 + (1.9 if rows > 1 else 2.8) * rows))
        figure = Figure(figsize=size, layout="constrained", dpi=DPI)
        columns = 2 if map_beside else 1
        grid = figure.add_gridspec(rows, columns, width_ratios=(1.0, 1.35)[:columns] if map_beside else None)
        panels: list[Axes] = []
        for row in range(rows):
            panels.append(figure.add_subplot(grid[row, columns - 1], sharex=panels[0] if panels else None))
        for panel in panels[:-1]:
            panel.tick_params(labelbottom=False)
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold", color=COLOURS["ink"])
        return figure, (*([figure.add_subplot(grid[:, 0])] if map_beside else []), *panels)
