"""What a picture shows is what was evaluated."""

import numpy as np
import pytest

from steerkit.diagram.units import degrees_of
from steerkit.proving.page import pictures
from tests.unit.proving.test_page import OF_EACH_KIND, of


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
