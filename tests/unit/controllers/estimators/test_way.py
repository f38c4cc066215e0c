"""An angle arrives when lag and delay say, between samples too."""

from __future__ import annotations

import math

import pytest

from steerkit.controllers.estimators.way import arrived


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.0), (0.1, 0.2), (0.12, 0.3), (5.0, 0.0)])
def test_a_step_arrives_behind_lag_and_delay(delay: float, lag: float) -> None:
    line: tuple[float, ...] = (0.0,) * 9
    for k in range(1, 60):
        line, angle = arrived(line, 1.0, delay, lag, 0.05)
        since = 0.05 * k - min(delay, 0.4)  # no longer than the line
        exact = 1.0 - math.exp(-since / max(lag, 1e-3)) if since > 0.0 else 0.0
        assert angle == pytest.approx(exact, abs=0.02 if lag else 1e-9)


def test_a_ramp_is_interpolated() -> None:
    line: tuple[float, ...] = (0.0,) * 9
    for k in range(40):
        line, angle = arrived(line, float(k), 0.13, 0.0, 0.05)
    assert angle == pytest.approx(39.0 - 0.13 / 0.05)
