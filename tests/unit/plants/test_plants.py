"""What all plants have in common: one formula for floats and symbols."""

import numpy as np
import pytest

from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.sensors import Sensors
from steerkit.plants.speed_driver import ConstantSpeed, SpeedDriver
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.vehicles import VW_PASSAT
from tests.support.stepped import run, traced

BLOCKS = {
    "linear": (LinearSingleTrack(vehicle=VW_PASSAT, v0=4.0), 2),
    "nonlinear": (NonlinearSingleTrack(vehicle=VW_PASSAT, v0=4.0, substeps=2), 2),
    "actuator": (SteeringActuator(delay=0.05, gain=1.1, offset=0.1), 1),
    "driver": (SpeedDriver(seed=4), 0),
    "constant": (ConstantSpeed(), 0),
    "sensors": (Sensors.hard(3), 6),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_symbols_give_what_floats_give(name):
    block, n = BLOCKS[name]
    inputs = [tuple(row) for row in (np.random.default_rng(2).normal(0, 3, (50, n)) + 3.0).tolist()]
    ys, x = run(block, inputs)
    symbolic, last = traced(block, 50, inputs)
    assert np.array(symbolic) == pytest.approx(np.array([tuple(y) for y in ys]), rel=1e-12, abs=1e-12)
    assert last == pytest.approx(np.array(x), rel=1e-12, abs=1e-12)
