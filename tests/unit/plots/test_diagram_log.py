"""Pictures of a log."""

import numpy as np
import pytest

from steerkit.diagram.simulation import Log, simulate
from steerkit.plots.diagram import plot_log, telling
from tests.support.diagrams import small


def test_signals_may_be_ports() -> None:
    loop = small()
    log = simulate(loop, 1.0)
    assert plot_log(log, [loop.blocks["gain"].y]).axes[0].get_lines()[0].get_label() == "gain.y"
    with pytest.raises(KeyError, match=r"no signal 'gain.z' in the log"):
        log.plot("gain.z")


def test_in_a_notebook_a_log_shows_what_tells_most_of_a_drive(log: Log) -> None:
    assert [name.rpartition(".")[2] for name in telling(log)] == ["e", "delta_sw", "v", "a_y"]
    assert telling(simulate(small(), 1.0))  # none of these names: the first ones
    picture = log._repr_png_()
    assert picture
    assert picture[:4] == b"\x89PNG"
    assert Log(np.zeros(1), {"a.b": np.zeros(1)}, {"a.b": "1"})._repr_png_() is None
