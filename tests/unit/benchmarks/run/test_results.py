"""A results directory: what is written is read, nothing half, and what is broken is told."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.report.verdict import duels, verdict
from benchmarks.run.compare import compare
from benchmarks.run.results import Case, Results, Store, load_results
from steerkit.metrics import paired
from tests.support.results_example import example_results


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:999])


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


def verdict_results(results: Results, learned: list[float], analytic: list[float]) -> Results:
    """Drives of one scenario with these RMS e, all held."""
    common = dict(suite="s", scenario="course")
    zero = {"rms_wheel_rate_deg": 1.0, "max_jerk": 1.0, "max_a_y": 1.0, "held": 1.0}
    who = {"nfq-idoe": learned, "stanley": analytic}
    cases = [
        Case(**common, controller=name, seed=n, metrics=zero | {"rms_e": value})
        for name, values in who.items()
        for n, value in enumerate(values)
    ]
    kinds = {"nfq-idoe": {"kind": "learned"}, "stanley": {"kind": "analytic"}}
    return Results(results.place, {"controllers": kinds, "planned": [], "scenarios": {}}, tuple(cases))


def test_the_verdict_says_who_won_and_by_how_much(results: Results) -> None:
    rng = np.random.default_rng(0)
    better, worse = rng.normal(0.02, 0.001, 8).tolist(), rng.normal(0.05, 0.001, 8).tolist()
    for learned, analytic, word in ((better, worse, "better"), (worse, better, "worse")):
        one = verdict_results(results, learned, analytic)
        duel = next(d for d in duels(one, "nfq-idoe", "stanley") if d.metric == "rms_e")
        expected = paired(learned, analytic)
        assert duel.result == expected
        assert duel.decided == (-1 if word == "better" else 1)
        text = verdict(one)
        ratio = f"{np.mean(learned) / np.mean(analytic):.2f} times as large over 1 scenarios"
        assert f"Cross-track error, against stanley: {ratio}; {word} in 1 of 1 scenarios" in text
        assert "with fewer than 6" not in text
        assert f"p = {expected.p:.2g}" in text
        assert f"{expected.difference.value:+.3g}" in text
        assert (
            "Lateral acceleration, against stanley: 1.00 times as large over 1 scenarios; not to be told apart" in text
        )


def test_the_verdict_claims_nothing_from_noise_or_from_drives_that_failed(results: Results) -> None:
    rng = np.random.default_rng(1)
    even = verdict_results(results, rng.normal(0.03, 0.01, 8).tolist(), rng.normal(0.03, 0.01, 8).tolist())
    assert "better in 1" not in verdict(even)
    lost = [replaced(case, held=0.0) if case.controller == "nfq-idoe" else case for case in even.cases]
    text = verdict(Results(even.place, even.provenance, tuple(lost)))
    assert "Cross-track error (stanley): no seed on which both held their drive and it was measured." in text
    assert "| nfq-idoe | 0 of 8 | 0.00 [0.00, 0.32] |" in text
    assert "**3 seeds: with fewer than 6" in verdict(verdict_results(results, [0.1, 0.2, 0.3], [0.2, 0.3, 0.4]))
    only = Results(even.place, even.provenance, tuple(c for c in even.cases if c.controller == "stanley"))
    assert "Nothing to compare" in verdict(only)


def test_an_analytic_drive_without_chance_meets_every_net(results: Results) -> None:
    one = verdict_results(results, [0.05, 0.06, 0.055, 0.052, 0.051, 0.058, 0.053], [0.01])
    duel = next(d for d in duels(one, "nfq-idoe", "stanley") if d.metric == "rms_e")
    assert (duel.seeds, duel.decided) == (7, 1)
