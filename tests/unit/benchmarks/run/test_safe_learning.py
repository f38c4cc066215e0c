"""What is kept of a run, and what counts as a departure."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.run.safe_learning import Job, Learner, one_run, runs, summarise
from steerkit.scenario import Scenario

SECONDS = dict(drive_s=10.0, trainings_s=4.0, judging_s=2.0)
FOUND = dict(max_e=0.2, good=5.0, failures=1, interventions_pct=0.5, final_rms_e=0.011)
GOOD = Learner(car="single track", seed=0, minutes=3.0, safe=True, code="a", **FOUND, **SECONDS)
CAR = Scenario(name="single track")


class Pool:
    """Carries out at once what it is given, as `spread.Workers` do."""

    def done(self, function: Any, pieces: Sequence[Job], **_: Any) -> Iterator[tuple[int, Learner]]:
        assert function is one_run
        for number, job in enumerate(pieces):
            yield number, replace(GOOD, seed=job.seed, safe=job.safe)


def test_runs_are_kept_as_they_were(tmp_path: Path) -> None:
    """By whom: test_kept.py."""
    jobs = [Job(scenario=CAR, seed=seed, minutes=3.0, safe=seed < 2) for seed in range(3)]
    those: Any = Pool()
    made, again = (list(runs(jobs, those=those, keep=tmp_path / "a.jsonl", stop_after=math.inf)) for _ in range(2))
    assert made == again
    assert [(run.seed, run.safe, run.car, run.good) for run in made] == [
        (seed, seed < 2, "single track", 5.0) for seed in range(3)
    ]
    assert len((tmp_path / "a.jsonl").read_text(encoding="utf-8").splitlines()) == 3


def test_what_is_counted() -> None:
    left = replace(GOOD, seed=1, max_e=0.51, good=None, interventions_pct=2.5)
    unknown = replace(GOOD, seed=2, max_e=math.nan, final_rms_e=0.5)
    free = replace(GOOD, safe=False, max_e=3.0, good=None, final_rms_e=0.010)
    report = summarise([GOOD, left, unknown, free])
    assert (report["runs"], report["runs_without"]) == (3, 1)
    assert (report["departures"], report["departures_without"]) == (2, 1)
    assert (report["good_median_s"], report["good_worst_s"]) == (5.0, math.inf)
    assert (report["interventions_pct"], report["interventions_above_2_pct"]) == (2.5, 1)
    assert report["interventions_mean_pct"] == pytest.approx(3.5 / 3)
    assert report["final_rms_x"] == pytest.approx(1.1)
    assert (report["seconds_a_run"], report["of_it_trainings"], report["of_it_judging"]) == (12.0, 4.0, 2.0)
    assert report["codes"] == 1
    assert math.isnan(summarise([])["final_rms_x"])
