"""Scenarios: what makes one, what is refused, what controllers are told, and files that they keep."""

from __future__ import annotations

import math
import os
import pickle
from dataclasses import fields, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.paths.courses import course
from steerkit.plants.disturbed_plant import DisturbedPlant
from steerkit.scenario import END_MARGIN, Scenario
from steerkit.vehicles import G, vehicle
from steerkit.vehicles.file import vehicle_text
from tests.support.yard import yard

PASSAT = vehicle("vw-passat")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"course": "papr"}, r"scenario 'x': course 'papr' is not known \(did you mean 'paper'\?\).*FILE.csv"),
        ({"course": "random-x"}, "course 'random-x' is not known"),
        ({"course": "no.csv"}, "course no.csv cannot be read"),
        ({"vehicle": "vw-pasat"}, "did you mean 'vw-passat'"),
        ({"vehicle": "no.toml"}, "vehicle no.toml cannot be read"),
        ({"plant": "bicycle"}, "plant 'bicycle' is not known; valid: nonlinear, linear, package.module:Class"),
        ({"plant": "steerkit.plants.single_track:Cat"}, "steerkit.plants.single_track has no 'Cat'"),
        ({"plant": "steerkit.doe:Integrator"}, "expected a subclass of Car"),
        ({"speed": "fast"}, "speed 'fast'; valid: wander, recorded"),
        ({"speed": "recorded"}, "'paper' is not known.*genesis"),
        ({"reference": "rear"}, "reference 'rear'; valid: front, cg, own"),
        ({"recovery": "lqr"}, "recovery 'lqr'; valid: fitting, adapting, stanley, stanley-delay"),
        ({"v_min": 9.0}, "v_min = 9.0, v_max = 7.5"),
        ({"v_min": 0.0}, r"v_min = 0.0 \[m/s\], expected 0.2 to 40"),
        ({"lag": -1.0}, r"lag = -1.0 \[s\], expected 0 to 10"),
        ({"lag": math.nan}, "lag = nan"),
        ({"lag": "much"}, r"lag = 'much', expected a number \[s\]"),
        ({"delay": 0.123}, "delay = 0.123.*valid: 0.12 or 0.13"),
        ({"latency": 0.02}, "latency = 0.02"),
        ({"delay": 1.5, "latency": 1.0}, "add up to 2.5"),
        ({"tyres": 0.0}, "tyres = 0.0"),
        ({"tyres": 10.0, "vehicle": "bmw-320i"}, "c_f"),
        ({"noise": -1.0}, "noise = -1.0"),
        ({"noise": True}, r"noise = True, expected a number \[1\]"),
        ({"rounds": 0.0}, "rounds = 0.0"),
        ({"closed": True}, "only a course from a file"),
        ({"name": "a--b"}, "holds '--'"),
        ({"plant": "benchmarks.peers.commonroad:CommonRoadMultiBody"}, "valid: bmw-320i, ford-escort"),
        (
            {"plant": "benchmarks.peers.commonroad:CommonRoadMultiBody", "vehicle": "bmw-320i", "ratio": 1.1},
            "no other tyres, friction or ratio",
        ),
        (
            {"plant": "benchmarks.peers.commonroad:CommonRoadMultiBody", "vehicle": "bmw-320i", "wind": 1.0},
            "only single-track cars are pushed",
        ),
    ],
)
def test_what_cannot_be_driven_is_refused_when_it_is_made(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        Scenario(**({"name": "x"} | changes))
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith("scenario '")


def test_what_is_wrong_with_the_car_is_not_told() -> None:
    scenario = Scenario(tyres=0.7, friction=0.5, ratio=1.1, delay=0.2, believed_delay=0.0)
    true = scenario.true_vehicle
    assert (true.c_f, true.mu, true.steer_ratio) == (0.7 * PASSAT.c_f, 0.5 * PASSAT.mu, 1.1 * PASSAT.steer_ratio)
    assert scenario.nominal == PASSAT
    assert (scenario.design_model().vehicle, scenario.design_model().delay) == (PASSAT, 0.0)
    late = Scenario(delay=0.2, latency=0.05, lag=0.3).design_model()
    assert (late.delay, late.lag, late.hold, late.rate_limit) == (0.25, 0.3, 0.01, radians_of(550.0))
    assert Scenario(lag=0.3, believed_lag=0.1).design_model().lag == 0.1


def test_a_controller_without_a_point_of_its_own_is_judged_where_the_scenario_says() -> None:
    assert {where: Scenario(reference=where).ahead for where in ("front", "cg", "own")} == {
        "front": PASSAT.l_f,
        "cg": 0.0,
        "own": PASSAT.l_f,
    }


def test_an_open_course_is_driven_without_its_ends_and_no_farther() -> None:
    for name, ends in (("genesis-rfs", 2.0 * END_MARGIN), ("paper", 0.0)):
        scenario = Scenario(course=name, rounds=1.5)
        assert scenario.round_length == course(name).length - ends
        assert scenario.length == 1.5 * scenario.round_length


def test_what_depends_on_the_seed_is_random() -> None:
    steady = Scenario(v_min=5.0, v_max=5.0)
    assert not steady.random
    assert not replace(steady, wind=1.0, latency=0.05).random
    assert Scenario().random
    assert replace(steady, noise=0.5).random
    assert replace(steady, gust=0.1).random
    assert not Scenario(course="genesis", speed="recorded").random


def test_all_noises_grow_together() -> None:
    one, two = (Scenario(noise=factor).sensors(3) for factor in (1.0, 2.5))
    assert one is not None
    assert two is not None
    for name in ("position_drift", "psi_drift", "r_noise"):
        assert getattr(two, name) == 2.5 * getattr(one, name) > 0.0


def test_bank_and_wind_push_the_car() -> None:
    banked = Scenario(bank_deg=2.0, wind=0.3, gust=0.1)
    car = banked.car(banked.path(), seed=4)
    assert isinstance(car, DisturbedPlant)
    assert car.bank == pytest.approx(G * math.sin(radians_of(2.0)))
    assert (car.wind, car.gust, car.seed) == (0.3, 0.1, 4)
    assert not isinstance(Scenario().car(course("paper")), DisturbedPlant)


def test_hard_conditions_are_noise_latency_and_lag() -> None:
    hard = Scenario.under("hard", course="genesis")
    assert hard == Scenario(course="genesis", noise=1.0, latency=0.05, lag=0.15)
    assert hard.sensors(3).latency == 0.05  # type: ignore[union-attr]
    assert Scenario().sensors(3) is None
    with pytest.raises(ValueError, match=r"conditions 'harder' is not known.*clean, hard"):
        Scenario.under("harder")
    with pytest.raises(ValueError, match="no field 'lagg'; valid: name, course"):
        Scenario.under(lagg=0.1)


def test_the_stops_of_the_car_are_those_of_its_motor_and_its_controllers(tmp_path: FilePath) -> None:
    (tmp_path / "narrow.toml").write_text(vehicle_text(replace(PASSAT, delta_sw_max=radians_of(300.0))))
    scenario = Scenario(vehicle=str(tmp_path / "narrow.toml"))
    assert scenario.actuator().limit == radians_of(300.0)
    assert scenario.recovery_controller().limit == radians_of(300.0)  # type: ignore[attr-defined]


# ---- files ------------------------------------------------------------------------------------------------------


def test_a_course_and_a_car_from_files_stay_what_they_were(tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "car.toml").write_text(vehicle_text(replace(PASSAT, m=1500.0, name="mine")))
    file = yard(tmp_path)
    scenario = Scenario(course=str(file), vehicle=str(tmp_path / "car.toml"))
    assert (scenario.course, scenario.vehicle) == ("yard.csv", "car.toml")
    assert scenario.path().closed
    assert scenario.path().length == pytest.approx(2.0 * math.pi * 20.0, rel=1e-3)
    assert scenario.nominal.m == 1500.0
    yard(tmp_path, radius=30.0)  # another course under the same name
    (tmp_path / "car.toml").unlink()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for same in (pickle.loads(pickle.dumps(scenario)), replace(scenario, v_max=7.5)):
        assert same == scenario
        assert hash(same) == hash(scenario)
        assert same.path().length == pytest.approx(2.0 * math.pi * 20.0, rel=1e-3)
        assert same.nominal.m == 1500.0
    assert Scenario(course=str(file)) != replace(scenario, vehicle="vw-passat")


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_a_file_is_closed_if_its_ends_meet_or_if_it_says_so(share: float, tmp_path: FilePath) -> None:
    file = yard(tmp_path, share=share)
    path = Scenario(course=str(file)).path()
    assert path.closed is (share == 1.0)
    path.to_csv(tmp_path / "again.csv")
    assert Scenario(course=str(tmp_path / "again.csv")).path().closed is path.closed
    if share == 1.0:
        assert not Scenario(course=str(file), closed=False).path().closed


@pytest.mark.parametrize(("gap", "closed"), [(8.0, True), (12.0, False)])
def test_ends_in_degrees_meet_within_three_steps(gap: float, closed: bool, tmp_path: FilePath) -> None:
    """At 60 degrees north, where a degree of longitude is half as long as one of latitude; steps of 3 m."""
    radius, metre = 30.0, 1.0 / 111_320.0
    turns = np.linspace(0.5 * gap / radius, 2.0 * math.pi - 0.5 * gap / radius, 60)
    x, y = radius * np.cos(turns), radius * np.sin(turns)
    for n, (east, north) in enumerate(((x, y), (y, x))):  # the gap lies along the meridian, then along the parallel
        file = tmp_path / f"{n}.csv"
        lat, lon = 60.0 + metre * north, 8.0 + 2.0 * metre * east
        file.write_text("lat,lon\n" + "".join(f"{a:.9f},{b:.9f}\n" for a, b in zip(lat, lon)))
        assert Scenario(course=str(file)).path().closed is closed


def test_a_vehicle_files_steering_is_the_motor_under_conditions_and_not_in_the_constructor(tmp_path: FilePath) -> None:
    file = tmp_path / "car.toml"
    file.write_text(vehicle_text(PASSAT, steering={"delay": 0.21, "lag": 0.08, "offset": 0.05}))
    scenario = Scenario.under("hard", vehicle=str(file))
    assert (scenario.delay, scenario.noise) == (0.2, 1.0)
    assert scenario.lag == pytest.approx(0.08)
    assert scenario.actuator().offset == pytest.approx(0.05)
    assert Scenario.under(vehicle=str(file), delay=0.1).delay == 0.1
    assert (Scenario(vehicle=str(file)).delay, Scenario(vehicle=str(file)).lag) == (0.0, 0.12)


def test_whole_numbers_are_numbers() -> None:
    assert Scenario(v_max=9, rounds=2) == Scenario(v_max=9.0, rounds=2.0)
    assert all(isinstance(getattr(Scenario(v_max=9), f.name), float) for f in fields(Scenario) if f.type == "float")


def test_a_broken_file_is_named(tmp_path: FilePath) -> None:
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n3,4\n")
    with pytest.raises(ValueError, match=r"bad.csv: columns a, b; valid: x, y"):
        Scenario(course=str(tmp_path / "bad.csv"))
    (tmp_path / "bad.toml").write_text("nonsense")
    with pytest.raises(ValueError, match=r"bad.toml: not TOML"):
        Scenario(vehicle=str(tmp_path / "bad.toml"))
    assert os.listdir(tmp_path)
