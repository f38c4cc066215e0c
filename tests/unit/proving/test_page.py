"""A manoeuvre's page says its verdict, all results and why a run does not count, loads nothing, and draws what was
evaluated."""

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
from steerkit.diagram.units import degrees_of
from steerkit.proving.evaluate import Evaluation, evaluate
from steerkit.proving.manoeuvre import Limit, manoeuvre, names
from steerkit.proving.page import pictures, write
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


def test_of_a_fleet_each_car_has_a_row_and_none_is_lost(tmp_path: Path) -> None:
    limits = [Limit(quantity="yaw_delay", high=10.0)]
    cars = [of("step-steer", f"car {k}.", limits if k else [Limit(quantity="yaw_delay", high=1e-6)]) for k in range(15)]
    text = page(tmp_path, *cars)
    assert "14 passed, 1 failed, 0 not judged" in text
    assert "no car was driven" not in text, "nobody said that it was simulated"
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


@pytest.mark.parametrize("name", OF_EACH_KIND)
def test_every_kind_is_drawn_with_one_axis_a_panel(name: str) -> None:
    made = pictures([of(name), of(name, "other")])
    assert made
    for caption, figure in made:
        assert caption.endswith(".")
        places = [panel.get_position().bounds for panel in figure.axes]
        assert len(set(places)) == len(places), "no two axes over each other"
        assert all(panel.get_ylabel() for panel in figure.axes)
        assert figure.axes[-1].get_xlabel()
        assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a car", "other"]
        assert not pictures([of(name)])[0][1].legends


def test_the_points_of_a_step_are_the_times_that_were_found() -> None:
    evaluation = of("step-steer")
    (_, histories), (_, answers) = pictures([evaluation])
    for panel, name in zip(answers.axes, ("yaw", "a_y")):
        (points,) = (line for line in panel.lines if line.get_marker() == "o")
        half, most = np.asarray(points.get_xdata(), dtype=float)
        found = evaluation[f"{name}_response_time"].value - evaluation[f"{name}_delay"].value
        assert most - half == pytest.approx(found, abs=0.02)
        assert list(points.get_ydata()) == [0.5, 0.9]
    wheel = [np.asarray(line.get_ydata(), dtype=float)[-1] for line in histories.axes[0].lines]
    assert len(wheel) == len(evaluation.valid) == 2
    assert wheel == pytest.approx([degrees_of(abs(run["delta_sw"][-1])) for run in evaluation.valid], rel=1e-3)


def test_the_fitted_line_goes_through_the_points_of_a_linear_car_and_ackermanns_below() -> None:
    evaluation = of("steady-state-circle")
    ((_, figure),) = pictures([evaluation])
    points, fitted, ackermann = (np.asarray(line.get_ydata(), dtype=float) for line in figure.axes[0].lines)
    assert np.sort(points) == pytest.approx(fitted, abs=0.15)
    assert ackermann[-1] < 0.8 * fitted[-1]


def test_the_model_is_drawn_over_the_response() -> None:
    ((_, yaw), (_, a_y)) = pictures([of("random-steer")])
    points, model = (np.asarray(line.get_ydata(), dtype=float) for line in yaw.axes[0].lines)
    assert model == pytest.approx(points, rel=0.05)
    assert [panel.get_ylabel() for panel in a_y.axes] == ["gain [m/s^2/deg]", "phase [deg]"]


def test_the_request_is_of_the_size_that_was_asked() -> None:
    evaluation = of("openpilot-sine-20")
    ((_, figure),) = pictures([evaluation])
    lines = {line.get_label(): np.asarray(line.get_ydata(), dtype=float) for line in figure.axes[0].lines}
    assert np.abs(lines["requested"]).max() == pytest.approx(evaluation.manoeuvre.required.a_y, rel=0.01)
    assert "actual" in lines


def test_a_limit_is_drawn_to_both_sides() -> None:
    ((_, figure),) = pictures([of("lane-change-1")])
    dashed = [float(np.asarray(line.get_ydata())[0]) for line in figure.axes[0].lines if line.get_linestyle() == "--"]
    assert dashed == [-0.2, 0.2]
