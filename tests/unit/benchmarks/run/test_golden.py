"""The golden numbers, and that a difference from them is seen."""

from pathlib import Path

import pytest

from benchmarks.run import golden
from benchmarks.run.results import Case, Results


def test_golden_numbers() -> None:
    found = golden.difference(golden.numbers(golden.measured()), *golden.kept(golden.FILE))
    assert not found, [f"{c.case} {c.metric}: {c.before} -> {c.after}" for c in found[:10]]


def test_golden_differences_are_seen() -> None:
    old, tolerances = golden.kept(golden.FILE)
    name = next(iter(old))
    new = {**old, name: {**old[name], "rms_e": old[name]["rms_e"] * (1.0 + 1e-5), "new": 1.0}}
    found = golden.difference(new, old, tolerances)
    assert [(c.case, c.metric) for c in found] == [(name, "rms_e"), (name, "new")]
    del new[name]["max_e"]
    assert {c.metric for c in golden.difference(new, old, tolerances)} == {"rms_e", "max_e", "new"}


def test_a_case_that_failed_has_no_golden_numbers() -> None:
    cases = [Case(suite="golden", scenario="step", controller="stanley", seed=0, metrics={"rms_e": 0.1})]
    assert golden.numbers(Results(Path(), {}, tuple(cases))) == {cases[0].id: {"rms_e": 0.1}}
    cases.append(Case(suite="golden", scenario="step", controller="lqr", seed=0, status="error", error="no plan"))
    with pytest.raises(ValueError, match=r"^golden: .*lqr.*: no plan$"):
        golden.numbers(Results(Path(), {}, tuple(cases)))
