"""MuJoCo's car on four suspended wheels."""

import math

import pytest

from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.vehicles import vehicle
from tests.support.straight_on import straight_on

pytest.importorskip("mujoco")
from benchmarks.plants.mujoco_car import MujocoCar


@pytest.mark.parametrize(("v", "delta_sw"), [(5.0, 1.0), (10.0, -0.3), (20.0, 0.2)])
def test_it_corners_like_the_single_track_of_its_data_sheet_where_that_holds(v: float, delta_sw: float) -> None:
    _, ours = straight_on(NonlinearSingleTrack(vehicle=vehicle("vw-passat"), v0=v), 4.0, delta_sw, v)
    x, theirs = straight_on(MujocoCar(v0=v), 4.0, delta_sw, v)
    assert theirs[-1].r == pytest.approx(ours[-1].r, rel=0.04)
    assert theirs[-1].a_y == pytest.approx(ours[-1].a_y, rel=0.05)
    assert theirs[-1].v == pytest.approx(v, rel=0.01)
    assert theirs[-1].psi == pytest.approx(ours[-1].psi, rel=0.05)
    assert abs(theirs[2].r) < abs(ours[2].r), "its tyres answer after a stretch of road"
    left, right = x[29] + x[31], x[30] + x[32]
    assert (left - right) * theirs[-1].a_y < 0.0, "the outer wheels carry more"
    assert left + right == pytest.approx(1639.0 * 9.81, rel=0.01)


def test_equal_states_go_on_equally_whatever_was_computed_in_between() -> None:
    car = MujocoCar(v0=10.0, psi0=1.0, x0=5.0)
    x, _ = straight_on(car, 0.5, 0.3, 10.0)
    first = car.update(0.0, tuple(x), car.U(0.3, 10.0), None)
    straight_on(car, 0.2, -0.5, 12.0)
    assert car.update(0.0, tuple(x), car.U(0.3, 10.0), None) == first
    assert all(map(math.isnan, car.update(0.0, first, car.U(math.nan, 10.0), None)))


def test_its_pedals_reach_a_speed_no_faster_than_a_human_would() -> None:
    for v_cmd, sign in ((25.0, 1.0), (2.0, -1.0)):
        _, seen = straight_on(MujocoCar(v0=10.0), 0.5, 0.0, v_cmd)
        assert 0.5 < sign * (seen[-1].v - seen[0].v) / 0.5 < 3.2


def test_what_it_cannot_do_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot be batched"):
        MujocoCar().init((2,))
    with pytest.raises(ValueError, match="substeps = 2"):
        MujocoCar(substeps=2)
