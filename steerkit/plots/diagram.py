"""The picture of a loop: blocks, wires, units, rates."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import isotonic_regression

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


def _towards(corner: tuple[float, float], other: tuple[float, float], radius: float = 0.28) -> tuple[float, float]:
    """The point on the way from a corner to its neighbour where the rounding begins."""
    dx, dy = other[0] - corner[0], other[1] - corner[1]
    length = abs(dx) + abs(dy)
    part = min(radius / length, 0.5) if length else 0.0
    return corner[0] + part * dx, corner[1] + part * dy


HEAD = 2.3
CHARACTER = 0.36
_FOOT, _GAP, _TRACK, _SLACK = 0.45, 1.3, 0.62, 1.1
_SWEEPS = 24

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
    x: float = 0.0
    y: float = 0.0


@dataclass(eq=False)
class Line:
    """An output's wire in the picture: from block number `source`, one polyline to each input that it drives."""

    source: int
    ways: list[list[Point]]


@dataclass(frozen=True)
class Diagram:
    """The whole picture: boxes in the order of the loop's blocks, wires, total width and height."""

    boxes: tuple[Box, ...]
    lines: tuple[Line, ...]
    width: float
    height: float


@dataclass(eq=False)
class _Net:
    """One output and all the inputs it drives, with the way it takes."""

    source: int
    out: str
    sinks: list[tuple[int, str]]
    lane: float | None = None
    track: dict[int, float] = field(default_factory=dict)  # channel -> x


@dataclass(eq=False)
class _Node:
    """What takes room in a column: a box, or a wire that only passes through."""

    key: Hashable
    height: float
    y: float = 0.0


def arrange(loop: Loop) -> Diagram:
    """The picture of a loop."""
    boxes = tuple(_box(loop, i) for i in range(len(loop.names)))
    nets = _nets(loop)
    layer = _layers(len(boxes), nets, tuple(loop.names.index(name) for name in loop.order))
    return _Router(boxes, nets, layer).diagram()


def _box(loop: Loop, i: int) -> Box:
    name, block = loop.names[i], loop.blocks[loop.names[i]]
    wired = {a.spec.name for a, _ in loop.wires if a.block is block}
    outputs = [out for out in block.outputs if out.name in wired]
    labels = {p.name: f"{p.name} [{p.unit}]" if p.unit != "1" else p.name for p in outputs}
    rate = 1.0 / block.dt
    rate_text = f"{rate:.4g} Hz"
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


def _nets(loop: Loop) -> list[_Net]:
    nets: dict[tuple[int, str], _Net] = {}
    number = {id(block): i for i, block in enumerate(loop.blocks.values())}
    for a, b in loop.wires:
        source, out = number[id(a.block)], a.spec.name
        nets.setdefault((source, out), _Net(source, out, [])).sinks.append((number[id(b.block)], b.spec.name))
    return list(nets.values())


def _layers(n: int, nets: Sequence[_Net], order: Order) -> list[int]:
    """The column of each block: as few wires as possible run backwards, then the longest forward path counts."""
    weight: dict[tuple[int, int], int] = defaultdict(int)
    for net in nets:
        for sink, _ in net.sinks:
            weight[net.source, sink] += 1

    def backward(order: Order) -> float:
        at = {block: k for k, block in enumerate(order)}
        return sum(w for (a, b), w in weight.items() if at[a] > at[b])

    order = _ordered(order, backward)
    layer = [0] * n
    for k, block in enumerate(order):
        layer[block] = max([layer[a] + 1 for a in order[:k] if weight.get((a, block))], default=0)
    for k in reversed(range(n)):  # one with more wires ahead than behind moves up to those it feeds
        ahead = {b: weight[order[k], b] for b in order[k + 1 :] if weight.get((order[k], b))}
        if sum(ahead.values()) > sum(weight.get((a, order[k]), 0) for a in order[:k]):
            layer[order[k]] = min(layer[b] for b in ahead) - 1
    return layer


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


class _Router:
    """Placement of the boxes and routing of the wires, step by step."""

    def __init__(self, boxes: Sequence[Box], nets: Sequence[_Net], layer: Sequence[int]):
        self.boxes, self.nets, self.layer = tuple(boxes), nets, layer
        self.last = max(layer)
        self.columns: list[list[_Node]] = [[] for _ in range(self.last + 1)]
        self.node: dict[Hashable, _Node] = {}
        for i, box in enumerate(boxes):
            self._add(layer[i], i, box.height)
        for k, net in enumerate(nets):
            far = max(layer[sink] for sink, _ in net.sinks)
            for column in range(layer[net.source] + 1, far):
                self._add(column, (k, column), 0.0)

    def _add(self, column: int, key: Hashable, height: float) -> None:
        node = _Node(key, height)
        self.node[key] = node
        self.columns[column].append(node)

    # ---- heights --------------------------------------------------------------------------------------------

    def _left_end(self, k: int, channel: int) -> tuple[_Node, float] | None:
        """Where net k enters a channel from the left: a node and the height below its top."""
        net = self.nets[k]
        column = channel - 1
        if column == self.layer[net.source]:
            return self.node[net.source], self.boxes[net.source].outputs[net.out]
        return (self.node[k, column], 0.0) if (k, column) in self.node else None

    def _right_ends(self, k: int, channel: int) -> list[tuple[_Node, float]]:
        """Where net k leaves a channel to the right."""
        ends = [
            (self.node[sink], self.boxes[sink].inputs[port])
            for sink, port in self.nets[k].sinks
            if self.layer[sink] == channel
        ]
        return ends + ([(self.node[k, channel], 0.0)] if (k, channel) in self.node else [])

    def place(self) -> None:
        """Order and heights of every column, swept to and fro until neighbours line up."""
        for column in self.columns:
            _spread(column, [0.0] * len(column), [1.0] * len(column))
        links: dict[_Node, list[tuple[int, float, _Node, float]]] = defaultdict(list)
        for k in range(len(self.nets)):
            for channel in range(1, self.last + 1):
                left = self._left_end(k, channel)
                if left is None:
                    continue
                for right in self._right_ends(k, channel):
                    links[right[0]].append((-1, right[1], *left))
                    links[left[0]].append((1, left[1], *right))
        for sweep in range(_SWEEPS):
            forth = sweep % 2 == 0
            settled = sweep >= _SWEEPS - 8  # at the end, the order stays and both sides pull
            for column in self.columns if forth else reversed(self.columns):
                wanted, pull = [], []
                for node in column:
                    ends = [link for link in links[node] if settled or link[0] == (-1 if forth else 1)]
                    aims = [other.y + offset - own for _, own, other, offset in ends]
                    wanted.append(sum(aims) / len(aims) if aims else node.y)
                    pull.append(float(len(aims)) if aims else 0.1)
                if not settled:
                    rank = sorted(range(len(column)), key=lambda n: wanted[n] + column[n].height / 2.0)
                    column[:] = [column[n] for n in rank]
                    wanted, pull = [wanted[n] for n in rank], [pull[n] for n in rank]
                _spread(column, wanted, pull)
        top = min(node.y for column in self.columns for node in column)
        for column in self.columns:
            for node in column:
                node.y -= top
        for i, box in enumerate(self.boxes):
            box.y = self.node[i].y

    # ---- wires ----------------------------------------------------------------------------------------------

    def diagram(self) -> Diagram:
        """The finished picture."""
        self.place()
        bottom = max(node.y + node.height for node in self.node.values())
        returning = [net for net in self.nets if any(self.layer[s] <= self.layer[net.source] for s, _ in net.sinks)]
        returning.sort(key=lambda net: self.layer[net.source] - min(self.layer[s] for s, _ in net.sinks))
        for n, net in enumerate(returning):
            net.lane = bottom + 1.0 + 0.8 * n
        x = 0.0
        for channel in range(self.last + 2):
            x = self._channel(channel, x)
            if channel <= self.last:
                inside = [box for i, box in enumerate(self.boxes) if self.layer[i] == channel]
                width = max(box.width for box in inside)
                for box in inside:
                    box.width, box.x = width, x
                x += width
        lines = [Line(net.source, list(self._ways(k))) for k, net in enumerate(self.nets)]
        return Diagram(self.boxes, tuple(lines), x, bottom + 1.0 + 0.8 * len(returning))

    def _channel(self, channel: int, x: float) -> float:
        """Gives every wire that bends in this channel its own track; returns the channel's right edge."""
        spans: dict[int, tuple[list[float], list[float], float, float]] = {}
        for k, net in enumerate(self.nets):
            left = self._left_end(k, channel)
            enters = [left[0].y + left[1]] if left else []
            leaves = [node.y + offset for node, offset in self._right_ends(k, channel)]
            starts = channel == self.layer[net.source] + 1
            if not (leaves or (starts and net.lane)):
                continue
            dives = net.lane is not None and channel <= self.layer[net.source] + 1
            heights = enters + leaves + ([net.lane] if dives and net.lane is not None else [])
            if max(heights) - min(heights) > 1e-6:
                spans[k] = enters, leaves, min(heights), max(heights)

        def pair(a: int, b: int) -> float:
            """Cost of a's track left of b's: crossings, and much for horizontals that would lie on each other."""
            (enter_a, leave_a, low_a, high_a), (enter_b, leave_b, low_b, high_b) = spans[a], spans[b]
            del enter_a, leave_b
            crossings = sum(low_b < y < high_b for y in leave_a) + sum(low_a < y < high_a for y in enter_b)
            return crossings + 50.0 * sum(abs(y - z) < 0.3 for y in leave_a for z in enter_b)

        def cost(order: Order) -> float:
            return sum(table[a, b] for n, a in enumerate(order) for b in order[n + 1 :])

        table = {(a, b): pair(a, b) for a in spans for b in spans if a != b}
        order = _ordered(tuple(sorted(spans, key=lambda k: -spans[k][2])), cost)
        for n, k in enumerate(order):
            self.nets[k].track[channel] = x + _SLACK + _TRACK * n
        edge = channel in (0, self.last + 1)
        return x + (0.0 if edge and not order else 2.0 * _SLACK + _TRACK * max(len(order) - 1, 0))

    def _ways(self, k: int) -> Iterator[list[Point]]:
        """The polyline from the source to each sink of net k."""
        net, home = self.nets[k], self.layer[self.nets[k].source]
        source = self.boxes[net.source]
        start = source.x + source.width, source.y + source.outputs[net.out]
        for sink, port in net.sinks:
            box = self.boxes[sink]
            end = box.x, box.y + box.inputs[port]
            points, column = [start], self.layer[sink]
            if column > home:
                for channel in range(home + 1, column + 1):
                    y = end[1] if channel == column else self.node[k, channel].y
                    if channel in net.track:
                        points += [(net.track[channel], points[-1][1]), (net.track[channel], y)]
            else:
                assert net.lane is not None
                away, back = net.track[home + 1], net.track[column]
                points += [(away, start[1]), (away, net.lane), (back, net.lane), (back, end[1])]
            yield [*points, end]


def _spread(column: Sequence[_Node], wanted: Sequence[float], pull: Sequence[float]) -> None:
    """Heights as near to those wanted (weighted least squares) as order and gaps allow."""
    if not column:
        return
    sizes = [node.height + _GAP * (1.0 if node.height else 0.7) for node in column]
    shifts = np.cumsum([0.0, *sizes[:-1]])
    for node, y in zip(column, isotonic_regression(wanted - shifts, weights=pull).x + shifts):
        node.y = float(y)
