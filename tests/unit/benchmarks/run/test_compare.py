"""Two runs compared: what changed is found, and only that."""

import math
from dataclasses import replace

import pytest

from benchmarks.run.compare import Comparison, compare
from benchmarks.run.results import Case, Results, load_results
from tests.support.report_results import changed


def among(known: Results, cases: list[Case], **how: float) -> Comparison:
    """With these cases instead."""
    return compare(known, Results(known.place, known.provenance, tuple(cases)), **how)


def test_compare_finds_what_changed_and_only_that(known: Results) -> None:
    found = compare(known, load_results(known.place))
    assert found.same
    assert found.compared > 80
    assert among(known, [changed(case, step_p50_us=99.0) for case in known.cases]).same
    wider = [
        changed(case, rms_e=1.01 * case.metrics["rms_e"]) if case.kind == "drive" and case.metrics else case
        for case in known.cases[1:]
    ]
    found = among(known, wider, rel=1e-3)
    assert found.only_a == (known.cases[0].id,)
    assert {change.metric for change in found.changes} == {"rms_e"}
    assert found.changes[-1].relative == pytest.approx(0.01)
    assert not among(known, wider, rel=0.02).changes
    with pytest.raises(ValueError, match="no case in common"):
        among(known, [])


def test_compare_sees_errors_new_cases_and_numbers_that_came_or_went(known: Results) -> None:
    driven, *others = known.cases
    error = next(case for case in known.cases if case.status == "error")
    other = replace(error, error="ValueError: another")
    found = among(known, [other if case is error else case for case in known.cases])
    assert found.status == ((error.id, error.error, other.error),)
    new = replace(driven, seed=99)
    found = among(known, [*known.cases, new])
    assert (found.only_b, found.same) == ((new.id,), False)
    for now in (changed(driven, rms_e=math.nan), changed(driven, extra=1.0)):
        (change,) = among(known, [now, *others]).changes
        assert (change.case, change.relative) == (driven.id, math.inf)
