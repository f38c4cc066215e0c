"""A manoeuvre's page says its verdict, all results and why a run does not count, and loads nothing."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from steerkit import Scenario
from steerkit._support.version import version
from steerkit.proving.evaluate import Evaluation, evaluate
from steerkit.proving.manoeuvre import Limit, manoeuvre, names
from steerkit.proving.page import write
from steerkit.proving.runs import Run, simulated
from tests.support import programs

CAR = Scenario(vehicle={"name": "vw-passat", "plant": "linear"})
OF_EACH_KIND = tuple({manoeuvre(name).evaluation: name for name in names()}.values())
"""A manoeuvre for each way of evaluating, each of which has pictures of its own."""
pytestmark = pytest.mark.usefixtures("without_layout")
HOSTILE = "<script>alert('$x_$')</script>\"&"


@cache
def runs(name: str) -> tuple[Run, ...]:
    """Those of the linear car, and one whose speed was off."""
    found = simulated(manoeuvre(name), CAR)
    return (*found, replace(found[0], number=9, signals={**found[0].signals, "v": found[0]["v"] + 5.0}))


def of(name: str, who: str = "a car", limits: Sequence[Limit] = ()) -> Evaluation:
    return evaluate(manoeuvre(name), runs(name), CAR.nominal, who=who, limits=limits)


def page(
    tmp_path: Path,
    *evaluations: Evaluation,
    general: dict[str, str] | None = None,
    command: str = "",
    drawn: bool = False,
) -> str:
    """The page's text; its pictures are drawn only where that is asked for."""
    file = tmp_path / "a.html"
    with pytest.MonkeyPatch.context() as patch:
        if not drawn:
            programs.undrawn(patch.setattr)
        write(file, evaluations, general=general or {}, command=command)
    assert file.stat().st_size < 600_000
    return file.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", OF_EACH_KIND)
def test_a_page_says_the_verdict_all_results_and_why_a_run_does_not_count(name: str, tmp_path: Path) -> None:
    evaluation = of(name)
    text = page(tmp_path, evaluation, general={"how": "simulation"}, command="steerkit prove a < b")
    told = unescape(re.sub(r"<[^>]*>", "", re.sub(r"src='[^']*'", "", text)))
    assert {True: "PASSED", False: "FAILED", None: "NOT JUDGED"}[evaluation.passed] in told
    wanted = [evaluation.manoeuvre.norm, "no: speed 5.", "no car was driven", "steerkit prove a < b", version()]
    wanted += [f"{r.value:.4g}" for r in evaluation.results if 1e-6 <= abs(r.value) < 1e4]
    wanted += [verdict.limit.source for verdict in evaluation.verdicts]
    assert [text for text in wanted if text not in told] == []
    assert text.count("<img") >= 1
    assert text.count("<b class=open>unverified</b>") == len(evaluation.manoeuvre.unverified)
    assert not re.search(r"(src|href)=(?!'data:image/png;base64,)|@import|url\(|<script|<link", text)
    quantities = [result.quantity for result in evaluation.results]
    assert [quantity for quantity in quantities if f"<td>{quantity}</td>" in text] == [], "called in plain words"


def test_names_are_text_and_nothing_else(tmp_path: Path) -> None:
    both = of("sine", HOSTILE), of("sine", "other")
    text = page(tmp_path, *both, general={HOSTILE: HOSTILE}, command=HOSTILE, drawn=True)
    assert "<script" not in text
    assert "&lt;script&gt;alert(&#x27;$x_$&#x27;)" in text


def test_two_cars_stand_side_by_side(tmp_path: Path) -> None:
    text = page(tmp_path, of("step-steer", "first"), of("step-steer", "second"))
    for who in ("first", "second"):
        assert text.count(f"{who}</td>") >= len(of("step-steer").results)
    assert text.count("<strong") == 2
    assert "no car was driven" not in text, "nobody said that it was simulated"


def test_of_a_fleet_each_car_has_a_row_and_none_is_lost(tmp_path: Path) -> None:
    limits = [Limit(quantity="yaw_delay", high=10.0)]
    cars = [of("step-steer", f"car {k}.", limits if k else [Limit(quantity="yaw_delay", high=1e-6)]) for k in range(15)]
    text = page(tmp_path, *cars)
    assert "14 passed, 1 failed, 0 not judged" in text
    assert [k for k in range(15) if text.count(f"car {k}.") != 3] == [], "results, the run that does not count, car"


@pytest.mark.parametrize(("high", "word"), [(1e-6, "FAILED"), (10.0, "PASSED")])
def test_a_limit_that_is_not_kept_fails(high: float, word: str, tmp_path: Path) -> None:
    text = page(tmp_path, of("step-steer", limits=[Limit(quantity="yaw_delay", high=high, source="mine")]))
    assert f">{word}</strong>" in text
    assert ("not kept" in text) == (word == "FAILED")
    assert "mine" in text


def test_an_interval_across_the_limit_is_said(tmp_path: Path) -> None:
    found = of("step-steer", limits=[Limit(quantity="yaw_delay", high=0.1)])
    across = tuple(r._replace(low=r.value - 1.0, high=r.value + 1.0) for r in found.results)
    assert "reaches beyond the limit" not in page(tmp_path, found)
    assert "reaches beyond the limit" in page(tmp_path, replace(found, results=across))


@pytest.mark.parametrize("name", ["sine", "lane-change-1"])
def test_without_a_valid_run_the_page_says_so(name: str, tmp_path: Path) -> None:
    none = evaluate(manoeuvre(name), [replace(run, invalid="a dog") for run in runs(name)], CAR.nominal)
    text = page(tmp_path, none)
    assert text.count("a dog") == len(none.runs)
    assert "no valid run" in text
    assert "NOT JUDGED" in text
    assert "<img" not in text


def test_what_cannot_be_one_page_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no evaluation"):
        page(tmp_path)
    with pytest.raises(ValueError, match="manoeuvres differ"):
        page(tmp_path, of("sine"), of("step-steer"))


def test_a_run_that_is_not_finite_is_shown_with_its_reason(tmp_path: Path) -> None:
    run = runs("sine")[0]
    broken = replace(run, signals={**run.signals, "r": np.full_like(run.t, np.nan), "v": np.full_like(run.t, np.nan)})
    assert "signals are not finite" in page(tmp_path, evaluate(manoeuvre("sine"), [broken], CAR.nominal))
