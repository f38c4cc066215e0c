"""Results that many tests read: a finished run of the tiny suite, and made-up ones."""

import pytest

from benchmarks.run.results import Results
from benchmarks.run.runner import run
from tests.support.report_results import write
from tests.support.tiny_suite import TINY


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """All cases, one after the other in this process."""
    return run([TINY], tmp_path_factory.mktemp("bench") / "here", workers=1, quiet=True)


@pytest.fixture(scope="session")
def known(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Known numbers on disk; no test changes them."""
    return write(tmp_path_factory.mktemp("bench") / "results")
