"""python-control runs the same loop in both wirings: same outputs, same states."""

import numpy as np
import pytest

from benchmarks.peers import python_control
from benchmarks.studies.throughput import DT, closed_loop
from steerkit.diagram.simulation import simulate

pytestmark = pytest.mark.filterwarnings("ignore:Unused output")


def test_it_drives_as_our_own_loop() -> None:
    loop = closed_loop()
    start = loop.init()
    e = python_control.run(python_control.diagram(loop, start), 60)
    assert e[0] == pytest.approx(0.2, abs=0.05)
    assert np.abs(e - simulate(loop, 60 * DT, state=start)["path.e"]).max() < 1e-11


def test_the_loop_as_one_function_arrives_at_the_same_state() -> None:
    loop = closed_loop()
    start = loop.init()
    x = python_control.run(python_control.one_function(loop, start), 60)
    assert np.abs(x - simulate(loop, 60 * DT, state=start)["car.x"]).max() < 1e-9
