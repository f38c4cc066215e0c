"""One calibration for all tests that look at one."""

from __future__ import annotations

import pytest

from tests.support.calibrated_car import Made, made


@pytest.fixture(scope="session")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A guided drive of half a minute, recorded."""
    return made(tmp_path_factory.mktemp("calibration"), minutes=0.75)
