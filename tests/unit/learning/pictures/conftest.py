"""The record of the finished short run."""

from pathlib import Path

import pytest

from steerkit.learning.pictures.run import Record


@pytest.fixture(scope="session")
def record(kept: Path) -> Record:
    return Record.read(kept)
