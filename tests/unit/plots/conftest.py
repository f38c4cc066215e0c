"""A short drive on a circle."""

import pytest

from steerkit import Stanley, simulate
from steerkit.diagram.simulation import Log
from steerkit.paths.courses import circle
from tests.support.straight_road import PASSAT, looped


@pytest.fixture(scope="session")
def log() -> Log:
    return simulate(looped(Stanley.of(PASSAT), circle(), 5.0, 0.0, actuator=None, reference=0.0), 4.0)
