"""Pictures of a drive: all of it is shown, and no half of a picture is blank."""

import numpy as np
import pytest

from steerkit.diagram.simulation import Log
from steerkit.plots.drive import first_round, round_driven, rounds_driven


def drive(width: float = 120.0, depth: float = 40.0, seconds: float = 660.0) -> Log:
    """An ellipse of that size [m], with the signals of a learning run."""
    t = np.linspace(0.0, seconds, 2000)
    turn = 2.0 * np.pi * t / seconds
    zero = np.zeros_like(t)
    signals = {"path.e": 0.1 * np.sin(9.0 * turn), "path.progress": 5.0 * t, "supervisor.learning": zero + 1.0}
    signals |= {"car.x": 0.5 * width * np.cos(turn), "car.y": 0.5 * depth * np.sin(turn)}
    signals |= {"car.delta_sw": zero, "car.a_y": zero}
    return Log(t, signals, dict.fromkeys(signals, ""))


@pytest.mark.parametrize(("width", "depth"), [(120.0, 100.0), (900.0, 100.0), (40.0, 300.0)])
def test_the_map_is_as_high_as_the_panels_beside_it(width: float, depth: float) -> None:
    log = drive(width, depth)
    for figure in (
        round_driven(log, log, title="one"),
        rounds_driven({"a": log, "b": log}, title="two"),
        first_round(log, began=10.0, done=600.0, title="first"),
    ):
        figure.draw_without_rendering()
        *panels, course = (axes.get_position() for axes in figure.axes[:4])
        first, last = min(panels, key=lambda p: p.y0), max(panels, key=lambda p: p.y1)
        assert course.height > 0.95 * (last.y1 - first.y0) > 0.6
        assert course.width > 0.25
