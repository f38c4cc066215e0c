"""An angle arrives when lag and delay say, between samples too; the yaw rate is the linear single track's."""

import math

import numpy as np
import pytest

from steerkit.estimators.steering_response import arrived, at, steady_gain, yaw_delay, yaw_step
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.vehicles import VW_PASSAT as PASSAT


def test_the_value_of_a_number_is_the_nearest_and_never_outside() -> None:
    numbers = (-1.0, 0.0, 0.5, 0.51, 1.5, 1.50001, 9.0)
    assert [at(number, [10.0, 20.0, 30.0]) for number in numbers] == [10.0, 10.0, 10.0, 20.0, 20.0, 30.0, 30.0]


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.0), (0.1, 0.2), (0.12, 0.3), (0.13, 0.1), (5.0, 0.0)])
def test_a_step_that_is_held_arrives_behind_lag_and_delay_exactly(delay: float, lag: float) -> None:
    line: tuple[float, ...] = (0.0,) * 9
    for k in range(1, 60):
        line, (_, _, end) = arrived(line, 1.0, delay, lag, 0.05, held=True)
        since = 0.05 * k - min(delay, 0.4)  # no longer than the line
        exact = 1.0 - math.exp(-since / max(lag, 1e-3)) if since > 1e-9 else 0.0
        assert end == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize(("delay", "first"), [(0.13, 0.6), (0.05, 0.0)])
def test_the_corner_is_where_the_command_changed(delay: float, first: float) -> None:
    """Up by 1 for three samples, then down: what arrives turns at once, between samples, at its largest."""
    line, ways = (0.0,) * 9, []
    for k in range(12):
        line, way = arrived(line, 1.0 if k < 3 else 0.0, delay, 0.2, 0.05, held=True)
        ways.append(way)
    peak = 1.0 - math.exp(-0.15 / 0.2)
    end = peak * math.exp(-(1.0 - first) * 0.05 / 0.2)
    assert ways[3 + int(delay / 0.05)] == pytest.approx((peak, first, end))
    assert max(way[2] for way in ways) <= peak + 1e-12


def test_what_is_measured_is_interpolated() -> None:
    line: tuple[float, ...] = (0.0,) * 9
    for k in range(40):
        line, (corner, _, end) = arrived(line, float(k), 0.13, 0.0, 0.05, held=False)
    assert (corner, end) == pytest.approx((36.0, 39.0 - 0.13 / 0.05))


@pytest.mark.parametrize("v", [3.0, 8.0, 30.0])
def test_gain_and_delay_are_those_of_the_plants_matrices(v: float) -> None:
    matrices = LinearSingleTrack(vehicle=PASSAT).matrices(v)
    a, b = np.array(matrices[0]), np.array(matrices[1])

    def response(omega: float) -> complex:
        return complex(np.linalg.solve(1j * omega * np.eye(2) - a, b)[1])

    assert response(1e-6).real / PASSAT.steer_ratio == pytest.approx(steady_gain(PASSAT, v), rel=1e-6)
    assert -np.angle(response(1e-3)) / 1e-3 == pytest.approx(yaw_delay(PASSAT, v), rel=1e-3)


@pytest.mark.parametrize("v", [3.0, 8.0, 30.0])
def test_steps_follow_the_plant_and_settle_where_it_does(v: float) -> None:
    car = LinearSingleTrack(vehicle=PASSAT, v0=v, dt=0.001)
    x, beta, r, worst = car.init(), 0.0, 0.0, 0.0
    for k in range(6000):
        angle = float(np.sin(2.0 * np.pi * 0.5 * k * car.dt))
        if k % 50 == 0:
            worst = max(worst, abs(x.r - r))
            half = float(np.sin(2.0 * np.pi * 0.5 * (k * car.dt + 0.025)))
            beta, r = yaw_step(PASSAT, beta, r, half / PASSAT.steer_ratio, v, 0.05)
        x = car.update(0.0, x, car.U(angle, v), None)
    assert worst < 0.05 * steady_gain(PASSAT, v)
    for _ in range(200):
        beta, r = yaw_step(PASSAT, beta, r, 0.01 / PASSAT.steer_ratio, v, 0.05)
    assert r == pytest.approx(0.01 * steady_gain(PASSAT, v))
