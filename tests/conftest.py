"""For all tests: properties have no deadline, as a machine may be busy, and print what they failed on.

An interrupt ends the programs that tests start, though a shell has what runs in the background ignore it. With `-n`,
one interpreter imports what tests need, and the processes that share the tests and the programs are forks of it.
"""

from __future__ import annotations

import gc
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from hypothesis import Phase, settings

from tests.support.warm_start import SELDOM, Warm, command

settings.register_profile("steerkit", deadline=None, print_blob=True)
settings.register_profile(
    "mutants", settings.get_profile("steerkit"), phases=[Phase.explicit, Phase.generate]
)  # for tests.support.mutants: that a test fails is enough, on the smallest example or another
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "steerkit"))

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

gc.set_threshold(*SELDOM)


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """What is there before the first test is looked at for garbage no more: loops in real time look before they run."""
    gc.collect()
    gc.freeze()


WARM = "STEERKIT_TESTS_WARM"
"""Environment: the socket of the interpreter that programs are forked from, where several processes share it."""


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """In the process that hands out the tests: those that take them start warm, and share the interpreter."""
    tx = session.config.getoption("tx", None)
    if tx and {*tx} == {"popen"}:
        # meanwhile on the other core: what all of them would compile at once, in full
        kernel = "from steerkit.learning.nfq.rprop import library; library()"
        subprocess.Popen([sys.executable, "-c", kernel], stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        warm = Warm()
        warm.__enter__()
        session.config.add_cleanup(lambda: warm.__exit__())
        os.environ[WARM] = str(warm.socket)
        session.config.option.tx = [f"popen//python={shlex.join(warm.python)}"] * len(tx)


@pytest.fixture(scope="session")
def python() -> Iterator[tuple[str, ...]]:
    """The command for `python` that starts at once: see tests/support/warm_start.py."""
    if WARM in os.environ:
        yield command(os.environ[WARM])
        return
    with Warm() as warm:
        yield warm.python
