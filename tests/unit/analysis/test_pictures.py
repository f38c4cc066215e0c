"""Pictures of linear analysis show what they are to show."""

import math

import numpy as np
import pytest

from steerkit.analysis import linearise, over, plot_bode, plot_over, plot_steps
from steerkit.controllers.stanley import Stanley
from tests.support.straight_road import PASSAT, steered


def test_pictures_show_the_margins_and_say_what_is_unstable() -> None:
    speeds = [5.0, 9.0]
    points = {
        "predicted": over(steered, speeds, "controller.delta_sw"),
        "textbook": over(lambda v: steered(v, Stanley.textbook(PASSAT)), speeds, "controller.delta_sw"),
    }
    bode = plot_bode({name: found[1].open_loop for name, found in points.items()})
    predicted, textbook = (text.get_text() for text in bode.axes[0].get_legend().get_texts())
    told = points["predicted"][1].margins
    assert told is not None
    assert (
        predicted == f"predicted: gain {told.gain:.2f}, phase {math.degrees(told.phase):.0f}°, delay {told.delay:.2f} s"
    )
    assert textbook == "textbook: closed loop unstable"
    crossing, dot = bode.axes[1].lines[0], bode.axes[1].lines[1]
    assert dot.get_ydata()[0] == pytest.approx(-180.0 + math.degrees(told.phase), abs=0.5)
    assert np.all(np.abs(np.diff(crossing.get_ydata())) < 20.0)  # no jumps by a turn
    phase, delay, pole = plot_over(points).axes
    assert np.isnan(phase.lines[1].get_ydata()[1])
    assert phase.lines[0].get_ydata()[1] == pytest.approx(math.degrees(told.phase))
    assert delay.lines[0].get_ydata().tolist() == [point.margins.delay for point in points["predicted"]]
    assert pole.lines[1].get_ydata()[1] > 1.0
    answers = {f"{v:g} m/s": linearise(steered(v), inputs=["controller_path.e"], outputs=["path.e"]) for v in speeds}
    steps = plot_steps(answers, 8.0, ylabel="e [m]").axes[0]
    assert [line.get_label() for line in steps.lines[:2]] == list(answers)
    assert steps.lines[0].get_ydata()[-1] == pytest.approx(-1.0, abs=0.02)  # e is measured 1 m too large
