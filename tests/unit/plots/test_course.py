"""Pictures of a course."""

import numpy as np

from steerkit.paths.courses import circle
from steerkit.plots.course import plot_course


def test_a_course_shows_its_curvature() -> None:
    axes = {panel.get_ylabel(): panel for panel in plot_course(circle(25.0)).axes}
    drawn = np.asarray(axes["y [m]"].get_lines()[0].get_xydata())[:-1]
    np.testing.assert_allclose(np.hypot(*(drawn - drawn.mean(axis=0)).T), 25.0, rtol=1e-3)
    (arrow,) = [text for text in axes["y [m]"].texts if text.arrow_patch is not None]
    along, tip = drawn[1] - drawn[0], np.array(arrow.xy) - arrow.xyann
    assert tip @ along > 0.99 * np.hypot(*tip) * np.hypot(*along), "the arrow points the way that is driven"
    np.testing.assert_allclose(np.asarray(axes["kappa [1/m]"].get_lines()[-1].get_ydata()), 1.0 / 25.0, rtol=1e-3)
