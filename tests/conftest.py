"""For all tests: properties have no deadline, as a machine may be busy, and print what they failed on.

An interrupt ends the programs that tests start, though a shell has what runs in the background ignore it.
"""

import contextlib
import gc
import importlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import Phase, settings

from tests.support import programs

settings.register_profile("steerkit", deadline=None, print_blob=True)
settings.register_profile(
    "mutants", settings.get_profile("steerkit"), phases=[Phase.explicit, Phase.generate]
)  # for tests.support.mutants: that a test fails is enough, on the smallest example or another
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "steerkit"))

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

gc.set_threshold(100_000, 50, 50)  # looking for garbage as often as usual takes a sixth of the tests' time


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """What is there before the first test is looked at for garbage no more: loops in real time look before they run."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """In the process that hands out the tests: what all others would compile at once is compiled meanwhile, in full.

    In those: each imports a share of the tests before it collects all, so that the bytecode of each is made but once.
    """
    config = session.config
    if (worker := getattr(config, "workerinput", None)) and config.args == config.getini("testpaths"):
        tests = sorted(file.relative_to(config.rootpath) for file in Path(__file__).parent.rglob("test_*.py"))
        for file in tests[int(worker["workerid"].removeprefix("gw")) :: worker["workercount"]]:
            with contextlib.suppress(Exception, pytest.skip.Exception):  # which collecting will tell
                importlib.import_module(".".join(file.with_suffix("").parts))
    if config.getoption("tx", None):
        kernel = "from steerkit.learning.nfq.rprop import library; library()"
        subprocess.Popen([sys.executable, "-c", kernel], stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def without_layout(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures without room made for their labels, half of their time: tests/contract/test_pictures.py has it."""
    from matplotlib.figure import Figure

    monkeypatch.setattr(Figure, "get_layout_engine", lambda _: None)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are written and not drawn."""
    programs.undrawn(monkeypatch.setattr)
