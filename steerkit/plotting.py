"""Pictures: signals of a log, the diagram of a loop, a course. One style, in this file; matplotlib only when used.

The figures are plain `matplotlib.figure.Figure` objects, made without pyplot: nothing global is touched, nothing
opens a window; `figure.savefig(...)`, or show them in a notebook.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from steerkit.diagram import Box, Line
    from steerkit.loop import Loop
    from steerkit.path import Path
    from steerkit.simulation import Log, Signal

PALETTE = (
    "#1f6fa8", "#d2691e", "#3a8258", "#8a5aa8", "#b8445a", "#7a6a53",
    "#2a9d9d", "#a98a1d", "#5b6f95", "#c0579a", "#6f9a2d", "#455a64",
)  # fmt: skip
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

_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.labelcolor": COLOURS["ink"],
    "axes.edgecolor": COLOURS["muted"],
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": COLOURS["grid"],
    "grid.linewidth": 0.8,
    "xtick.color": COLOURS["muted"],
    "ytick.color": COLOURS["muted"],
    "xtick.labelcolor": COLOURS["ink"],
    "ytick.labelcolor": COLOURS["ink"],
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "savefig.dpi": 150,
    "figure.dpi": 110,
    "figure.facecolor": COLOURS["paper"],
}


def style() -> Any:
    """A context in which matplotlib draws in the style of this file."""
    import matplotlib as mpl
    from cycler import cycler

    return mpl.rc_context(_STYLE | {"axes.prop_cycle": cycler(color=PALETTE)})


def new_figure(
    rows: int = 1, *, title: str = "", map_beside: bool = False, width: float = 9.0, height: float | None = None
) -> tuple[Figure, tuple[Axes, ...]]:
    """A figure with `rows` panels over a shared x axis; with `map_beside`, a square panel on the left comes first."""
    from matplotlib.figure import Figure

    with style():
        size = (width + (3.0 if map_beside else 0.0), height or (0.7 + (1.9 if rows > 1 else 2.8) * rows))
        figure = Figure(figsize=size, layout="constrained", dpi=_STYLE["figure.dpi"])
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


def plot_log(log: Log, signals: Sequence[Signal] | None = None, *, ax: Any = None) -> Figure:
    """Signals of a log over t, one panel a unit, all panels over the same t; returns the figure.

    signals: names or ports (default: all). ax: an axes, or one for each unit in the order of first use, to draw into.
    A vector port gives a line an entry, a batch a thin line a car. Raises KeyError for a signal that was not
    recorded, ValueError when the number of axes is not the number of units.
    """
    names = [_name(log, signal) for signal in (signals or [name for name in log if log[name].size])]
    by_unit: dict[str, list[str]] = {}
    for name in names:
        by_unit.setdefault(log.units[name], []).append(name)
    if ax is None:
        figure, panels = new_figure(len(by_unit))
    else:
        panels = tuple(np.atleast_1d(ax).flat)
        if len(panels) != len(by_unit):
            raise ValueError(f"plot_log: {len(panels)} axes for {len(by_unit)} units ({', '.join(by_unit)})")
        figure = panels[0].get_figure(root=True)  # type: ignore[assignment]
    for panel, (unit, group) in zip(panels, by_unit.items()):
        for number, name in enumerate(group):
            values = log[name]
            lines = values.reshape(len(log.t), math.prod(values.shape[1:]))
            many = lines.shape[1] > 1
            look = {"lw": 0.7, "alpha": max(0.15, 0.9 / lines.shape[1] ** 0.5)} if many else {"lw": 1.2}
            drawn = panel.plot(log.t, lines, color=PALETTE[number % len(PALETTE)], **look)
            drawn[0].set_label(f"{name} ({lines.shape[1]})" if many else name)
        brackets = "" if unit == "1" else f"[{unit}]"
        if len(group) == 1:
            panel.set_ylabel(f"{group[0]} {brackets}".strip())
        else:
            panel.set_ylabel(brackets)
            legend = panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), frameon=False, fontsize=8.0)
            for handle in legend.get_lines():
                handle.set(alpha=1.0, linewidth=1.6)
        panel.margins(x=0.0)
    panels[-1].set_xlabel("t [s]")
    return figure


def plot_diagram(loop: Loop) -> Figure:
    """The picture of a loop: blocks with class and rate, ports with units, wires coloured by their source.

    Signals flow from left to right, feedback returns underneath. A hollow port is an input that only `update` sees
    (`direct=False`): it breaks algebraic loops. Outputs that drive nothing are left out; `loop.units` lists all.
    """
    from matplotlib.figure import Figure

    from steerkit.diagram import arrange

    picture = arrange(loop)
    margin, inch = 0.8, 0.185
    size = (picture.width + 2.0 * margin) * inch, (picture.height + 2.0 * margin + 0.8) * inch
    with style():
        figure = Figure(figsize=size, dpi=_STYLE["figure.dpi"])
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-margin, picture.width + margin), ylim=(picture.height + margin + 0.8, -margin), aspect="equal")
    axes.axis("off")
    for number, line in enumerate(picture.lines):  # the halo of a later wire cuts the earlier ones where they cross
        _draw_wire(axes, line, PALETTE[line.source % len(PALETTE)], 1.0 + number / 100.0)
    for number, box in enumerate(picture.boxes):
        hollow = {port.name for port in loop.blocks[box.name].inputs if not port.direct}
        _draw_box(axes, box, PALETTE[number % len(PALETTE)], hollow)
    note = f"base step {loop.dt:g} s   ○ input seen by update only, not by output"
    axes.text(0.0, picture.height + margin, note, fontsize=7.5, color=COLOURS["muted"], va="center")
    return figure


def _draw_wire(axes: Axes, line: Line, colour: str, order: float) -> None:
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Curve

    points: list[tuple[float, float]] = []
    codes: list[Any] = []
    for way in line.ways:
        points.append(way[0])
        codes.append(Curve.MOVETO)
        for before, corner, after in zip(way, way[1:], way[2:]):
            points += [_towards(corner, before), corner, _towards(corner, after)]
            codes += [Curve.LINETO, Curve.CURVE3, Curve.CURVE3]
        points.append(way[-1])
        codes.append(Curve.LINETO)
    for shade, width, above in ((COLOURS["paper"], 4.0, 0.0), (colour, 1.2, 0.005)):
        axes.add_patch(PathPatch(Curve(points, codes), fc="none", ec=shade, lw=width, zorder=order + above))


def _draw_box(axes: Axes, box: Box, colour: str, hollow: set[str]) -> None:
    from matplotlib.colors import to_rgb
    from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

    from steerkit.diagram import HEAD

    tint = tuple(1.0 - 0.16 * (1.0 - channel) for channel in to_rgb(colour))
    shape = FancyBboxPatch(
        (box.x, box.y), box.width, box.height, boxstyle="round,pad=0,rounding_size=0.35",
        fc=COLOURS["paper"], ec=colour, lw=1.2, zorder=4,
    )  # fmt: skip
    axes.add_patch(shape)
    head = Rectangle((box.x, box.y), box.width, HEAD - 0.25, fc=tint, lw=0, zorder=4.1)
    axes.add_patch(head)
    head.set_clip_path(shape)
    axes.add_patch(FancyBboxPatch((box.x, box.y), box.width, box.height, boxstyle="round,pad=0,rounding_size=0.35",
                                  fc="none", ec=colour, lw=1.2, zorder=4.2))  # fmt: skip
    ink, muted = COLOURS["ink"], COLOURS["muted"]
    text: dict[str, Any] = {"zorder": 5, "va": "center"}
    axes.text(box.x + 0.5, box.y + 0.68, box.name, fontsize=9, fontweight="bold", color=ink, **text)
    axes.text(box.x + 0.5, box.y + 1.5, box.kind, fontsize=7, color=colour, **text)
    axes.text(box.x + box.width - 0.5, box.y + 0.68, box.rate, fontsize=7, color=ink, ha="right", **text)
    for name, y in box.inputs.items():
        axes.text(box.x + 0.65, box.y + y, name, fontsize=8, color=ink, **text)
        if name in hollow:
            axes.plot(box.x, box.y + y, "o", ms=4.6, mfc=COLOURS["paper"], mec=ink, mew=0.9, zorder=6)
        else:
            tip = [(box.x + 0.12, box.y + y), (box.x - 0.42, box.y + y - 0.24), (box.x - 0.42, box.y + y + 0.24)]
            axes.add_patch(Polygon(tip, fc=ink, lw=0, zorder=6))
    for name, y in box.outputs.items():
        axes.text(box.x + box.width - 0.5, box.y + y, box.labels[name], fontsize=8, color=ink, ha="right", **text)
    if not box.outputs:
        axes.text(
            box.x + box.width - 0.5, box.y + HEAD + 0.5, "logged only", fontsize=7, color=muted, ha="right", **text
        )


def _towards(corner: tuple[float, float], other: tuple[float, float], radius: float = 0.28) -> tuple[float, float]:
    """The point on the way from a corner to its neighbour where the rounding begins."""
    dx, dy = other[0] - corner[0], other[1] - corner[1]
    length = abs(dx) + abs(dy)
    part = min(radius / length, 0.5) if length else 0.0
    return corner[0] + part * dx, corner[1] + part * dy


def plot_course(path: Path, *, title: str | None = None) -> Figure:
    """A path seen from above, coloured by curvature, with start and direction; curvature over s beside it."""
    figure, (above, along) = new_figure(1, map_beside=True, height=4.2, title=repr(path) if title is None else title)
    line = path.samples
    bound = float(np.abs(line.kappa).max()) or 1.0
    dots = above.scatter(
        line.xy[:, 0], line.xy[:, 1], c=line.kappa, cmap="coolwarm_r", vmin=-bound, vmax=bound, s=9, lw=0, zorder=2
    )
    above.plot(line.xy[:, 0], line.xy[:, 1], color=COLOURS["muted"], lw=0.6, zorder=1)
    start, heading = line.xy[0], line.psi[0]
    reach = 0.08 * float(np.ptp(line.xy, axis=0).max())
    tip = start + reach * np.array([np.cos(heading), np.sin(heading)])
    above.annotate("", xy=tip, xytext=start, arrowprops={"arrowstyle": "-|>", "color": COLOURS["ink"], "lw": 1.4})
    above.plot(*start, "o", color=COLOURS["ink"], ms=5, zorder=3)
    above.annotate("start", start, xytext=(6, -11), textcoords="offset points", color=COLOURS["ink"], fontsize=8)
    above.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    with style():
        figure.colorbar(dots, ax=above, label="kappa [1/m], + = left", shrink=0.7)
    along.axhline(0.0, color=COLOURS["muted"], lw=0.7)
    along.plot(line.s, line.kappa, color=COLOURS["learned"])
    along.set(xlabel="s [m]", ylabel="kappa [1/m]")
    along.margins(x=0.0)
    return figure


def _name(log: Log, signal: Signal) -> str:
    """The signal's name, checked to be recorded."""
    log[signal]
    return signal if isinstance(signal, str) else log.loop.port_name(signal)  # type: ignore[union-attr]
