"""A short drive on a circle."""

import pytest

from steerkit import Stanley, placed, simulate, steering_loop
from steerkit.diagram.simulation import Log
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from tests.support.circle_drive import PASSAT, PATH


@pytest.fixture(scope="session")
def log() -> Log:
    car = placed(LinearSingleTrack(vehicle=PASSAT, v0=5.0), PATH)
    loop = steering_loop(car=car, path=PATH, driver=ConstantSpeed(speed=5.0), controller=Stanley.of(PASSAT))
    return simulate(loop, 4.0)
