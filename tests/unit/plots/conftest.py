"""A short drive on a circle."""

import pytest

from steerkit import Stanley, simulate
from steerkit.diagram.simulation import Log
from tests.support.circle_drive import PASSAT, PATH
from tests.support.straight_road import looped


@pytest.fixture(scope="session")
def log() -> Log:
    return simulate(looped(Stanley.of(PASSAT), PATH, 5.0, 0.0, actuator=None, reference=0.0), 4.0)
