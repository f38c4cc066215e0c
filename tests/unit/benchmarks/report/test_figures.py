"""Pictures of the report: what stands on an axis can be read."""

import itertools
import re

import numpy as np
import pytest

from benchmarks.report.figures import bands, looks, svg

X = np.array([0.0, 1.0, 2.0])


@pytest.mark.parametrize("most", [0.03, 0.3, 5.0, 100.0])
def test_numbers_on_an_axis_do_not_overlap(most: float) -> None:
    """RMS e from 1 cm on, also of nets that hold their round by luck."""
    middle = np.geomspace(0.01, most, 3)
    figure = bands(X, {"nfq": (middle, middle, middle)}, looks(["nfq"]), x_label="x", y_label="RMS e [m]", log=True)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    shown = [label for label in axes.get_yticklabels() if low <= label.get_position()[1] <= high and label.get_text()]
    boxes = sorted((label.get_window_extent() for label in shown), key=lambda box: box.y0)
    assert len(boxes) >= 2
    assert all(a.y1 < b.y0 for a, b in itertools.pairwise(boxes))
    assert all(label.get_window_extent().x0 >= 0.0 for label in axes.get_yticklabels()), "a number is cut off"


def test_coordinates_are_short_and_labels_whole() -> None:
    share = np.array([0.025, 0.075, 0.125])
    figure = bands(X, {"nfq": (share, share, share)}, looks(["nfq"]), x_label="", y_label="")
    figure.axes[0].set_xticks([])
    figure.axes[0].set_yticks([0.025, 0.075, 0.125])
    text = svg(figure, "largest e of 0.125 m")
    assert re.findall(r">([\d.]+)</text>", text) == ["0.025", "0.075", "0.125"]
    assert 'aria-label="largest e of 0.125 m"' in text
    inside = re.sub(r'aria-label="[^"]*"', "", " ".join(re.findall(r"<[^>]*>", text)))
    assert "DejaVu" not in inside
    assert not re.search(r"\.\d{3}", inside)
