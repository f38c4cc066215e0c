"""The record of the finished short run."""

from pathlib import Path

import pytest

from steerkit.learning.pictures.run import Record


@pytest.fixture(autouse=True)
def quick(without_layout: None) -> None:
    """Many pictures are drawn."""


@pytest.fixture(scope="session")
def record(kept: Path) -> Record:
    return Record.read(kept)
