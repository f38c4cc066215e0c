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


def test_a_case_without_a_value_counts_as_worst(known: Results) -> None:
    cases = [c for c in known.cases if c.suite == "tracking"]
    assert parts.of_metric(cases, METRIC["rms_e"])[-2] == np.inf
    assert parts.of_metric(cases, METRIC["share_within_5cm"])[-2] == -np.inf


def by_controller(cases: list[Case]) -> parts.Drives:
    table: parts.Drives = {}
    for case in (c for c in cases if c.status == "done"):
        table.setdefault(case.controller, {}).setdefault(case.scenario, {})[case.seed] = case
    return table


def test_the_comparison_is_paired_by_seed(known: Results) -> None:
    cases = [c for c in known.cases if c.suite == "tracking"]

    def seeds(name: str) -> list[float]:
        rms_e = [[c.metrics["rms_e"] for c in cases if (c.controller, c.seed) == (name, s)] for s in SEEDS]
        return np.log(rms_e).mean(axis=1).tolist()

    found = parts.paired_logs(by_controller(cases), "pure-pursuit", "stanley", METRIC["rms_e"])
    assert found is not None
    assert found[0] == pytest.approx(seeds("pure-pursuit"))
    assert found[1] == pytest.approx(seeds("stanley"))
    assert found[2] == 2


def test_a_drive_that_was_not_held_counts_as_worst_and_one_without_chance_for_every_seed(known: Results) -> None:
    case = next(c for c in known.cases if c.suite == "tracking")
    lost = replace(case, metrics={**case.metrics, "held": 0.0})
    assert parts.of_metric([case, lost], METRIC["rms_e"]).tolist() == [case.metrics["rms_e"], np.inf]
    assert parts.of_metric([lost], METRIC["step_p50_us"])[0] == case.metrics["step_p50_us"]

    def made(scenario: str, seed: int, rms_e: float) -> Case:
        return Case(suite="s", scenario=scenario, controller="c", seed=seed, metrics={"rms_e": rms_e})

    cases = [made("chance", 0, 1.0), made("chance", 1, 2.0), made("none", 0, 5.0)]
    np.testing.assert_allclose(parts.by_seed(cases, METRIC["rms_e"]), [3.0, 3.5])
    others = [replace(c, controller="d", metrics={"rms_e": c.metrics["rms_e"] * 2.0}) for c in cases]
    found = parts.paired_logs(by_controller([*cases, *others]), "d", "c", METRIC["rms_e"])
    assert found is not None
    assert found[0] - found[1] == pytest.approx([np.log(2.0)] * 2)
    assert found[2] == 2


def test_numbers_are_written_for_people() -> None:
    written = [parts.number(v) for v in (0.01234, 1.0, 12.34, 1234.5, 0.0, np.inf, np.nan, 1e-9)]
    assert written == ["0.0123", "1.00", "12.3", "1,234", "0", "never", "–", "1.00e-09"]
