"""The clock, on a machine's time that the test moves."""

import time
from types import SimpleNamespace

import pytest

from steerkit._support import clock as clocks
from steerkit._support.clock import Clock


@pytest.mark.parametrize("scale", [0.2, 1.0, 4.0])
def test_it_runs_so_many_times_as_fast_as_the_monotonic_clock(scale: float, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = SimpleNamespace(t=100.0)

    def sleep(seconds: float) -> None:
        assert seconds >= 0.0
        machine.t += seconds

    monkeypatch.setattr(clocks, "time", SimpleNamespace(monotonic=lambda: machine.t, sleep=sleep))
    clock = Clock(scale=scale)
    start = clock.now()
    clock.sleep_until(start + 2.0)
    assert clock.now() == pytest.approx(start + 2.0)
    assert machine.t == pytest.approx(100.0 + 2.0 / scale)
    clock.sleep_until(start)  # has passed
    assert clock.now() == pytest.approx(start + 2.0)
    assert clock.wall(2.0) == pytest.approx(2.0 / scale)
    assert clock.wall(-1.0) == 0.0


def test_all_processes_read_the_clock_that_nobody_sets() -> None:
    before = time.monotonic()
    assert before <= Clock().now() <= time.monotonic()
