"""Two runs compared: what changed is found, and only that."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.run.compare import compare
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
    from dataclasses import replace

    return replace(case, metrics={**case.metrics, **metrics}) if case.status == "done" else case
