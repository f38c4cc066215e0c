"""Made-up work is as large as it is asked to be, and what it is made for is counted; the study `scheduler` runs it."""

from __future__ import annotations

import subprocess
import sys
import time
from types import SimpleNamespace

from benchmarks.run.made_up import MadeUp, held, made_up


def test_files_of_the_size_asked_for_after_the_time_asked_for() -> None:
    begun = time.monotonic()
    files = made_up(MadeUp(7, b"", 50_000, 0.05))
    assert time.monotonic() - begun >= 0.05
    assert list(files) == ["trajectories/made-up-7.npz", "cases/made-up-7.json"]
    assert sum(map(len, files.values())) == 50_000
    assert files != made_up(MadeUp(7, b"", 50_000))
    assert sum(map(len, made_up(MadeUp(8, b"", 0)).values())) == 0


def test_what_a_scheduler_holds() -> None:
    process = SimpleNamespace(memory_info=lambda: SimpleNamespace(rss=123_000))
    assert held(SimpleNamespace(tasks={"a": 1, "b": 2}, proc=process)) == (2, 123.0)


def test_it_loads_none_of_what_cases_need() -> None:
    code = "import sys, benchmarks.run.made_up; print([n for n in ('numpy', 'casadi', 'steerkit') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    assert done.stdout.strip() == "[]", done.stderr
