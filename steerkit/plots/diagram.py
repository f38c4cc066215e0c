"""Pictures of a loop, as a diagram of blocks and wires, and of signals of a log over time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from steerkit.plots.style import COLOURS, DPI, PALETTE, new_figure, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from steerkit.diagram.loop import Loop
    from steerkit.diagram.simulation import Log, Signal


def plot_diagram(loop: "Loop") -> "Figure":
    """The picture of a loop: blocks with class and rate, ports with units, wires coloured by their source.

    Signals flow from left to right, feedback returns underneath. A hollow port is an input that only `update` sees
    (`direct=False`): it breaks algebraic loops. Outputs that drive nothing are left out; `loop.units` lists all.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    boxes, wires, across, height = arrange(loop)
    margin, inch = 0.8, 0.185
    size = (across + 2.0 * margin) * inch, (height + 2.0 * margin + 0.8) * inch
    with style():
        figure = Figure(figsize=size, dpi=DPI)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-margin, across + margin), ylim=(height + margin + 0.8, -margin), aspect="equal")
    axes.axis("off")
    for number, wire in enumerate(wires):  # the halo of a later wire cuts the earlier ones where they cross
        curve = Path(wire.corners, [Path.MOVETO] + [Path.CURVE4] * (len(wire.corners) - 1))
        for shade, width, above in ((COLOURS["paper"], 4.0, 0.0), (PALETTE[wire.source % len(PALETTE)], 1.2, 0.005)):
            axes.add_patch(PathPatch(curve, fc="none", ec=shade, lw=width, zorder=1.0 + number / 100.0 + above))
    for number, box in enumerate(boxes):
        hollow = {port.name for port in loop.blocks[box.name].inputs if not port.direct}
        _draw_box(axes, box, PALETTE[number % len(PALETTE)], hollow)
    note = f"base step {loop.dt:g} s   ○ input seen by update only, not by output"
    axes.text(0.0, height + margin, note, fontsize=7.5, color=COLOURS["muted"], va="center")
    return figure


def _draw_box(axes: "Axes", box: "Box", colour: str, hollow: set[str]) -> None:
    from matplotlib.colors import to_rgb
    from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

    tint = tuple(1.0 - 0.16 * (1.0 - channel) for channel in to_rgb(colour))
    corner, rounded = (box.x, box.y), "round,pad=0,rounding_size=0.35"
    for face, order in ((COLOURS["paper"], 4.0), ("none", 4.2)):
        shape = FancyBboxPatch(
            corner, box.width, box.height, boxstyle=rounded, fc=face, ec=colour, lw=1.2, zorder=order
        )
        axes.add_patch(shape)
    head = Rectangle(corner, box.width, HEAD - 0.25, fc=tint, lw=0, zorder=4.1)
    axes.add_patch(head)
    head.set_clip_path(shape)
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


HEAD = 2.3
CHARACTER = 0.36
_FOOT, _GAP, _CHANNEL, _LANE = 0.45, 1.3, 4.0, 0.6

Point = tuple[float, float]


@dataclass(eq=False)
class Box:
    """A block in the picture: its texts, its ports by name with their height below the top, its place and size."""

    name: str
    kind: str
    rate: str
    inputs: dict[str, float]
    outputs: dict[str, float]
    labels: dict[str, str]
    width: float
    height: float
    column: int = 0
    x: float = 0.0
    y: float = 0.0


class Wire(NamedTuple):
    """A wire in the picture: the number of its block, and the corners of cubic curves from output to input."""

    source: int
    corners: list[Point]


def arrange(loop: "Loop") -> tuple[list[Box], list[Wire], float, float]:
    """The picture of a loop: a block stands right of those before it in a tick that drive it, in a column of its own.

    Returns the boxes in the order of the loop's blocks, the wires, total width and height. Wires to the next column
    run straight there; those that leave out columns run above all boxes, those back below, an output's in one lane.
    """
    boxes = {name: _box(loop, name) for name in loop.names}
    ends = [(*loop.port_name(a).split("."), *loop.port_name(b).split(".")) for a, b in loop.wires]
    for k, name in enumerate(loop.order):
        drive = [boxes[a].column + 1 for a, _, b, _ in ends if b == name and a in loop.order[:k]]
        boxes[name].column = max(drive, default=0)
    columns = [[box for box in boxes.values() if box.column == n] for n in range(len(boxes))]
    skips = {
        (a, out): boxes[b].column - boxes[a].column for a, out, b, _ in ends if boxes[b].column != boxes[a].column + 1
    }
    above, below = ([key for key, jump in skips.items() if (jump > 0) == up] for up in (True, False))
    top, x, bottom = _LANE * len(above), _CHANNEL, 0.0
    for column in filter(None, columns):
        y, width = top, max(box.width for box in column)
        for box in column:
            box.x, box.y, box.width = x, y, width
            y += box.height + _GAP
        x, bottom = x + width + _CHANNEL, max(bottom, y)
    lanes = {key: top - _LANE * (n + 1) for n, key in enumerate(above)}
    lanes |= {key: bottom + _LANE * n for n, key in enumerate(below)}
    wires = []
    for a, out, b, port in ends:
        (one, other), straight = (boxes[a], boxes[b]), boxes[b].column == boxes[a].column + 1
        start, end = (one.x + one.width, one.y + one.outputs[out]), (other.x, other.y + other.inputs[port])
        wires.append(Wire(loop.names.index(a), _corners(start, end, None if straight else lanes[a, out])))
    return list(boxes.values()), wires, x, bottom + _LANE * len(below)


def _corners(start: Point, end: Point, lane: float | None) -> list[Point]:
    """Of the curves from an output to an input: one to the next column, else up or down to a lane and back."""
    (x0, y0), (x1, y1) = start, end
    if lane is None:
        return [start, (x0 + 0.5 * _CHANNEL, y0), (x1 - 0.5 * _CHANNEL, y1), end]
    bend, reach = (0.5 * _CHANNEL, _CHANNEL) if x1 > x0 else (_CHANNEL, 0.0)
    there, back = (x0 + reach, lane), (x1 - reach, lane)
    away = [start, (x0 + bend, y0), (x0 + bend, lane), there]
    return [*away, there, back, back, (x1 - bend, lane), (x1 - bend, y1), end]


def _box(loop: "Loop", name: str) -> Box:
    block = loop.blocks[name]
    wired = {a.spec.name for a, _ in loop.wires if a.block is block}
    outputs = [out for out in block.outputs if out.name in wired]
    labels = {p.name: f"{p.name} [{p.unit}]" if p.unit != "1" else p.name for p in outputs}
    rate_text = f"{1.0 / block.dt:.4g} Hz"
    rows = max(len(block.inputs), len(outputs), 1)
    wide = max([len(p.name) for p in block.inputs], default=0) + max(map(len, labels.values()), default=0)
    width = CHARACTER * max(wide + 4, len(name) * 1.35 + len(rate_text) + 3, len(type(block).__name__) * 0.85 + 2)
    return Box(
        name=name,
        kind=type(block).__name__,
        rate=rate_text,
        inputs={p.name: HEAD + 0.5 + n for n, p in enumerate(block.inputs)},
        outputs={p.name: HEAD + 0.5 + n for n, p in enumerate(outputs)},
        labels=labels,
        width=width,
        height=HEAD + rows + _FOOT,
    )


_SHOWN = ("e", "delta_sw", "v", "a_y", "psi_e", "r")  # outputs worth a panel, best first
_PANELS = 4


def plot_log(log: "Log", signals: "Sequence[Signal] | None" = None) -> "Figure":
    """Signals of a log over t, one panel a unit, all panels over the same t; returns the figure.

    signals: names or ports (default: all). A vector gives a line an entry, a batch a thin line a car. Raises KeyError
    for a signal that was not recorded.
    """
    names = [_name(log, signal) for signal in (signals or [name for name in log if log[name].size])]
    by_unit: dict[str, list[str]] = {}
    for name in names:
        by_unit.setdefault(log.units[name], []).append(name)
    figure, panels = new_figure(len(by_unit))
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


def telling(log: "Log") -> list[str]:
    """Up to four signals, of different names, that tell most about a drive; else the first ones."""
    chosen = []
    for name in _SHOWN:
        chosen += [signal for signal in log if signal.rpartition(".")[2] == name and log[signal].size][:1]
    return chosen[:_PANELS] or [signal for signal in log if log[signal].size][:_PANELS]


def _name(log: "Log", signal: "Signal") -> str:
    """The signal's name, checked to be recorded."""
    log[signal]
    return signal if isinstance(signal, str) else log.loop.port_name(signal)  # type: ignore[union-attr]
