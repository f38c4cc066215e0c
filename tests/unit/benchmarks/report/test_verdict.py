"""The verdict: who won, by how much, and nothing from noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.report.verdict import duels, verdict
from benchmarks.run.results import Case, Results
from steerkit.metrics import paired
from tests.support.results_example import example_results


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return example_results(tmp_path / "a")


def replaced(case: Case, **metrics: float) -> Case:
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
        ratio = f"{np.mean(learned) / np.mean(analytic):.2f}"
        counts = "1 | 0 | 0 | 0" if word == "better" else "0 | 1 | 0 | 0"
        assert f"| cross-track error | stanley | {ratio} | {counts} |" in text
        assert "| lateral acceleration | stanley | 1.00 | 0 | 0 | 1 | 0 |" in text
        assert "with fewer than 6" not in text


def test_the_verdict_claims_nothing_from_noise_or_from_drives_that_failed(results: Results) -> None:
    rng = np.random.default_rng(1)
    even = verdict_results(results, rng.normal(0.03, 0.01, 8).tolist(), rng.normal(0.03, 0.01, 8).tolist())
    assert "| 0 | 0 | 1 | 0 |" in verdict(even)
    lost = [replaced(case, held=0.0) if case.controller == "nfq-idoe" else case for case in even.cases]
    text = verdict(Results(even.place, even.provenance, tuple(lost)))
    assert "| cross-track error | stanley | – | 0 | 0 | 0 | 1 |" in text
    assert "| nfq-idoe | 0 of 8 | 0.00 [0.00, 0.32] |" in text
    assert "**3 seeds: with fewer than 6" in verdict(verdict_results(results, [0.1, 0.2, 0.3], [0.2, 0.3, 0.4]))
    only = Results(even.place, even.provenance, tuple(c for c in even.cases if c.controller == "stanley"))
    assert "Nothing to compare" in verdict(only)


def test_an_analytic_drive_without_chance_meets_every_net(results: Results) -> None:
    one = verdict_results(results, [0.05, 0.06, 0.055, 0.052, 0.051, 0.058, 0.053], [0.01])
    duel = next(d for d in duels(one, "nfq-idoe", "stanley") if d.metric == "rms_e")
    assert (duel.seeds, duel.decided) == (7, 1)


def test_the_best_analytic_controller_is_the_one_with_the_lowest_mean(results: Results) -> None:
    rng = np.random.default_rng(3)
    means = {"nfq-idoe": 0.03, "stanley": 0.05, "lqr": 0.01, "mpc": 0.02}
    values = {name: rng.normal(mean, 0.0005, 8) for name, mean in means.items()}
    common = dict(suite="s", scenario="course")
    others = {"rms_wheel_rate_deg": 1.0, "max_jerk": 1.0, "max_a_y": 1.0, "held": 1.0}
    cases = tuple(
        Case(**common, controller=name, seed=n, metrics=others | {"rms_e": float(value)})
        for name, column in values.items()
        for n, value in enumerate(column)
    )
    kinds = {name: {"kind": "learned" if name == "nfq-idoe" else "analytic"} for name in means}
    text = verdict(Results(results.place, {"controllers": kinds, "planned": [], "scenarios": {}}, cases))
    ratio = float(np.mean(values["nfq-idoe"]) / np.mean(values["lqr"]))
    assert f"| cross-track error | the best of each scenario | {ratio:.2f} | 0 | 1 | 0 | 0 |" in text


def test_a_drive_that_was_lost_is_in_no_comparison(results: Results) -> None:
    """A seed counts where both held: the few metres before a car left the course say nothing."""
    one = verdict_results(results, [0.02, 0.02, 0.02, 0.9], [0.03, 0.03, 0.03, 0.03])
    last = [case for case in one.cases if case.controller == "nfq-idoe"][-1]
    lost = tuple(replaced(case, held=0.0) if case is last else case for case in one.cases)
    duel = next(d for d in duels(replace(one, cases=lost), "nfq-idoe", "stanley") if d.metric == "rms_e")
    assert (duel.seeds, duel.left_out) == (3, 1)
    assert duel.mean_learned == pytest.approx(0.02)
