"""The picture of a run's data with a drive in it."""

import numpy as np
from matplotlib.figure import Figure

from steerkit.controllers.policy import StateDescription
from steerkit.diagram.simulation import Log
from steerkit.learning.data.distance import SIGNALS, Distance, states_of
from steerkit.learning.pictures import beside_the_data
from tests.support.modelled_car import driven


def test_it_shows_the_distance_of_each_sample() -> None:
    record = driven()
    log = Log(np.arange(9) * 0.05, dict(zip(SIGNALS.values(), record.s[:9].T * 1.5, strict=True)), {})
    apart = Distance.of(states_of(log, "here"), record, StateDescription())
    figure = beside_the_data(record, log, apart, title="a run")
    assert isinstance(figure, Figure)
    *_, over_time = (axis for axis in figure.axes if axis.get_xlabel() == "t [s]")
    np.testing.assert_array_equal(over_time.lines[0].get_ydata(), apart.d)
