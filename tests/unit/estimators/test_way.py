"""An angle arrives when lag and delay say, between samples too."""

from __future__ import annotations

import math

import pytest

from steerkit.estimators.way import arrived


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.0), (0.1, 0.2), (0.12, 0.3), (0.13, 0.1), (5.0, 0.0)])
def test_a_step_that_is_held_arrives_behind_lag_and_delay_exactly(delay: float, lag: float) -> None:
    line: tuple[float, ...] = (0.0,) * 9
    for k in range(1, 60):
        line, way = arrived(line, 1.0, delay, lag, 0.05, held=True)
        since = 0.05 * k - min(delay, 0.4)  # no longer than the line
        exact = 1.0 - math.exp(-since / max(lag, 1e-3)) if since > 1e-9 else 0.0
        assert way.end == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize(("delay", "first"), [(0.13, 0.6), (0.05, 0.0)])
def test_the_corner_is_where_the_command_changed(delay: float, first: float) -> None:
    """Up by 1 for three samples, then down: what arrives turns at once, between samples, at its largest."""
    line, ways = (0.0,) * 9, []
    for k in range(12):
        line, way = arrived(line, 1.0 if k < 3 else 0.0, delay, 0.2, 0.05, held=True)
        ways.append(way)
    peak = 1.0 - math.exp(-0.15 / 0.2)
    turned = ways[3 + int(delay / 0.05)]
    assert turned.corner == pytest.approx(peak)
    assert turned.first == pytest.approx(first)
    assert turned.end == pytest.approx(peak * math.exp(-(1.0 - first) * 0.05 / 0.2))
    assert max(way.end for way in ways) <= peak + 1e-12


def test_what_is_measured_is_interpolated() -> None:
    line: tuple[float, ...] = (0.0,) * 9
    for k in range(40):
        line, way = arrived(line, float(k), 0.13, 0.0, 0.05, held=False)
    assert way.end == pytest.approx(39.0 - 0.13 / 0.05)
    assert way.corner == pytest.approx(36.0)
