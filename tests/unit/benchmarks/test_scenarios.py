"""What is driven, and what the controllers are told of it."""

from __future__ import annotations

import math

import pytest

from benchmarks.entries import controller
from benchmarks.scenarios import Scenario
from steerkit.units import radians_of
from steerkit.vehicles import G, vehicle

PASSAT = vehicle("vw-passat")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"course": "papr"}, "did you mean 'paper'"),
        ({"plant": "bicycle"}, "valid: nonlinear, linear, commonroad-mb"),
        ({"speed": "fast"}, "valid: wander, recorded"),
        ({"v_min": 9.0}, "v_min = 9.0, v_max = 7.5"),
        ({"tyres": 0.0}, "tyres = 0.0"),
        ({"noise": -1.0}, "noise -1.0"),
        ({"name": "a--b"}, "holds '--'"),
        ({"plant": "commonroad-mb", "vehicle_name": "bmw-320i", "wind": 1.0}, "multi-body car has no other"),
    ],
)
def test_bad_scenarios(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scenario(**({"name": "x"} | changes))


def test_what_is_wrong_with_the_car_is_not_told() -> None:
    scenario = Scenario(name="x", tyres=0.7, friction=0.5, ratio=1.1, delay=0.2, told_delay=0.0)
    true = scenario.true_vehicle
    assert (true.c_f, true.mu, true.steer_ratio) == (0.7 * PASSAT.c_f, 0.5 * PASSAT.mu, 1.1 * PASSAT.steer_ratio)
    assert scenario.nominal == PASSAT
    assert scenario.told_dead_time == 0.0
    assert Scenario(name="x", delay=0.2, latency=0.05).told_dead_time == 0.25
    banked = Scenario(name="y", bank_deg=2.0)
    car = banked.loop(banked.path(), controller("stanley").make(banked, banked.path())).blocks["car"]  # type: ignore[misc]
    assert car.bank == pytest.approx(G * math.sin(radians_of(2.0)))
