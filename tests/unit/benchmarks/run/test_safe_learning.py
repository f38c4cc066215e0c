"""Runs that are kept: what is there is not made again, a half line is no run, and what counts as a departure."""

import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.run.safe_learning import Job, Learner, one_run, runs, stored, summarise
from steerkit.scenario import Scenario

SECONDS = dict(drive_s=10.0, trainings_s=4.0, judging_s=2.0)
FOUND = dict(max_e=0.2, good=5.0, failures=1, interventions_pct=0.5, final_rms_e=0.011)
GOOD = Learner(car="single track", seed=0, minutes=3.0, safe=True, code="a", **FOUND, **SECONDS)
CAR = Scenario(name="single track")


def jobs(*seeds: int, safe: bool = True) -> list[Job]:
    return [Job(scenario=CAR, seed=seed, minutes=3.0, safe=safe) for seed in seeds]


class Pool:
    """Carries out at once what it is given, as `spread.Workers` do, and counts it."""

    made: list[int] = []
    killed_after = 99

    def done(self, function: Any, pieces: Sequence[Job], *, until: float) -> Iterator[tuple[int, Learner]]:
        assert function is one_run
        for number, job in enumerate(pieces):
            if time.monotonic() >= until:
                return
            if len(self.made) >= self.killed_after:
                raise KeyboardInterrupt
            self.made.append(job.seed)
            yield number, replace(GOOD, seed=job.seed, safe=job.safe)


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> type[Pool]:
    monkeypatch.setattr(Pool, "made", [])
    return Pool


def made(keep: Path | None, *seeds: int, **more: Any) -> list[int]:
    return [run.seed for run in runs(jobs(*seeds), those=Pool(), keep=keep, **({"stop_after": math.inf} | more))]


def test_a_stopped_study_goes_on_where_it_was(
    pool: type[Pool], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    keep = tmp_path / "new" / "runs.jsonl"
    monkeypatch.setattr(Pool, "killed_after", 2)
    with pytest.raises(KeyboardInterrupt):
        made(keep, 0, 1, 2, 3)
    with keep.open("a") as file:
        file.write('{"car": "single tr')  # killed while it wrote
    assert [run.seed for run in stored(keep)] == [0, 1]
    monkeypatch.setattr(Pool, "killed_after", 99)
    pool.made.clear()
    assert made(keep, 0, 1, 2, 3) == [0, 1, 2, 3]
    assert pool.made == [2, 3]
    assert [run.seed for run in stored(keep)] == [0, 1, 2, 3]
    assert made(keep, 3, 4) == [3, 4]
    other = [run.safe for run in runs(jobs(4, safe=False), those=Pool(), keep=keep, stop_after=math.inf)]
    assert other == [False]
    assert pool.made == [2, 3, 4, 4]


def test_after_its_time_no_run_is_begun_and_without_a_file_nothing_is_kept(pool: type[Pool], tmp_path: Path) -> None:
    assert made(None, 0, 1, stop_after=-1.0) == []
    assert made(None, 0, 1) == [0, 1]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("line", ["nonsense", "[]", '{"car": "x"}', json.dumps({**asdict(GOOD), "more": 1})])
def test_another_file_is_refused(line: str, tmp_path: Path) -> None:
    file = tmp_path / "runs.jsonl"
    file.write_text(json.dumps(asdict(GOOD)) + "\n" + line + "\n")
    with pytest.raises(ValueError, match=r"line 2.*expected a run of `study safety`"):
        stored(file)
    assert file.read_text().count("\n") == 2


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
