"""The picture of a loop: blocks, wires, units, rates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from steerkit.plots.arrange import Box, Line, arrange
from steerkit.plots.style import COLOURS, DPI, PALETTE, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from steerkit.diagram.loop import Loop


def plot_diagram(loop: Loop) -> Figure:
    """The picture of a loop: blocks with class and rate, ports with units, wires coloured by their source.

    Signals flow from left to right, feedback returns underneath. A hollow port is an input that only `update` sees
    (`direct=False`): it breaks algebraic loops. Outputs that drive nothing are left out; `loop.units` lists all.
    """
    from matplotlib.figure import Figure

    picture = arrange(loop)
    margin, inch = 0.8, 0.185
    size = (picture.width + 2.0 * margin) * inch, (picture.height + 2.0 * margin + 0.8) * inch
    with style():
        figure = Figure(figsize=size, dpi=DPI)
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

    from steerkit.plots.arrange import HEAD

    tint = tuple(1.0 - 0.16 * (1.0 - channel) for channel in to_rgb(colour))
    shape = FancyBboxPatch(
        (box.x, box.y),
        box.width,
        box.height,
        boxstyle="round,pad=0,rounding_size=0.35",
        fc=COLOURS["paper"],
        ec=colour,
        lw=1.2,
        zorder=4,
    )
    axes.add_patch(shape)
    head = Rectangle((box.x, box.y), box.width, HEAD - 0.25, fc=tint, lw=0, zorder=4.1)
    axes.add_patch(head)
    head.set_clip_path(shape)
    axes.add_patch(
        FancyBboxPatch(
            (box.x, box.y),
            box.width,
            box.height,
            boxstyle="round,pad=0,rounding_size=0.35",
            fc="none",
            ec=colour,
            lw=1.2,
            zorder=4.2,
        )
    )
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
