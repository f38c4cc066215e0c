"""The verdict: who won, by how much, and nothing from noise."""

from pathlib import Path

import numpy as np

from benchmarks.report.overall import glances
from benchmarks.report.verdict import NOTHING, verdict
from benchmarks.run.results import Case, Results
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
    better, worse = rng.normal(0.02, 0.001, 8), rng.normal(0.05, 0.001, 8)
    for learned, analytic, word in ((better, worse, "better"), (worse, better, "worse")):
        text = verdict(drives(nfq=learned.tolist(), stanley=analytic.tolist()))
        ratio = np.exp(np.mean(np.log(learned / analytic)))
        (row,) = [line for line in text.splitlines() if line.startswith("| stanley | 1 |")]
        over, _, e, *others = row.strip("| ").split(" | ")
        assert over == "stanley"
        assert e.startswith(f"{ratio:.2f} [")
        assert e.endswith(f"], {word}")
        assert others == ["1.00 [1.00, 1.00]"] * 3
        assert "are needed" not in text


def test_the_verdict_claims_nothing_from_noise_or_from_drives_that_failed() -> None:
    rng = np.random.default_rng(1)
    even = drives(nfq=rng.normal(0.03, 0.01, 8).tolist(), stanley=rng.normal(0.03, 0.01, 8).tolist())
    assert "better |" not in verdict(even)
    assert "worse |" not in verdict(even)
    lost = [changed(case, held=0.0) if case.controller == "nfq" else case for case in even.cases]
    text = verdict(Results(even.place, even.provenance, tuple(lost)))
    assert "There is no scenario that it and an analytic controller both held" in text
    assert "| nfq | 0 of 8 | 0.00 [0.00, 0.32] |" in text
    assert "| stanley | 8 of 8 |" in text
    assert "No difference is certain with 3 seeds" in verdict(drives(nfq=[0.1, 0.2, 0.3], stanley=[0.2, 0.3, 0.4]))
    assert "| stanley | 1 | 0.50 |" in verdict(drives(nfq=[0.1], stanley=[0.2]))
    only = Results(even.place, even.provenance, tuple(c for c in even.cases if c.controller == "stanley"))
    assert NOTHING in verdict(only)


def test_an_analytic_drive_without_chance_meets_every_net() -> None:
    (glance,) = glances(drives(nfq=[0.05, 0.06, 0.055, 0.052, 0.051, 0.058, 0.053], stanley=[0.01]))
    (match,) = [match for match in glance.matches["stanley"] if match.metric == "rms_e"]
    assert (match.ratio.n, match.decided) == (7, 1)


def test_the_best_analytic_controller_is_told() -> None:
    rng = np.random.default_rng(3)
    means = {"nfq": 0.03, "stanley": 0.05, "lqr": 0.01, "mpc": 0.02}
    text = verdict(drives(**{name: rng.normal(mean, 0.0005, 8).tolist() for name, mean in means.items()}))
    assert "that of lqr, the best of the analytic controllers" in text
