"""A results directory: what is written is read, nothing half, and what is broken is told."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest

from benchmarks.run.results import Case, Results, Store, load_results
from tests.support.results_example import example_results


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return example_results(tmp_path / "a")


def test_read_as_written(results: Results) -> None:
    again = load_results(results.place)
    assert [case.id for case in again.cases] == [case.id for case in results.cases]
    for one, two in zip(results.cases, again.cases, strict=True):
        assert (one.status, one.error, one.digest, one.kind) == (two.status, two.error, two.digest, two.kind)
        for name, value in one.metrics.items():
            assert two.metrics[name] == value or math.isnan(value)
    learner = again.cases[-1]
    assert learner.metrics["good_minutes"] == math.inf
    assert len(again.curve(learner)["t"]) == 12
    assert len(again.trajectory(learner)["t"]) == 600
    assert again.trajectory(again.cases[0]) is None
    assert set(again.table()["scenario.delay"]) == {0.0, 0.2}


def test_a_run_that_was_not_merged_is_read_case_by_case(results: Results) -> None:
    (results.place / "cases.parquet").unlink()
    gone = results.cases[3].id
    (results.place / "cases" / f"{gone}.json").unlink()
    again = load_results(results.place)
    assert again.missing == (gone,)
    assert len(again.cases) == len(results.cases) - 1


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (lambda place: place.rename(place.with_name("b")), "there are no such results"),
        (lambda place: (place / "provenance.json").unlink(), "no results directory"),
        (lambda place: (place / "provenance.json").write_text("{"), "truncated or no JSON"),
        (lambda place: (place / "cases.parquet").write_bytes(b"PAR1 broken PAR1"), "no Parquet file, or a broken one"),
        (
            lambda place: (place / "cases.parquet").write_bytes((place / "cases.parquet").read_bytes()[:999]),
            "broken one",
        ),
    ],
)
def test_bad_directories(results: Results, break_it, message: str) -> None:
    break_it(results.place)
    with pytest.raises(ValueError, match=message):
        load_results(results.place)


def test_results_of_another_version(results: Results) -> None:
    file = results.place / "provenance.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"format": "steerkit benchmark 0"}))
    with pytest.raises(ValueError, match=r"version 'steerkit benchmark 0', this program reads 'steerkit benchmark 1'"):
        load_results(results.place)


def test_a_foreign_table_and_a_broken_case(results: Results, tmp_path: Path) -> None:
    import pandas as pd

    pd.DataFrame({"x": [1.0]}).to_parquet(results.place / "cases.parquet")
    with pytest.raises(ValueError, match="has no column 'suite'"):
        load_results(results.place)
    (results.place / "cases.parquet").unlink()
    case = results.place / "cases" / f"{results.cases[1].id}.json"
    case.write_text(case.read_text()[:40])
    with pytest.raises(ValueError, match=re.escape(case.name)):
        load_results(results.place)


def test_other_files_and_other_sources_are_not_mixed_in(results: Results, tmp_path: Path) -> None:
    plan = {**results.provenance, "source": "1" * 16}
    with pytest.raises(ValueError, match="another state of the program"):
        Store(results.place).open(plan)
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "letter.txt").write_text("dear")
    with pytest.raises(ValueError, match="not empty and holds no results"):
        Store(tmp_path / "c").open(plan)


def test_a_case_says_what_its_status_may_be() -> None:
    with pytest.raises(ValueError, match="valid: done, error, not installed"):
        Case(suite="a", scenario="b", controller="c", seed=0, status="fine")
