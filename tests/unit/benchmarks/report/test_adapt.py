"""Learned on the car itself: curves fall through levels where the numbers say, and what was not held is told."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.report import adapt, figures
from benchmarks.report.page import html
from benchmarks.run.results import Case, Results, Store

CAR = "passat-ratio"
LEARNED = {30: math.nan, 60: 0.2, 90: 0.04, 120: 0.02}
"""RMS e of the net that took the wheel after so many seconds [m]; NaN: it did not hold."""
ANALYTIC = {"lqr": 0.05, "mpc": math.nan, "lqr-oracle": 0.03, "mpc-oracle": 0.01}
"""RMS e [m]; NaN: not held."""


def case(name: str, rms_e: float, **changes: Any) -> Case:
    held = {"held": float(math.isfinite(rms_e)), "rms_e": 1.0 if math.isnan(rms_e) else rms_e}
    return Case(**{"suite": "adapt", "scenario": CAR, "controller": name, "seed": 0, "metrics": held} | changes)


def write(place: Path) -> Results:
    store, fields = (
        Store(place),
        {"name": CAR, "vehicle.name": "vw-passat", "vehicle.ratio": 1.25, "steering.lag": 0.15, "sensors.noise": 1.0},
    )
    drives = [case(name, value) for name, value in ANALYTIC.items()]
    drives += [case(f"nfq-same-car-{minutes}", LEARNED[60 * minutes]) for minutes in (1, 2)]
    trainings = [
        case(
            f"nfq-same-car-{minutes}",
            LEARNED[60 * minutes],
            suite="training",
            scenario=f"train-same-car-{minutes}-on-{CAR}",
            kind="learn",
        )
        for minutes in (1, 2)
    ]
    protocol = {CAR: fields} | {t.scenario: fields | {"minutes": float(i)} for i, t in enumerate(trainings, 1)}
    kinds = {c.controller: {"kind": "learned" if "nfq" in c.controller else "analytic"} for c in drives}
    planned = [c.id for c in (*drives, *trainings)]
    told = {"suites": {}, "seeds": [0], "scenarios": protocol, "controllers": kinds, "planned": planned}
    store.open(told | {"source": "", "versions": {}})
    for one in drives:
        store.keep(one)
    for minutes, one in enumerate(trainings, 1):
        kept = {t: value for t, value in LEARNED.items() if t <= 60 * minutes}
        rms_e = np.array([*kept.values()])
        columns = {name: np.ones(len(kept)) for name in ("rounds", "max_e", "max_jerk")}
        store.keep(
            one, curve=columns | {"t": np.array([*kept], float), "rms_e": rms_e, "held": np.isfinite(rms_e) * 1.0}
        )
    return store.merge()


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return write(tmp_path_factory.mktemp("adapt") / "results")


@pytest.fixture(scope="module")
def panel(results: Results) -> adapt.Panel:
    (found,) = adapt.panels(results, [c for c in results.cases if c.suite == "adapt"])
    return found


def test_the_longest_training_is_the_curve_and_every_drive_a_dot(panel: adapt.Panel) -> None:
    middle = dict(zip(np.round(60.0 * panel.x).astype(int).tolist(), panel.learned[0], strict=True))
    assert (middle[59], middle[60], middle[89], middle[90], middle[120]) == (math.inf, 0.2, 0.2, 0.04, 0.02)
    assert panel.drives == {1.0: 0.2, 2.0: 0.02}
    assert panel.trouble == "vw-passat, ratio 1.25"


def test_what_it_falls_below_and_when(panel: adapt.Panel) -> None:
    sheet, truth = panel.best(truth=False), panel.best(truth=True)
    assert sheet == adapt.Level("lqr", False, 0.05), "mpc left the course and is not best"
    assert truth == adapt.Level("mpc", True, 0.01)
    assert 60.0 * panel.below(truth=False) == pytest.approx(90.0)
    assert panel.below(truth=True) == math.inf
    assert (panel.times(truth=False), panel.times(truth=True)) == (pytest.approx(0.4), pytest.approx(2.0))


def test_a_curve_that_rises_again_is_not_below_for_good(panel: adapt.Panel) -> None:
    x, learned = np.array([0.0, 1.0, 2.0, 3.0]), np.array([math.inf, 0.04, 0.06, 0.02])
    again = adapt.Panel("", "", x, (learned, learned, learned), {}, panel.levels, 1)
    assert again.below(truth=False) == 3.0
    none_held = adapt.Panel("", "", x, (learned, learned, learned), {}, (), 1)
    assert none_held.below(truth=False) == 1.0
    assert math.isnan(none_held.times(truth=True))


def test_the_page_says_it_in_words_and_keeps_these_curves_in_one_place(results: Results) -> None:
    page = html(results)
    assert "told the data sheet in 1 of 1 scenarios, for good after 90 s of driving in the median." in page
    assert (
        "It ends at 2.00 times the RMS e of the best that is told the truth in the median, 2.00 times at worst" in page
    )
    assert "Learned: after 1 min 0.200 m, after 2 min 0.0200 m." in page
    assert "Best told the data sheet: 0.0500 m (lqr); learned is below for good after 90 s. Not held: mpc." in page
    assert "Best told the truth: 0.0100 m (mpc); learned ends at 2.00 times that." in page
    assert "good drivers over driving time" not in page


def test_other_suites_have_no_such_section(results: Results) -> None:
    assert adapt.section(results, [c for c in results.cases if c.kind == "learn"]) is None


def test_the_strip_at_the_top_holds_what_was_not_held_and_nothing_else(panel: adapt.Panel) -> None:
    look = figures.looks([adapt.LEARNED, "lqr", "mpc"])
    levels = [(level.name, level.truth, level.rms_e) for level in panel.levels]
    drawn = figures.falling(panel.x, panel.learned, panel.drives, levels, look, adapt.LEARNED, span=(0.007, 0.3))
    *lines, curve, dots = drawn.axes[0].lines
    for (name, truth, level), line in zip(levels, lines, strict=True):
        (at, _), dashed = line.get_ydata(), line.get_linestyle() != "-"
        assert at == level if math.isfinite(level) else 0.3 < at < 0.57
        assert (line.get_color(), dashed) == (look[name].colour, not truth)
    y = np.asarray(curve.get_ydata())
    assert (y[:60] > 0.3).all()
    assert y[60:].tolist() == panel.learned[0][60:].tolist()
    assert list(dots.get_ydata()) == [0.2, 0.02]
