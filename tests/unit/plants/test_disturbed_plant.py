"""A pushed car: banks turn it as its steady state says, gusts follow their seed."""

import math
from dataclasses import replace

import numpy as np
import pytest

from steerkit.plants.disturbed_plant import DisturbedPlant
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack, SingleTrack
from steerkit.vehicles import VW_PASSAT
from tests.support.straight_on import straight_on

CAR, V = VW_PASSAT, 7.0


def test_no_push_is_the_car_itself_and_gusts_follow_their_seed() -> None:
    inner = NonlinearSingleTrack(vehicle=CAR, v0=7.0)
    (*x, _, _, _, _, _, _, _), _ = straight_on(DisturbedPlant(block=inner), 1.0, 0.5)
    assert x == straight_on(inner, 1.0, 0.5)[0]
    gusty = DisturbedPlant(block=inner, gust=0.2, seed=1)
    assert straight_on(gusty, 2.0)[0] == straight_on(gusty, 2.0)[0] != straight_on(replace(gusty, seed=2), 2.0)[0]
    _, ys = straight_on(DisturbedPlant(block=inner, gust=0.2, gust_time=0.05), 60.0)
    pushes = np.diff([y.r for y in ys])
    assert abs(np.mean(pushes)) < 0.1 * np.std(pushes)


@pytest.mark.parametrize("kind", [LinearSingleTrack, NonlinearSingleTrack])
@pytest.mark.parametrize(
    "push", [{"wind": 0.03}, {"wind": -0.03, "arm": -0.5}, {"bank": 0.03}, {"wind": 0.02, "bank": 0.01}]
)
def test_the_steady_drift_is_that_of_forces_and_moments(kind: type[SingleTrack], push: dict[str, float]) -> None:
    """m v r = F_f + F_r + m (wind + bank),  0 = l_f F_f - l_r F_r + m wind arm: the bank has no lever."""
    car = DisturbedPlant(block=kind(vehicle=CAR, v0=V, dt=0.002), dt=0.002, **push)  # little is left of the splitting
    y = straight_on(car, 4.0)[1][-1]
    sides = [
        [-(CAR.c_f + CAR.c_r), (CAR.c_r * CAR.l_r - CAR.c_f * CAR.l_f) / V - CAR.m * V],
        [CAR.c_r * CAR.l_r - CAR.c_f * CAR.l_f, -(CAR.c_f * CAR.l_f**2 + CAR.c_r * CAR.l_r**2) / V],
    ]
    pushes = [CAR.m * (car.wind + car.bank), CAR.m * car.wind * car.arm]
    beta, r = np.linalg.solve(sides, [-push for push in pushes])
    assert (y.beta, y.r) == pytest.approx((beta, r), rel=0.02, abs=1e-7)
    assert y.a_y == pytest.approx(V * y.r, abs=1e-3)


def test_gusts_have_the_stated_deviation_and_correlation() -> None:
    n, seconds = 4000, 0.5
    car = DisturbedPlant(block=LinearSingleTrack(vehicle=CAR, v0=V), gust=0.2, gust_time=1.0, seed=3)
    x = car.init((n,))
    first = car._wind(x)
    for k in range(round(seconds / car.dt)):
        x = car.update(k * car.dt, x, car.U(delta_sw_cmd=np.zeros(n), v_cmd=np.full(n, V)), ())
    last = car._wind(x)
    for gusts in (first, last):  # stationary from the first sample on
        assert gusts.std() == pytest.approx(0.2, rel=0.05)
        assert abs(gusts.mean()) < 4.5 * 0.2 / math.sqrt(n)
    assert np.corrcoef(first, last)[0, 1] == pytest.approx(math.exp(-seconds), abs=0.04)
    felt = car.output(0.0, x, ()).a_y - car.block.output(0.0, car._car(x), ()).a_y
    np.testing.assert_allclose(felt, last, rtol=1e-9)
