"""Diagrams say names, units and rates, and texts fit."""

from __future__ import annotations

from steerkit.plots.arrange import arrange
from tests.support.diagrams import LOOPS, learning, loops


@loops
def test_the_diagram_says_names_units_and_rates(name: str) -> None:
    loop = LOOPS[name]()
    figure = loop.plot()
    said = [text.get_text() for axes in figure.axes for text in axes.texts]
    for block_name, block in loop.blocks.items():
        assert block_name in said
        assert type(block).__name__ in said
        assert f"{1.0 / block.dt:.4g} Hz" in said
        assert {port.name for port in block.inputs} <= set(said)
    for source, _ in loop.wires:
        unit = source.spec.unit
        assert (f"{source.spec.name} [{unit}]" if unit != "1" else source.spec.name) in said


def test_hollow_ports_are_those_that_only_update_sees() -> None:
    loop = learning()
    axes = loop.plot().axes[0]
    hollow = {
        (float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in axes.lines if line.get_marker() == "o"
    }
    expected = {
        (box.x, box.y + box.inputs[port.name])
        for box in arrange(loop).boxes
        for port in loop.blocks[box.name].inputs
        if not port.direct
    }
    assert hollow == expected
    assert expected


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
