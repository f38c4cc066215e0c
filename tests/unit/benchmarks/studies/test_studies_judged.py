"""How studies judge what was driven: by hand, on logs of a few samples."""

import math
from typing import Any

import numpy as np
import pytest

from benchmarks.studies import foreign, learning, throughput, tune_stanley
from steerkit.diagram.simulation import Log
from steerkit.task import DT

NAN = math.nan


def log(**signals: Any) -> Log:
    """Samples of signals whose names are given with `__` for the point."""
    columns = {name.replace("__", "."): np.array(values, dtype=float) for name, values in signals.items()}
    samples = len(next(iter(columns.values())))
    return Log(DT * np.arange(samples), columns, dict.fromkeys(columns, ""))


def test_the_root_mean_square_is_that_of_the_first_round() -> None:
    drive = log(path__progress=[0, 5, 10, 4], path__e=[3.0, 4.0, 100.0, 100.0])
    assert tune_stanley.rms(drive, "path.e", 10.0) == pytest.approx(math.sqrt(12.5))


def test_gains_are_chosen_among_those_near_the_best() -> None:
    result = tune_stanley.Result(e=np.array([0.10, 0.11, 0.121]), rate=np.array([3.0, 2.0, 1.0]))
    assert result.chosen == 1


def outcome(**changes: Any) -> learning.Outcome:
    fields = dict.fromkeys(learning.Outcome.__dataclass_fields__, 0.0)
    return learning.Outcome(**{**fields, **changes})  # type: ignore[arg-type]


def test_a_seed_that_never_learned_counts_as_infinite() -> None:
    seeds = [
        outcome(first_round_done=100.0, good=200.0),
        outcome(first_round_done=900.0, good=None),
        outcome(first_round_done=None, good=None),
    ]
    figures = learning.summarise(seeds, 660.0)
    assert (figures["first_round_done_median"], figures["first_round_done_worst"]) == (900.0, None)
    assert (figures["good_median"], figures["good_worst"]) == (None, None)
    shares = (figures["round_share"], figures["round_within_share"], figures["good_share"])
    assert shares == pytest.approx((2 / 3, 1 / 3, 1 / 3))


@pytest.mark.filterwarnings("ignore:Unused output")
def test_ways_that_compute_something_else_are_not_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    run = throughput.python_control.run
    monkeypatch.setattr(throughput.python_control, "run", lambda made, steps: run(made, steps) + 1e-9)
    with pytest.raises(SystemExit, match=r"the ways disagree by 1\.00e-09 m"):
        throughput.require_equal_runs(throughput.closed_loop())


def swing(amplitude: float, seconds: float = 40.0, *, period: float = 4.0, about: float = 0.0) -> Any:
    t = DT * np.arange(round(seconds / DT))
    return t, about + amplitude * np.sin(2.0 * math.pi * t / period)


def test_a_limit_cycle_is_what_swings_regularly_by_more_than_a_decimetre() -> None:
    amplitude, period = foreign.limit_cycle(*swing(0.3, about=0.5))
    assert (amplitude, period) == (pytest.approx(0.3, rel=0.01), pytest.approx(4.0, rel=0.02))
    assert foreign.limit_cycle(*swing(0.09)) == (0.0, pytest.approx(NAN, nan_ok=True))
    assert foreign.limit_cycle(*swing(0.3, 9.0))[0] == 0.0, "two periods are none yet"
    t, e = swing(0.3)
    assert foreign.limit_cycle(t, np.where(t < 12.0, e, 0.0))[0] == pytest.approx(0.3, rel=0.01)
    wander = np.where(t % 5.0 < 1.0, 0.3, -0.3)
    assert foreign.limit_cycle(t, wander)[0] == 0.0, "not regular"


def test_a_drive_that_ends_early_is_lost() -> None:
    t, e = swing(0.05)
    assert foreign.judged(t, e, 40.0) == foreign.Recovery(
        max_e=pytest.approx(0.05, rel=0.01), back=True, stays=True, swing=0.0, period=pytest.approx(NAN, nan_ok=True)
    )
    late = np.where(t > 30.0, 0.6, e)
    assert (foreign.judged(t, late, 40.0).back, foreign.judged(t, late, 40.0).stays) == (True, False)
    ended = foreign.judged(t[:500], e[:500], 40.0)
    assert (ended.max_e, ended.back, ended.stays) == (math.inf, False, False)
