"""A pushed car: banks turn it as its steady state says, gusts follow their seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.pushed import Pushed
from steerkit.vehicles import vehicle
from tests.support.straight_on import straight_on

PASSAT = vehicle("vw-passat")


@pytest.mark.parametrize("kind", [LinearSingleTrack, NonlinearSingleTrack])
def test_a_bank_turns_the_car_as_its_steady_state_says(kind) -> None:
    """Steady, wheels straight: m v r = F_f + F_r + m a and l_f F_f = l_r F_r, linear in (beta, r)."""
    a, v, p = 0.3, 7.0, PASSAT
    inner = kind(vehicle=p, v0=v)
    _, ys = straight_on(Pushed(block=inner, bank=a), 6.0, v=v)
    matrix = np.array(
        [
            [-(p.c_f + p.c_r), (p.c_r * p.l_r - p.c_f * p.l_f) / v - p.m * v],
            [p.c_r * p.l_r - p.c_f * p.l_f, -(p.c_f * p.l_f**2 + p.c_r * p.l_r**2) / v],
        ]
    )
    beta, r = np.linalg.solve(matrix, [-p.m * a, 0.0])
    assert ys[-1].beta == pytest.approx(beta, rel=0.03)  # what is left of the splitting at dt = 10 ms
    assert ys[-1].r == pytest.approx(r, rel=0.03)
    assert ys[-1].a_y == pytest.approx(v * r, abs=0.03 * a)


def test_no_push_is_the_car_itself_and_gusts_follow_their_seed() -> None:
    inner = NonlinearSingleTrack(vehicle=PASSAT, v0=7.0)
    (*x, _, _, _, _, _, _, _), _ = straight_on(Pushed(block=inner), 1.0, 0.5)
    assert x == straight_on(inner, 1.0, 0.5)[0]
    gusty = Pushed(block=inner, gust=0.2, seed=1)
    assert straight_on(gusty, 2.0)[0] == straight_on(gusty, 2.0)[0] != straight_on(replace(gusty, seed=2), 2.0)[0]
    _, ys = straight_on(Pushed(block=inner, gust=0.2, gust_time=0.05), 60.0)
    pushes = np.diff([y.r for y in ys])
    assert abs(np.mean(pushes)) < 0.1 * np.std(pushes)
    with pytest.raises(ValueError, match="gust = -1"):
        Pushed(block=inner, gust=-1.0)
