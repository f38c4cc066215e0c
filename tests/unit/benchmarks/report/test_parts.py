"""The report's numbers are those of the results."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.report import parts
from benchmarks.run.results import Case, Results
from steerkit.metrics import TABLE
from tests.support.report_results import CONTROLLERS, SEEDS

METRIC = {metric.name: metric for metric in TABLE}


def test_the_leaderboard_has_the_medians_of_the_cases(known: Results) -> None:
    cases = [c for c in known.cases if c.suite == "tracking"]
    columns, rows = parts.leaderboard(cases)
    assert [row.controller for row in rows] == [*CONTROLLERS, "mpc", "sac"]
    place = 2 + [m.name for m in columns].index("rms_e")
    for row in rows[:3]:
        here = [c for c in cases if c.controller == row.controller]
        seeds = [np.median([c.metrics["rms_e"] for c in here if c.seed == seed]) for seed in SEEDS]
        assert row.cells[place].value == pytest.approx(np.median(seeds))
        assert row.cells[0].text == "12"
        assert row.cells[1].text == "100 %"
    assert [row.cells[place].best for row in rows] == [True, False, False, False, False]
    assert rows[0].cells[2 + [m.name for m in columns].index("max_a_y")].beyond
    assert rows[3].note == "1 ended in an error"
    assert (rows[3].cells[1].text, rows[3].cells[place].text) == ("0 %", "–")
    assert rows[4].note == "not installed"


def test_a_drive_that_was_not_held_or_without_a_value_counts_as_worst(known: Results) -> None:
    cases = [c for c in known.cases if c.suite == "tracking"]
    assert parts.of_metric(cases, METRIC["rms_e"])[-2] == np.inf, "an error"
    assert parts.of_metric(cases, METRIC["share_within_5cm"])[-2] == -np.inf
    lost = replace(cases[0], metrics={**cases[0].metrics, "held": 0.0})
    assert parts.of_metric([cases[0], lost], METRIC["rms_e"]).tolist() == [cases[0].metrics["rms_e"], np.inf]
    assert parts.of_metric([lost], METRIC["step_p50_us"])[0] == cases[0].metrics["step_p50_us"]


def test_controllers_are_compared_seed_for_seed_and_a_drive_without_chance_counts_for_every_seed() -> None:
    """Geometric means over scenarios."""

    def made(controller: str, scenario: str, seed: int, rms_e: float) -> Case:
        return Case(suite="s", scenario=scenario, controller=controller, seed=seed, metrics={"rms_e": rms_e})

    a = [made("a", "chance", 0, 1.0), made("a", "chance", 1, 2.0), made("a", "none", 0, 5.0)]
    b = [made("b", "chance", 0, 3.0), made("b", "chance", 1, 8.0), made("b", "none", 0, 5.0)]
    np.testing.assert_allclose(parts.by_seed(a, METRIC["rms_e"]), [3.0, 3.5])
    table: parts.Drives = {}
    for case in (*a, *b):
        table.setdefault(case.controller, {}).setdefault(case.scenario, {})[case.seed] = case
    found = parts.paired_logs(table, "a", "b", METRIC["rms_e"])
    assert found is not None
    ours, theirs, scenarios = found
    np.testing.assert_allclose(np.exp(2.0 * ours), [5.0, 10.0])
    np.testing.assert_allclose(np.exp(2.0 * theirs), [15.0, 40.0])
    assert scenarios == 2


def test_numbers_are_written_for_people() -> None:
    written = [parts.number(v) for v in (0.01234, 1.0, 12.34, 1234.5, 0.0, np.inf, np.nan, 1e-9)]
    assert written == ["0.0123", "1.00", "12.3", "1,234", "0", "never", "–", "1.00e-09"]
