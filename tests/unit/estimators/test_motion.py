"""A stiff step of the single track against many small ones, and its differences against differences of that."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.diagram.maths import rk4
from steerkit.estimators.motion import answer, course, moved
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.single_track import SingleTrack
from steerkit.vehicles import VW_PASSAT

H = 0.05
plants = pytest.mark.parametrize(
    "plant", [NonlinearSingleTrack(vehicle=VW_PASSAT), LinearSingleTrack(vehicle=VW_PASSAT)]
)


def finely(plant: SingleTrack, x: tuple[float, ...], delta: float, v: float, h: float = H) -> tuple[float, ...]:
    for _ in range(500):
        x = rk4(lambda now: plant.rhs(now, delta, v), x, h / 500)
    return x


def step(plant: SingleTrack, x: tuple[float, ...], delta: float, v: float) -> np.ndarray:
    linear = answer(plant.rhs, x, delta, v, H)
    return np.array(moved(plant.rhs, x, delta, v, H, linear.rate, linear.reach))


@plants
@pytest.mark.parametrize("v", [2.0, 4.0, 7.0, 15.0, 30.0])
def test_a_step_is_that_of_many_small_ones(plant: SingleTrack, v: float) -> None:
    """After a turn of the wheel by a degree of the road wheels, the yaw rate and the pose on the way."""
    delta = min(0.3, 2.0 * (2.7 + 0.003 * v * v) / v**2)  # about 2 m/s^2
    x = finely(plant, (0.0, 0.0, 0.4, 0.0, 0.0), delta, v, 2.0)
    found, exact = step(plant, x, delta + 0.0175, v), np.array(finely(plant, x, delta + 0.0175, v))
    change = abs(exact[3:] - x[3:])
    assert (abs(found - exact)[3:] <= 0.1 * change + 1e-6).all()
    assert abs(found - exact)[:2].max() < 1e-3
    assert abs(found - exact)[2] < 3e-4


@plants
@pytest.mark.parametrize("v", [0.0, 0.3, 1.5])
def test_at_walking_pace_it_settles_and_does_not_blow_up(plant: SingleTrack, v: float) -> None:
    x = np.array((0.0, 0.0, 0.0, 0.3, 1.0))
    for _ in range(40):
        x = step(plant, tuple(x.tolist()), 0.2, v)
    assert x[4] == pytest.approx(finely(plant, (0.0, 0.0, 0.0, 0.0, 0.0), 0.2, v, 2.0)[4], abs=1e-4)
    assert np.isfinite(x).all()


@plants
def test_what_it_depends_on(plant: SingleTrack) -> None:
    x, delta, v = (0.0, 0.0, 0.4, *finely(plant, (0.0, 0.0, 0.4, 0.0, 0.0), 0.1, 6.0, 2.0)[3:]), 0.1, 6.0
    linear = answer(plant.rhs, x, delta, v, H)
    small = 1e-3

    def by(i: int) -> np.ndarray:
        other = tuple(value + small * (i == j) for j, value in enumerate(x))
        return (np.array(finely(plant, other, delta, v)) - np.array(finely(plant, x, delta, v))) / small

    assert [linear.keeps[0], linear.keeps[2]] == pytest.approx(by(3)[3:], abs=0.01)
    assert [linear.keeps[1], linear.keeps[3]] == pytest.approx(by(4)[3:], abs=0.01)
    turned = (np.array(finely(plant, x, delta + small, v)) - np.array(finely(plant, x, delta, v))) / small
    assert linear.turned == pytest.approx(turned[3:], rel=0.02)
    driven = (np.array(finely(plant, x, delta, v + small)) - np.array(finely(plant, x, delta, v))) / small
    assert linear.driven[:2] == pytest.approx(driven[:2], abs=2e-3)
    assert linear.driven[2:] == pytest.approx(driven[3:], abs=5e-3)


@plants
def test_speed_and_sideslip(plant: SingleTrack) -> None:
    x = finely(plant, (0.0, 0.0, 0.0, 0.0, 0.0), 0.15, 5.0, 2.0)
    dx, dy = np.array(finely(plant, x, 0.15, 5.0, 1e-3)[:2]) - x[:2]
    speed, beta = course(plant.rhs, x[3], x[4], 0.15, 5.0)
    assert speed == pytest.approx(np.hypot(dx, dy) / 1e-3, rel=1e-4)
    assert beta == pytest.approx(np.arctan2(dy, dx) - x[2], abs=1e-3)
    assert course(plant.rhs, 0.0, 0.0, 0.1, 0.0) == (0.0, 0.0)
