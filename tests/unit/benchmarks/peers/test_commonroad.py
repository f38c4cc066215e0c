"""CommonRoad's multi-body car as a plant."""

import math

import pytest

from benchmarks.peers.commonroad import VANAGON_FILE, CommonRoadMultiBody
from benchmarks.scenarios import MULTI_BODY
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.scenario import Scenario
from steerkit.vehicles import vehicle
from tests.support.straight_on import straight_on


def test_the_multi_body_car_corners_like_its_single_track_where_that_holds() -> None:
    pytest.importorskip("vehiclemodels")
    v, delta_sw = 5.0, 0.4
    _, ours = straight_on(NonlinearSingleTrack(vehicle=vehicle("bmw-320i"), v0=v), 3.0, delta_sw, v)
    body = CommonRoadMultiBody(v0=v)
    _, theirs = straight_on(body, 3.0, delta_sw, v)
    assert theirs[-1].r == pytest.approx(ours[-1].r, rel=0.05)
    assert theirs[-1].a_y == pytest.approx(ours[-1].a_y, rel=0.05)
    assert theirs[-1].v == pytest.approx(v, rel=0.02)
    assert theirs[-1].delta_sw == delta_sw
    assert math.isnan(body.update(0.0, (math.nan, *body.init()[1:]), body.U(0.0, v), None)[3])
    with pytest.raises(ValueError, match="cannot be batched"):
        body.init((2,))
    with pytest.raises(ValueError, match="valid: bmw-320i, ford-escort, vw-vanagon"):
        CommonRoadMultiBody(vehicle=vehicle("vw-passat"))


def test_its_pedals_reach_a_speed_no_faster_than_a_human_would() -> None:
    pytest.importorskip("vehiclemodels")
    for v_cmd, sign in ((25.0, 1.0), (1.0, -1.0)):
        _, seen = straight_on(CommonRoadMultiBody(v0=10.0), 0.5, 0.0, v_cmd)
        assert 0.5 < sign * (seen[-1].v - seen[0].v) / 0.5 < 3.2


def test_a_vehicle_file_brings_the_third_car() -> None:
    pytest.importorskip("vehiclemodels")
    scenario = Scenario(vehicle={**VANAGON_FILE, "plant": MULTI_BODY})
    _, seen = straight_on(CommonRoadMultiBody(vehicle=scenario.nominal, v0=10.0), 3.0, 0.3, 10.0)
    _, ours = straight_on(NonlinearSingleTrack(vehicle=scenario.nominal, v0=10.0), 3.0, 0.3, 10.0)
    assert seen[-1].r == pytest.approx(ours[-1].r, rel=0.1)
