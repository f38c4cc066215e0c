"""A results directory: what is written is read, nothing half, and what is broken is told."""

import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.run.results import Case, Results, Store, load_results
from tests.support.report_results import changed, write

NEVER = "tracking--paper--mpc--s1"
"""A case that is planned and was not carried out."""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return write(tmp_path_factory.mktemp("results") / "a", seeds=(0, 1), grid=False)


@pytest.fixture
def results(written: Results, tmp_path: Path) -> Results:
    """A copy, to be broken."""
    return replace(written, place=Path(shutil.copytree(written.place, tmp_path / "a")))


def test_read_as_written(results: Results) -> None:
    again = load_results(results.place)
    assert repr(again.cases) == repr(results.cases)
    learner = next(case for case in again.cases if case.kind == "learn")
    assert len(again.curve(learner)["t"]) == 29
    assert len(again.trajectory(again.cases[0])["t"]) == 600
    assert again.trajectory(next(case for case in again.cases if case.status == "error")) is None
    assert set(again.table()["scenario.steering.delay"].dropna()) == {0.0}


def test_a_run_that_has_not_ended_is_read(results: Results) -> None:
    gone = results.cases[3].id
    (results.place / "cases" / f"{gone}.json").unlink()
    again = load_results(results.place)
    assert set(again.missing) == {gone, NEVER}
    assert len(again.cases) == len(results.cases) - 1


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (lambda place: place.rename(place.with_name("b")), "there are no such results"),
        (lambda place: (place / "provenance.json").unlink(), "no results directory"),
        (lambda place: (place / "provenance.json").write_text("{"), "truncated or no JSON"),
        (
            lambda place: (place / "provenance.json").write_text('{"format": "steerkit benchmark 0"}'),
            "version 'steerkit benchmark 0', this program reads 'steerkit benchmark 1'",
        ),
    ],
)
def test_bad_directories(results: Results, break_it, message: str) -> None:
    break_it(results.place)
    with pytest.raises(ValueError, match=message):
        load_results(results.place)


@pytest.mark.parametrize("text", ["{", '{"x": 1.0}', "[]"])
def test_a_broken_case_is_named(results: Results, text: str) -> None:
    case = results.place / "cases" / f"{results.cases[1].id}.json"
    case.write_text(text)
    with pytest.raises(ValueError, match=f"{re.escape(case.name)} is broken .*; remove it and run the suite again"):
        load_results(results.place)


@pytest.mark.parametrize(
    ("key", "value"),
    [("source", "1" * 16), ("versions", {"python": "3.11.0", "numpy": "2.0.1"}), ("versions", {"python": "3.11.0"})],
)
def test_a_run_is_not_resumed_with_other_sources_or_package_versions_nor_among_other_files(
    results: Results, key: str, value: object, tmp_path: Path
) -> None:
    before = (results.place / "provenance.json").read_bytes()
    with pytest.raises(ValueError, match=f"another state of the program \\({key} "):
        Store(results.place).open({**results.provenance, key: value})
    assert (results.place / "provenance.json").read_bytes() == before
    with pytest.raises(ValueError, match="not empty and holds no results"):
        Store(tmp_path).open(results.provenance)


def test_a_suite_that_joins_later_leaves_the_first_ones_cases(results: Results) -> None:
    store = Store(results.place)
    windy = {"course.name": "paper", "disturbances.wind": 1.0, "told": [1, 2]}
    later = {**results.provenance, "suites": {"weather": "later"}, "scenarios": {"windy": windy}}
    store.open(later | {"planned": ["weather--windy--stanley--s9"], "seeds": [9]})
    store.keep(Case(suite="weather", scenario="windy", controller="stanley", seed=9, metrics={"rms_e": 1.0}))
    joined = load_results(results.place)
    assert repr(joined.cases[:-1]) == repr(results.cases)
    assert joined.missing == (NEVER,)
    assert joined.provenance["seeds"] == [0, 1, 9]
    assert set(joined.provenance["suites"]) == {"tracking", "paper", "robustness", "weather"}
    assert joined.table()["scenario.disturbances.wind"].iloc[-1] == 1.0
    assert "scenario.told" not in joined.table()  # a table's cells are single values


def test_a_number_that_was_never_measured_is_no_number(results: Results) -> None:
    learner = next(case for case in results.cases if case.kind == "learn")
    Store(results.place).keep(changed(learner, max_jerk=math.nan, good_minutes=math.inf))
    (again,) = [case for case in load_results(results.place).cases if case.id == learner.id]
    assert math.isnan(again.metrics["max_jerk"])
    assert again.metrics["good_minutes"] == math.inf
    assert math.isnan(again.cpu_seconds)


def test_a_case_that_is_killed_while_it_is_kept_is_not_finished(results: Results) -> None:
    """Whatever is written before the case's own file fails: it is then begun again."""
    store, case = Store(results.place), replace(results.cases[0], seed=77)

    def killed(file: Path) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.keep(case, trajectory={"t": np.zeros(3)}, curve={"t": np.zeros(2)}, net=killed)
    assert not store.has(case.id)
    store.keep(case)
    assert store.has(case.id)
    assert not store.has("tracking--paper--mpc--s0")  # it ended in an error: it is tried again
