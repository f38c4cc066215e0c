"""The verdict: who was better, by how much, in one sentence, a table and colours; and nothing from noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.report.page import html
from benchmarks.report.verdict import JUDGED, NOTHING, glances, times, verdict
from benchmarks.run.results import Case, Results
from tests.support.report_results import PROVENANCE

KINDS = {"net": "learned", "poor-net": "learned", "stanley": "analytic", "mpc": "analytic", "lqr": "analytic"}


def made(place: Path, seeds: int, lost: tuple[tuple[str, str, int], ...] = (), **sizes: float) -> Results:
    """Drives of two scenarios: each controller's RMS e about its size, all else the same."""
    rng = np.random.default_rng(0)

    def told(name: str, scenario: str, seed: int, size: float) -> dict[str, float]:
        own = {"rms_e": size * rng.uniform(0.97, 1.03), "held": float((name, scenario, seed) not in lost)}
        return dict.fromkeys(JUDGED, 1.0) | own

    cases = tuple(
        Case(suite="s", scenario=scenario, controller=name, seed=seed, metrics=told(name, scenario, seed, size * scale))
        for name, size in sizes.items()
        for scenario, scale in (("easy", 0.01), ("hard", 0.05))
        for seed in range(seeds)
    )
    kinds = {name.replace("_", "-"): {"kind": KINDS[name.replace("_", "-")]} for name in sizes}
    return Results(place, PROVENANCE | {"controllers": kinds}, cases)


def test_certain_differences_are_told_in_a_sentence_a_table_and_colours(tmp_path: Path) -> None:
    """The ratios themselves: test_parts.py. A drive without chance meets every net."""
    results = made(tmp_path / "a", 8, net=1.0, stanley=2.0, mpc=0.5, lqr=1.0)
    once = tuple(case for case in results.cases if case.controller != "mpc" or case.seed == 0)
    (glance,) = glances(replace(results, cases=once))
    by_name = {name: next(m for m in row if m.metric == "rms_e") for name, row in glance.matches.items()}
    assert {name: match.decided for name, match in by_name.items()} == {"stanley": -1, "mpc": 1, "lqr": 0}
    assert 0.45 < by_name["stanley"].ratio.low < by_name["stanley"].ratio.value < by_name["stanley"].ratio.high < 0.55
    assert (by_name["stanley"].scenarios, by_name["mpc"].ratio.n) == (2, 8)
    low, middle, high = by_name["mpc"].bar or (0.0, 0.0, 0.0)
    assert 50.0 < low < middle < high <= 100.0
    text = glance.sentence
    assert text.startswith(
        "net kept to the course in all 16 drives. Its distance from the path was 50 % less than that of"
    )
    assert "2.0 times that of mpc, the best of the analytic controllers" in text
    assert "nearer to the path than stanley; certainly further from the path than mpc; not certainly different" in text
    assert text in verdict(replace(results, cases=once))
    section = html(results).split('<section id="verdict">')[1].split("</section>")[0]
    assert section.index('class="headline"') < section.index('class="glance"')
    assert (section.count('class="won"'), section.count('class="lost"')) == (1, 1)
    assert section.count('class="even"') == 3 * len(JUDGED) - 2
    assert all(words in section for words, _ in JUDGED.values())


def test_with_few_seeds_nothing_is_certain_and_one_drive_is_told_as_one(tmp_path: Path) -> None:
    for seeds, word in ((1, "1 seed;"), (5, "5 seeds;")):
        results = made(tmp_path / str(seeds), seeds, net=1.0, stanley=4.0)
        (glance,) = glances(results)
        assert [m.decided for m in glance.matches["stanley"]] == [0] * len(JUDGED)
        assert f"No difference is certain with {word} 6 are needed." in glance.sentence
        assert "certainly nearer" not in glance.sentence
        assert 'class="won"' not in html(results)
    easy = tuple(case for case in results.cases if (case.scenario, case.seed) == ("easy", 0))
    (glance,) = glances(replace(results, cases=easy))
    assert glance.sentence.startswith("net kept to the course in its one drive.")


def test_a_scenario_that_one_of_them_lost_is_left_out_and_said(tmp_path: Path) -> None:
    results = made(tmp_path / "a", 6, lost=(("net", "hard", 3),), net=1.0, stanley=2.0)
    (glance,) = glances(results)
    assert {match.scenarios for match in glance.matches["stanley"]} == {1}
    assert glance.sentence.startswith("net kept to the course in 11 of 12 drives.")
    never = tuple(("net", name, seed) for name in ("easy", "hard") for seed in range(6))
    lost = made(tmp_path / "b", 6, lost=never, net=1.0, stanley=2.0)
    assert "There is no scenario that it and an analytic controller both held with every seed." in verdict(lost)
    assert '<table class="glance">' in html(results)
    assert '<table class="glance">' not in html(lost)


def test_the_best_learned_controller_is_the_headline_and_nobody_is_without_two_kinds(tmp_path: Path) -> None:
    results = made(tmp_path / "a", 6, lost=(("net", "hard", 3),), net=0.5, stanley=1.0)
    other = made(tmp_path / "b", 6, stanley=1.0)
    assert glances(other) == []
    assert NOTHING in html(other)
    poor = tuple(
        Case(suite="s", scenario=c.scenario, controller="poor-net", seed=c.seed, metrics={**c.metrics, "held": 1.0})
        for c in results.cases
        if c.controller == "stanley"
    )
    kinds = results.provenance["controllers"] | {"poor-net": {"kind": "learned"}}
    both = Results(results.place, results.provenance | {"controllers": kinds}, (*results.cases, *poor))
    assert [glance.learned for glance in glances(both)] == ["poor-net", "net"], "it held all of its drives"


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        (0.84, "16 % less than"),
        (1.0, "as large as"),
        (1.03, "3 % more than"),
        (1.86, "1.9 times"),
        (12.3, "12.3 times"),
    ],
)
def test_a_ratio_is_said_as_one_says_it(ratio: float, said: str) -> None:
    assert times(ratio) == said


def test_the_text_has_a_row_for_each_analytic_controller(tmp_path: Path) -> None:
    for net, word in ((0.5, "better"), (2.0, "worse")):
        results = made(tmp_path / word, 8, net=net, stanley=1.0)
        (glance,), text = glances(results), verdict(results)
        (row,) = [line for line in text.splitlines() if line.startswith("| stanley | 2 |")]
        over, _, e, *others = row.strip("| ").split(" | ")
        assert (over, others) == ("stanley", ["1.00 [1.00, 1.00]"] * 3)
        assert e.startswith(f"{glance.matches['stanley'][0].ratio.value:.2f} [")
        assert e.endswith(f"], {word}")
        assert "| net | 16 of 16 |" in text
    assert "| stanley | 2 | 0.51 |" in verdict(made(tmp_path / "one", 1, net=0.5, stanley=1.0))
    assert NOTHING in verdict(made(tmp_path / "none", 1, stanley=1.0))
