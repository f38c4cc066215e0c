"""Pictures of a loop, as a diagram of blocks and wires, and of signals of a log over time."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit.plots.style import COLOURS, DPI, PALETTE, new_figure, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from steerkit.diagram.block import Port
    from steerkit.diagram.loop import Loop
    from steerkit.diagram.simulation import Log, Signal


def plot_diagram(loop: "Loop") -> "Figure":
    """The picture of a loop: blocks with class and rate, ports with units, wires coloured by their source.

    Signals flow from left to right, feedback returns underneath. A hollow port is an input that only `update` sees
    (`direct=False`): it breaks algebraic loops. Outputs that drive nothing are left out; `loop.units` lists all.
    """
    from matplotlib.figure import Figure

    boxes, lines, across, height = arrange(loop)
    margin, inch = 0.8, 0.185
    size = (across + 2.0 * margin) * inch, (height + 2.0 * margin + 0.8) * inch
    with style():
        figure = Figure(figsize=size, dpi=DPI)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-margin, across + margin), ylim=(height + margin + 0.8, -margin), aspect="equal")
    axes.axis("off")
    for number, line in enumerate(lines):  # the halo of a later wire cuts the earlier ones where they cross
        order = 1.0 + number / 100.0
        for shade, width, above in ((COLOURS["paper"], 4.0, 0.0), (PALETTE[line.source % len(PALETTE)], 1.2, 0.005)):
            for way in line.ways:
                axes.plot(*zip(*way), color=shade, lw=width, zorder=order + above, solid_joinstyle="round")
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
_FOOT, _GAP, _TRACK, _SLACK, _LANE = 0.45, 1.3, 0.62, 1.1, 0.8

Point = tuple[float, float]
Order = tuple[int, ...]


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


@dataclass(eq=False)
class Line:
    """An output's wire in the picture: from block number `source`, one polyline to each input that it drives."""

    source: int
    start: tuple[Box, str]
    ends: list[tuple[Box, str]]
    lane: float = 0.0
    """Height at which it runs above the boxes or below them, to columns other than the next."""
    tracks: dict[int, float] = field(default_factory=dict)
    """Where it runs up or down left of a column: x by column."""

    @property
    def far(self) -> list[int]:
        """The columns that it reaches by its lane."""
        return [box.column for box, _ in self.ends if box.column != self.start[0].column + 1]

    @property
    def ways(self) -> list[list[Point]]:
        """The polylines."""
        box, out = self.start
        y0, away = box.y + box.outputs[out], self.tracks[box.column + 1]
        ways = []
        for end, port in self.ends:
            y1, back = end.y + end.inputs[port], self.tracks[end.column]
            middle = [] if end.column == box.column + 1 else [(away, self.lane), (back, self.lane)]
            ways.append([(box.x + box.width, y0), (away, y0), *middle, (back, y1), (end.x, y1)])
        return ways


def arrange(loop: "Loop") -> tuple[tuple[Box, ...], tuple[Line, ...], float, float]:
    """The picture of a loop: a block stands right of those that drive it, in the order in which blocks are called.

    Returns the boxes in the order of the loop's blocks, the wires, total width and height.
    Wires to the next column run straight there; those that leave out columns run above all boxes, those back below.
    """
    boxes = tuple(_box(loop, name) for name in loop.names)
    made: dict[Port, Line] = {}
    for a, b in loop.wires:
        (source, out), (sink, port) = (loop.port_name(p).split(".") for p in (a, b))
        k = loop.names.index(source)
        made.setdefault(a, Line(k, (boxes[k], out), [])).ends.append((boxes[loop.names.index(sink)], port))
    lines = tuple(made.values())
    columns = _columns(loop, boxes, lines)
    top, height = _lanes(lines, _stack(columns, lines))
    for box in boxes:
        box.y += top
    x = 0.0
    for number in range(len(columns) + 1):
        x = _tracks(number, lines, x)
        column = columns[number] if number < len(columns) else []
        width = max((box.width for box in column), default=0.0)
        for box in column:
            box.x, box.width = x, width
        x += width
    return boxes, lines, x, height


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


def _columns(loop: "Loop", boxes: Sequence[Box], lines: Sequence[Line]) -> list[list[Box]]:
    """The boxes of each column: as few wires as possible run backwards, then the longest forward path counts."""
    weight = Counter((line.source, loop.names.index(box.name)) for line in lines for box, _ in line.ends)

    def backward(order: Order) -> float:
        at = {block: k for k, block in enumerate(order)}
        return sum(w for (a, b), w in weight.items() if at[a] > at[b])

    order = _ordered(tuple(map(loop.names.index, loop.order)), backward)
    for k, block in enumerate(order):
        boxes[block].column = max((boxes[a].column + 1 for a in order[:k] if weight[a, block]), default=0)
    last = max(box.column for box in boxes)
    return [[box for box in boxes if box.column == number] for number in range(last + 1)]


def _stack(columns: list[list[Box]], wires: Sequence[Line]) -> float:
    """Heights from left to right: a box stands where its wires from the column before are straight, if it can."""
    for column in columns:
        wanted: dict[int, float] = {}
        for box in column:
            straight = [
                line.start[0].y + line.start[0].outputs[line.start[1]] - box.inputs[port]
                for line in wires
                for end, port in line.ends
                if end is box and line.start[0].column == box.column - 1
            ]
            wanted[id(box)] = float(np.mean(straight)) if straight else 0.0
        column.sort(key=lambda box: wanted[id(box)])
        bottom = 0.0
        for box in column:
            box.y = max(wanted[id(box)], bottom)
            bottom = box.y + box.height + _GAP
    return max(box.y + box.height for column in columns for box in column)


def _lanes(wires: Sequence[Line], bottom: float) -> tuple[float, float]:
    """Gives wires that leave out columns their lanes; returns the height of those above, and of all."""
    far = [line for line in wires if line.far]
    above = [line for line in far if min(line.far) > line.start[0].column]
    below = [line for line in far if line not in above]
    top = _LANE * len(above)
    for side, first, step in ((above, top - _LANE, -_LANE), (below, top + bottom + 1.0, _LANE)):
        side.sort(key=lambda line: max(abs(column - line.start[0].column) for column in line.far))
        for n, line in enumerate(side):
            line.lane = first + step * n
    return top, top + bottom + 1.0 + _LANE * len(below)


def _tracks(channel: int, wires: Sequence[Line], x: float) -> float:
    """Gives each wire that runs up or down left of column `channel` its own track; returns the column's place."""
    spans: dict[int, tuple[list[float], list[float]]] = {}
    for k, line in enumerate(wires):
        box, out = line.start
        leaves = [end.y + end.inputs[port] for end, port in line.ends if end.column == channel]
        starts = box.column + 1 == channel
        enters = [box.y + box.outputs[out]] if starts else []
        if leaves or starts:
            by_lane = [line.lane] if channel in line.far or (starts and line.far) else []
            spans[k] = enters, leaves + by_lane

    def pair(a: int, b: int) -> float:
        """Cost of a's track left of b's: crossings, and much for horizontals that would lie on each other."""
        right_of_a, left_of_b = spans[a][1], spans[b][0]
        low_a, *_, high_a = sorted([*spans[a][0], *right_of_a] * 2)
        low_b, *_, high_b = sorted([*left_of_b, *spans[b][1]] * 2)
        crossings = sum(low_b < y < high_b for y in right_of_a) + sum(low_a < y < high_a for y in left_of_b)
        return crossings + 50.0 * sum(abs(y - z) < 0.3 for y in right_of_a for z in left_of_b)

    table = {(a, b): pair(a, b) for a in spans for b in spans if a != b}
    first = tuple(sorted(spans, key=lambda k: -min([*spans[k][0], *spans[k][1]])))
    order = _ordered(first, lambda order: sum(table[a, b] for n, a in enumerate(order) for b in order[n + 1 :]))
    for n, k in enumerate(order):
        wires[k].tracks[channel] = x + _SLACK + _TRACK * n
    return x + (2.0 * _SLACK + _TRACK * (len(order) - 1) if order else 0.0)


def _ordered(start: Order, cost: Callable[[Order], float]) -> Order:
    """The best order found by moving one entry at a time, as long as that helps."""
    best, least = start, cost(start)
    while True:
        others = [(a, tuple(b for b in best if b != a)) for a in best]
        moved = ((*others_of[:n], a, *others_of[n:]) for a, others_of in others for n in range(len(best)))
        candidate = min(moved, key=cost, default=best)
        if cost(candidate) >= least:
            return best
        best, least = candidate, cost(candidate)


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
