"""Pictures of a log."""

import numpy as np
import pytest

from steerkit.diagram.simulation import Log, simulate
from steerkit.plots.diagram import plot_log, telling
from tests.support.diagrams import small


def test_by_default_all_signals_with_a_line_an_entry() -> None:
    figure = simulate(small(), 1.0).plot()
    assert sum(len(axes.get_lines()) for axes in figure.axes) == 6


def test_signals_may_be_ports() -> None:
    loop = small()
    log = simulate(loop, 1.0)
    assert plot_log(log, [loop.blocks["gain"].y]).axes[0].get_lines()[0].get_label() == "gain.y"
    with pytest.raises(KeyError, match=r"no signal 'gain.z' in the log"):
        log.plot("gain.z")


def test_a_batch_has_its_cars_in_their_order() -> None:
    log = simulate(small(), 1.0, batch=3)
    values = log["wave.v"] + np.array([0.0, 10.0, 20.0])
    figure = Log(log.t, {"wave.v": values}, {"wave.v": "m"}).plot("wave.v")
    for car, line in enumerate(figure.axes[0].get_lines()):
        np.testing.assert_array_equal(line.get_ydata(), values[:, car])


def test_in_a_notebook_a_log_shows_what_tells_most_of_a_drive(log: Log) -> None:
    assert [name.rpartition(".")[2] for name in telling(log)] == ["e", "delta_sw", "v", "a_y"]
    assert telling(simulate(small(), 1.0))  # none of these names: the first ones
    picture = log._repr_png_()
    assert picture
    assert picture[:4] == b"\x89PNG"
    assert Log(np.zeros(1), {"a.b": np.zeros(1)}, {"a.b": "1"})._repr_png_() is None
