"""A recording of a drive, and one calibration for all tests that look at one."""

from pathlib import Path

import pytest

from tests.support.calibrated_car import Made, made
from tests.support.recordings import small


@pytest.fixture(scope="session")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A guided drive of half a minute, recorded."""
    return made(tmp_path_factory.mktemp("calibration"), minutes=0.5)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    (tmp_path / "drive.mcap").write_bytes(small())
    return tmp_path / "drive.mcap"
