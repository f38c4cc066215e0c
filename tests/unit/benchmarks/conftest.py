"""A finished run of the tiny suite."""

from __future__ import annotations

import pytest

from benchmarks.run.results import Results
from benchmarks.run.runner import run
from tests.support.tiny_suite import TINY


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """All cases, one after the other in this process."""
    return run([TINY], tmp_path_factory.mktemp("bench") / "here", workers=1, quiet=True)
