"""Figures in the project's style."""

from steerkit.plots.style import new_figure


def test_a_map_beside_the_panels_comes_first() -> None:
    figure, axes = new_figure(3, title="round", map_beside=True)
    assert len(axes) == len(figure.axes) == 4
    assert axes[1].get_shared_x_axes().joined(axes[1], axes[3])
    assert not axes[0].get_shared_x_axes().joined(axes[0], axes[1])
