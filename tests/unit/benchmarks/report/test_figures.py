"""Pictures of the report: what stands on an axis can be read."""

import itertools
import re

import numpy as np
import pytest

from benchmarks.report.figures import dots, looks, svg


@pytest.mark.parametrize("most", [30.0, 300.0, 5e3, 1e5])
def test_numbers_on_an_axis_do_not_overlap(most: float) -> None:
    """Computing times of a step, from 3 us to those of a nonlinear MPC."""
    values = {name: np.geomspace(3.0, most, 6) for name in ("stanley", "nfq-bang-bang-quick", "nonlinear-mpc")}
    middle = dict.fromkeys(values, (10.0, 5.0, 20.0))
    figure = dots(values, middle, looks([*values]), limit=None)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    low, high = axes.get_xlim()
    shown = [label for label in axes.get_xticklabels() if low <= label.get_position()[0] <= high and label.get_text()]
    boxes = sorted((label.get_window_extent() for label in shown), key=lambda box: box.x0)
    assert len(boxes) >= 2
    assert all(a.x1 + 2.0 < b.x0 for a, b in itertools.pairwise(boxes))
    assert all(label.get_window_extent().x0 >= 0.0 for label in axes.get_yticklabels()), "a name is cut off"


def test_coordinates_are_short_and_labels_whole() -> None:
    figure = dots(
        {"stanley": np.array([0.025, 0.075, 0.125])}, {"stanley": (0.075, 0.025, 0.125)}, looks(["stanley"]), limit=None
    )
    figure.axes[0].set_xticks([0.025, 0.075, 0.125])
    text = svg(figure, "largest e of 0.125 m")
    assert re.findall(r">([\d.]+)</text>", text) == ["0.025", "0.075", "0.125"]
    assert 'aria-label="largest e of 0.125 m"' in text
    inside = re.sub(r'aria-label="[^"]*"', "", " ".join(re.findall(r"<[^>]*>", text)))
    assert "DejaVu" not in inside
    assert not re.search(r"\.\d{3}", inside)
