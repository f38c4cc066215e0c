"""A finished short run, and its record."""

from pathlib import Path

import pytest

from steerkit.learning.learn import learn
from steerkit.learning.pictures import Record
from tests.support.short_run import SHORT


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("runs") / "run"
    learn(SHORT, place)
    return place


@pytest.fixture(scope="session")
def record(kept: Path) -> Record:
    return Record.read(kept)
