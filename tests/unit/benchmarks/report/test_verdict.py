"""The verdict: who won, by how much, and nothing from noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.report.verdict import duels, verdict
from benchmarks.run.results import Case, Results
from benchmarks.statistics import paired
from tests.support.report_results import changed


def drives(**columns: list[float]) -> Results:
    """Drives of one scenario with these RMS e by controller, all held."""
    others = {"rms_wheel_rate_deg": 1.0, "max_jerk": 1.0, "max_a_y": 1.0, "held": 1.0}
    cases = tuple(
        Case(suite="s", scenario="course", controller=name, seed=n, metrics=others | {"rms_e": float(value)})
        for name, values in columns.items()
        for n, value in enumerate(values)
    )
    kinds = {name: {"kind": "learned" if name == "nfq" else "analytic"} for name in columns}
    return Results(Path("none"), {"controllers": kinds, "planned": [], "scenarios": {}}, cases)


def test_the_verdict_says_who_won_and_by_how_much() -> None:
    rng = np.random.default_rng(0)
    better, worse = rng.normal(0.02, 0.001, 8).tolist(), rng.normal(0.05, 0.001, 8).tolist()
    for learned, analytic, word in ((better, worse, "better"), (worse, better, "worse")):
        one = drives(nfq=learned, stanley=analytic)
        duel = next(d for d in duels(one, "nfq", "stanley") if d.metric == "rms_e")
        expected = paired(learned, analytic)
        assert duel.result == expected
        assert duel.decided == (-1 if word == "better" else 1)
        text = verdict(one)
        ratio = f"{np.mean(learned) / np.mean(analytic):.2f}"
        counts = "1 | 0 | 0 | 0" if word == "better" else "0 | 1 | 0 | 0"
        assert f"| cross-track error | stanley | {ratio} | {counts} |" in text
        assert "| lateral acceleration | stanley | 1.00 | 0 | 0 | 1 | 0 |" in text
        assert "with fewer than 6" not in text


def test_the_verdict_claims_nothing_from_noise_or_from_drives_that_failed() -> None:
    rng = np.random.default_rng(1)
    even = drives(nfq=rng.normal(0.03, 0.01, 8).tolist(), stanley=rng.normal(0.03, 0.01, 8).tolist())
    assert "| 0 | 0 | 1 | 0 |" in verdict(even)
    lost = [changed(case, held=0.0) if case.controller == "nfq" else case for case in even.cases]
    text = verdict(Results(even.place, even.provenance, tuple(lost)))
    assert "| cross-track error | stanley | – | 0 | 0 | 0 | 1 |" in text
    assert "| nfq | 0 of 8 | 0.00 [0.00, 0.32] |" in text
    assert "**3 seeds: with fewer than 6" in verdict(drives(nfq=[0.1, 0.2, 0.3], stanley=[0.2, 0.3, 0.4]))
    only = Results(even.place, even.provenance, tuple(c for c in even.cases if c.controller == "stanley"))
    assert "Nothing to compare" in verdict(only)


def test_an_analytic_drive_without_chance_meets_every_net() -> None:
    one = drives(nfq=[0.05, 0.06, 0.055, 0.052, 0.051, 0.058, 0.053], stanley=[0.01])
    duel = next(d for d in duels(one, "nfq", "stanley") if d.metric == "rms_e")
    assert (duel.seeds, duel.decided) == (7, 1)


def test_the_best_analytic_controller_is_the_one_with_the_lowest_mean() -> None:
    rng = np.random.default_rng(3)
    means = {"nfq": 0.03, "stanley": 0.05, "lqr": 0.01, "mpc": 0.02}
    values = {name: rng.normal(mean, 0.0005, 8) for name, mean in means.items()}
    text = verdict(drives(**values))
    ratio = float(np.mean(values["nfq"]) / np.mean(values["lqr"]))
    assert f"| cross-track error | the best of each scenario | {ratio:.2f} | 0 | 1 | 0 | 0 |" in text


def test_a_drive_that_was_lost_is_in_no_comparison() -> None:
    """A seed counts where both held: the few metres before a car left the course say nothing."""
    one = drives(nfq=[0.02, 0.02, 0.02, 0.9], stanley=[0.03, 0.03, 0.03, 0.03])
    last = [case for case in one.cases if case.controller == "nfq"][-1]
    lost = tuple(changed(case, held=0.0) if case is last else case for case in one.cases)
    duel = next(d for d in duels(replace(one, cases=lost), "nfq", "stanley") if d.metric == "rms_e")
    assert (duel.seeds, duel.left_out) == (3, 1)
    assert duel.mean_learned == pytest.approx(0.02)
