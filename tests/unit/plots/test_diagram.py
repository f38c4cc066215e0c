"""Diagrams say names, units and rates, and texts fit."""

from itertools import pairwise

import pytest

from steerkit.plots.diagram import Diagram, arrange
from tests.support.diagrams import LOOPS, learning, loops


def test_texts_fit_into_their_boxes() -> None:
    figure = learning().plot()
    figure.canvas.draw()
    axes = figure.axes[0]
    for box in arrange(learning()).boxes:
        inside = [
            text.get_window_extent().transformed(axes.transData.inverted())
            for text in axes.texts
            if box.x <= text.get_position()[0] <= box.x + box.width
            and box.y <= text.get_position()[1] <= box.y + box.height
        ]
        assert len(inside) == 3 + len(box.inputs) + len(box.outputs) + (not box.outputs)
        for k, a in enumerate(inside):
            assert a.x0 > box.x
            assert a.x1 < box.x + box.width
            assert not any(a.overlaps(b) for b in inside[:k])


def segments(picture: Diagram) -> list[tuple[int, tuple[float, float], tuple[float, float]]]:
    """(number of the wire, from, to) of all straight pieces."""
    return [(n, a, b) for n, line in enumerate(picture.lines) for way in line.ways for a, b in pairwise(way)]


@loops
def test_every_wire_runs_from_its_output_to_all_its_inputs(name: str) -> None:
    loop = LOOPS[name]()
    picture = arrange(loop)
    at = {
        (box.name, port): (x, box.y + y)
        for box in picture.boxes
        for ports, x in ((box.inputs, box.x), (box.outputs, box.x + box.width))
        for port, y in ports.items()
    }
    drawn = {(way[0], way[-1]) for line in picture.lines for way in line.ways}
    wired = {tuple(at[tuple(loop.port_name(port).split("."))] for port in wire) for wire in loop.wires}
    assert drawn == wired
    assert sum(len(line.ways) for line in picture.lines) == len(loop.wires)


@loops
def test_wires_run_straight_and_never_through_a_box(name: str) -> None:
    picture = arrange(LOOPS[name]())
    for _, (x0, y0), (x1, y1) in segments(picture):
        assert x0 == pytest.approx(x1) or y0 == pytest.approx(y1)
        for box in picture.boxes:
            apart = (
                max(x0, x1) <= box.x + 1e-9
                or min(x0, x1) >= box.x + box.width - 1e-9
                or max(y0, y1) <= box.y
                or min(y0, y1) >= box.y + box.height
            )
            assert apart, f"a wire runs through {box.name}"


@loops
def test_boxes_do_not_overlap_and_are_inside(name: str) -> None:
    picture = arrange(LOOPS[name]())
    for k, a in enumerate(picture.boxes):
        assert a.x >= 0.0
        assert a.y >= 0.0
        assert a.x + a.width <= picture.width + 1e-9
        assert a.y + a.height <= picture.height + 1e-9
        for b in picture.boxes[:k]:
            beside = a.x >= b.x + b.width or b.x >= a.x + a.width
            assert beside or a.y >= b.y + b.height or b.y >= a.y + a.height


@loops
def test_different_wires_never_lie_on_each_other(name: str) -> None:
    pieces = segments(arrange(LOOPS[name]()))
    for k, (n, a, b) in enumerate(pieces):
        for other, c, d in pieces[:k]:
            for axis in (0, 1):  # both along this axis, at the same place on the other one
                across = 1 - axis
                along = a[across] == b[across] and c[across] == d[across] and abs(a[across] - c[across]) < 0.2
                low, high = (
                    max(min(a[axis], b[axis]), min(c[axis], d[axis])),
                    min(max(a[axis], b[axis]), max(c[axis], d[axis])),
                )
                assert n == other or not along or high - low < 1e-9


def test_signals_flow_from_left_to_right() -> None:
    boxes = {box.name: box for box in arrange(learning()).boxes}
    order = ["car", "path", "controller", "doe", "supervisor"]
    assert all(boxes[a].x + boxes[a].width < boxes[b].x for a, b in pairwise(order))


def test_in_a_notebook_a_loop_shows_its_diagram() -> None:
    assert learning()._repr_png_()[:4] == b"\x89PNG"
