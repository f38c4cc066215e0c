"""A finished short run, and its log."""

from pathlib import Path

import pytest

from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.learning.experiment import LearningRun
from steerkit.learning.learn import learn
from tests.support.short_run import SHORT


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("runs") / "run"
    learn(SHORT, place)
    return place


@pytest.fixture(scope="session")
def run(kept: Path) -> LearningRun:
    return rundir.load(kept)


@pytest.fixture(scope="session")
def log(kept: Path) -> Log:
    return rundir.drive_log(kept)
