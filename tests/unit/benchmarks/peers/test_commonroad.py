"""CommonRoad's multi-body car as a plant."""

import math
from typing import Any

import pytest

from benchmarks.peers.commonroad import VANAGON_FILE, CommonRoadMultiBody
from benchmarks.scenarios import MULTI_BODY
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.scenario import Scenario
from steerkit.vehicles import vehicle
from tests.support.straight_on import straight_on


@pytest.mark.parametrize(("car", "v", "delta_sw"), [("bmw-320i", 5.0, 0.4), (VANAGON_FILE, 10.0, 0.3)])
def test_the_multi_body_car_corners_like_its_single_track_where_that_holds(car: Any, v: float, delta_sw: float) -> None:
    """The Vanagon comes by a vehicle file."""
    pytest.importorskip("vehiclemodels")
    nominal = vehicle(car) if isinstance(car, str) else Scenario(vehicle={**car, "plant": MULTI_BODY}).nominal
    _, ours = straight_on(NonlinearSingleTrack(vehicle=nominal, v0=v), 3.0, delta_sw, v)
    body = CommonRoadMultiBody(vehicle=nominal, v0=v)
    _, theirs = straight_on(body, 3.0, delta_sw, v)
    assert theirs[-1].r == pytest.approx(ours[-1].r, rel=0.1)
    assert theirs[-1].a_y == pytest.approx(ours[-1].a_y, rel=0.1)
    assert theirs[-1].v == pytest.approx(v, rel=0.02)
    assert theirs[-1].delta_sw == delta_sw
    assert math.isnan(body.update(0.0, (math.nan, *body.init()[1:]), body.U(0.0, v), None)[3])


def test_what_it_cannot_do_is_refused() -> None:
    pytest.importorskip("vehiclemodels")
    with pytest.raises(ValueError, match="cannot be batched"):
        CommonRoadMultiBody().init((2,))
    with pytest.raises(ValueError, match="valid: bmw-320i, ford-escort, vw-vanagon"):
        CommonRoadMultiBody(vehicle=vehicle("vw-passat"))


def test_its_pedals_reach_a_speed_no_faster_than_a_human_would() -> None:
    pytest.importorskip("vehiclemodels")
    for v_cmd, sign in ((25.0, 1.0), (1.0, -1.0)):
        _, seen = straight_on(CommonRoadMultiBody(v0=10.0), 0.5, 0.0, v_cmd)
        assert 0.5 < sign * (seen[-1].v - seen[0].v) / 0.5 < 3.2
