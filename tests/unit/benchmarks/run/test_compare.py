"""Two runs compared: what changed is found, and only that."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.run.compare import Comparison, compare
from benchmarks.run.results import Case, Results
from tests.support.results_example import example_results


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return example_results(tmp_path / "a")


def test_compare_finds_what_changed_and_only_that(results: Results, tmp_path: Path) -> None:
    other = example_results(tmp_path / "b")
    found = compare(results, other)
    assert found.same
    assert found.compared > 80
    slower = [replaced(case, step_p50_us=99.0) for case in results.cases]
    assert compare(results, Results(other.place, other.provenance, tuple(slower))).same
    changed = [replaced(case, rms_e=case.metrics.get("rms_e", 1.0) * 1.01) for case in results.cases[1:]]
    found = compare(results, Results(other.place, other.provenance, tuple(changed)), rel=1e-3)
    assert found.only_a == (results.cases[0].id,)
    assert {change.metric for change in found.changes} == {"rms_e"}
    assert found.changes[-1].relative == pytest.approx(0.01)
    assert not compare(results, Results(other.place, other.provenance, tuple(changed)), rel=0.02).changes
    with pytest.raises(ValueError, match="no case in common"):
        compare(results, Results(other.place, other.provenance, ()))


def replaced(case: Case, **metrics: float) -> Case:
    return replace(case, metrics={**case.metrics, **metrics}) if case.status == "done" else case


def test_compare_sees_errors_new_cases_and_numbers_that_came_or_went(results: Results) -> None:
    def among(cases: list[Case]) -> Comparison:
        return compare(results, Results(results.place, results.provenance, tuple(cases)))

    error, driven = results.cases[0], results.cases[1]
    assert error.status == "error"
    other = replace(error, error="ValueError: another")
    assert among([other, *results.cases[1:]]).status == ((error.id, error.error, other.error),)
    new = replace(driven, seed=99)
    assert among([*results.cases, new]).only_b == (new.id,)
    assert not among([*results.cases, new]).same
    for changed in (replaced(driven, rms_e=math.nan), replaced(driven, max_jerk=1.0), replaced(driven, extra=1.0)):
        difference = among([changed if case is driven else case for case in results.cases])
        assert [change.case for change in difference.changes] == [driven.id]
        assert difference.changes[0].relative == math.inf
