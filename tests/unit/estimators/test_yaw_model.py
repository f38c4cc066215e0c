"""The data sheet's yaw rate: steady gain, delay and steps are those of the linear single track."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.estimators.yaw_model import steady_gain, yaw_delay, yaw_step
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.vehicles import vehicle

PASSAT = vehicle("vw-passat")


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
