"""Scenarios: what makes one, what is refused, what controllers are told, and files that they keep."""

import math
import pickle
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.diagram.units import radians_of
from steerkit.paths.courses import course
from steerkit.scenario import END_MARGIN, FORMAT, Scenario, read_scenario, tables, write_scenario
from steerkit.scenario.parts import Course, Driver, Sensing
from steerkit.vehicles import VW_PASSAT as PASSAT
from steerkit.vehicles import vehicle, vehicle_text
from tests.support.yard import yard

MULTI_BODY = "benchmarks.peers.commonroad:CommonRoadMultiBody"
OTHER = {"plant": MULTI_BODY, "name": "bmw-320i"}
HEAD = f'format = "{FORMAT}"\n'


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"course": {"name": 7}}, "course: name = 7, expected text"),
        ({"knowledge": {"oracle": 1}}, "knowledge: oracle = 1, expected true or false"),
        ({"course": {"closed": True}}, "course: closed = True is only for a course from a file"),
        ({"course": {"start": 900.0}}, r"course: start = 900.0 \[m\].*the course's length"),
        ({"course": {"nam": "paper"}}, "course: no field 'nam'; valid: name, closed, start, rounds"),
        ({"vehicle": {"plant": "steerkit.plants.single_track:Cat"}}, "steerkit.plants.single_track has no 'Cat'"),
        ({"vehicle": {"plant": "steerkit.doe:Integrator"}}, "expected a subclass of Car"),
        ({"vehicle": {"tyres": 10.0, "name": "bmw-320i"}}, "c_f"),
        ({"vehicle": {"plant": MULTI_BODY}}, "valid: bmw-320i, ford-escort"),
        ({"vehicle": OTHER | {"ratio": 1.1}}, "no other tyres, friction or ratio"),
        ({"vehicle": OTHER, "disturbances": {"wind": 1.0}}, "disturbances: only single-track cars are pushed"),
        ({"driver": {"speed": "recorded"}}, "'paper' is not known.*genesis"),
        ({"driver": {"v_min": 9.0}}, "driver: v_min = 9.0, v_max = 7.5"),
        ({"driver": "recorded"}, "driver: 'recorded', expected a table of speed, v_min, v_max"),
        ({"steering": {"command": "hands"}}, "steering: command 'hands'; valid: angle, torque"),
        ({"steering": {"lag": "much"}}, r"lag = 'much', expected a number \[s\]"),
        ({"sensors": {"latency": 0.02}}, "latency = 0.02"),
        ({"steering": {"delay": 1.5}, "sensors": {"latency": 1.0}}, "add up to 2.5"),
        ({"reference": "rear"}, "reference 'rear'; valid: front, cg, own"),
        ({"recovery": "lqr"}, "recovery 'lqr'; valid: auto, adaptive, stanley, stanley-delay"),
        ({"name": "a--b"}, "holds '--'"),
    ],
)
def test_what_cannot_be_driven_is_refused_when_it_is_made(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        Scenario(**({"name": "x"} | changes))
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith("scenario '")


def test_controllers_believe_the_data_sheet_and_the_true_delay_and_lag() -> None:
    scenario = Scenario(
        vehicle={"tyres": 0.7, "friction": 0.5, "ratio": 1.1}, steering={"delay": 0.2}, knowledge={"delay": 0.0}
    )
    true = scenario.vehicle.true
    assert (true.c_f, true.mu, true.steer_ratio) == (0.7 * PASSAT.c_f, 0.5 * PASSAT.mu, 1.1 * PASSAT.steer_ratio)
    assert scenario.nominal == PASSAT
    assert (scenario.design_model().vehicle, scenario.design_model().delay) == (PASSAT, 0.0)
    late = Scenario(steering={"delay": 0.2, "lag": 0.3}, sensors={"latency": 0.05}).design_model()
    assert (late.delay, late.lag, late.hold, late.rate_limit) == (0.25, 0.3, 0.01, radians_of(550.0))
    assert Scenario(steering={"lag": 0.3}, knowledge={"lag": 0.1}).design_model().lag == 0.1
    varies = Scenario(steering={"delay": 0.1, "delay_jitter": 0.04}, sensors={"latency": 0.05})
    assert varies.design_model().delay == pytest.approx(0.17)


def test_a_controller_without_a_point_of_its_own_is_judged_where_the_scenario_says() -> None:
    assert {where: Scenario(reference=where).ahead for where in ("front", "cg", "own")} == {
        "front": PASSAT.l_f,
        "cg": 0.0,
        "own": PASSAT.l_f,
    }


def test_an_open_course_is_driven_without_its_ends_and_no_farther() -> None:
    for name, ends in (("genesis-rfs", 2.0 * END_MARGIN), ("paper", 0.0)):
        scenario = Scenario(course={"name": name, "rounds": 1.5})
        assert scenario.round_length == course(name).length - ends
        assert scenario.length == 1.5 * scenario.round_length
        for v_min, slowest in ((2.0, 2.0), (6.0, 4.0)):  # in bends all are slow
            assert scenario.with_(driver={"v_min": v_min}).seconds == math.ceil(scenario.length / slowest + 10.0)


def test_what_depends_on_the_seed_is_random() -> None:
    steady = Scenario(driver={"v_min": 5.0, "v_max": 5.0})
    assert not steady.random
    assert not steady.with_(disturbances={"wind": 1.0}, sensors={"latency": 0.05}).random
    assert Scenario().random
    assert steady.with_(sensors={"noise": 0.5}).random
    assert steady.with_(disturbances={"gust": 0.1}).random
    assert steady.with_(steering={"delay_jitter": 0.03}).random
    assert steady.with_(sensors={"kind": "real"}).random
    assert not Scenario(course="genesis", driver={"speed": "recorded"}).random


def test_hard_conditions_are_noise_latency_and_lag() -> None:
    hard = Scenario.under("hard", course="genesis")
    assert hard == Scenario(course="genesis", sensors={"noise": 1.0, "latency": 0.05}, steering={"lag": 0.15})
    assert Scenario.under("hard", sensors=Sensing(noise=2.0)).sensors == Sensing(noise=2.0)
    with pytest.raises(ValueError, match=r"conditions 'harder' is not known.*clean, hard"):
        Scenario.under("harder")
    with pytest.raises(ValueError, match="no field 'lagg'; valid: name, reference, recovery, course"):
        Scenario.under(lagg=0.1)
    with pytest.raises(ValueError, match="no field 'delay'; it is a field of steering and knowledge"):
        Scenario().with_(delay=0.1)


def test_the_stops_of_the_car_are_those_of_its_motor_and_its_controllers(tmp_path: FilePath) -> None:
    (tmp_path / "narrow.toml").write_text(vehicle_text(replace(PASSAT, delta_sw_max=radians_of(300.0))))
    scenario = Scenario(vehicle=str(tmp_path / "narrow.toml"))
    assert scenario.blocks(scenario.path())["actuator"].limit == radians_of(300.0)  # type: ignore[union-attr]
    assert scenario.recovery_controller().limit == radians_of(300.0)  # type: ignore[attr-defined]


# ---- files ------------------------------------------------------------------------------------------------------


def test_a_course_and_a_car_from_files_stay_what_they_were(tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "car.toml").write_text(vehicle_text(replace(PASSAT, m=1500.0, name="mine")))
    file = yard(tmp_path)
    scenario = Scenario(course=str(file), vehicle=str(tmp_path / "car.toml"))
    assert (scenario.course.name, scenario.vehicle.name) == ("yard.csv", "car.toml")
    assert scenario.path().closed
    assert scenario.path().length == pytest.approx(2.0 * math.pi * 20.0, rel=1e-3)
    assert scenario.nominal.m == 1500.0
    yard(tmp_path, radius=30.0)  # another course under the same name
    (tmp_path / "car.toml").unlink()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for same in (pickle.loads(pickle.dumps(scenario)), scenario.with_(driver={"v_max": 7.5})):
        assert same == scenario
        assert hash(same) == hash(scenario)
        assert same.path().length == pytest.approx(2.0 * math.pi * 20.0, rel=1e-3)
        assert same.nominal.m == 1500.0
    assert Scenario(course=str(file)) != scenario.with_(vehicle="vw-passat")


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
    assert (scenario.steering.delay, scenario.sensors.noise) == (0.2, 1.0)
    assert scenario.steering.lag == pytest.approx(0.08)
    assert scenario.blocks(scenario.path())["actuator"].offset == pytest.approx(0.05)
    assert Scenario.under(vehicle=str(file), steering={"delay": 0.1}).steering.delay == 0.1
    assert (Scenario(vehicle=str(file)).steering.delay, Scenario(vehicle=str(file)).steering.lag) == (0.0, 0.12)


def test_whole_numbers_are_numbers() -> None:
    made = Scenario(driver={"v_max": 9}, course={"rounds": 2}, knowledge={"delay": 1})
    assert made == Scenario(driver=Driver(v_max=9.0), course={"rounds": 2.0}, knowledge={"delay": 1.0})
    assert [type(x) for x in (made.driver.v_max, made.course.rounds, made.knowledge.delay)] == [float] * 3


def test_a_change_leaves_the_other_fields_of_its_part_and_another_file_is_read(tmp_path: FilePath) -> None:
    scenario = Scenario(course={"name": yard(tmp_path), "start": 3.0}, steering={"lag": 0.3})
    changed = scenario.with_(course="circle", steering={"delay": 0.1})
    assert changed == Scenario(course={"name": "circle", "start": 3.0}, steering={"lag": 0.3, "delay": 0.1})
    assert changed.with_(course=str(tmp_path / "yard.csv"), **tables({"steering.delay": 0.0, "name": "x"})) == (
        replace(scenario, name="x")
    )
    assert scenario.with_(course=Course(name="circle")).course.start == 0.0


def test_a_scenario_comes_back_with_its_files(tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "car.toml").write_text(vehicle_text(vehicle("bmw-320i")))
    scenario = Scenario(
        name="".join(map(chr, range(0x180))),
        course={"name": str(yard(tmp_path)), "closed": False},
        vehicle=str(tmp_path / "car.toml"),
        knowledge={"lag": 0.2, "oracle": True},
    )
    write_scenario(scenario, tmp_path / "scenario.toml")
    (tmp_path / "yard.csv").unlink()
    monkeypatch.chdir("/")
    assert read_scenario(tmp_path / "scenario.toml") == scenario


@settings(max_examples=15)
@given(lag=st.floats(0.0, 10.0), offset_deg=st.floats(-90.0, 90.0), believed=st.none() | st.floats(0.0, 2.0))
def test_every_number_comes_back(tmp_path_factory: Any, lag: float, offset_deg: float, believed: Any) -> None:
    scenario = Scenario(steering={"lag": lag, "offset_deg": offset_deg}, knowledge={"delay": believed})
    file = tmp_path_factory.getbasetemp() / "scenario.toml"
    write_scenario(scenario, file)
    assert repr(read_scenario(file)) == repr(scenario)


@pytest.mark.parametrize("given", ['course = "yard.csv"\n', '[course]\nname = "yard.csv"\n'])
def test_files_are_looked_for_beside_the_scenarios_own(given: str, tmp_path: FilePath) -> None:
    yard(tmp_path)
    (tmp_path / "v.csv").write_text("s,v\n0,5\n100,6\n")
    (tmp_path / "s.toml").write_text(HEAD + given + '[driver]\nv_max = 9\nspeed = "v.csv"\n')
    expected = Scenario(course=str(tmp_path / "yard.csv"), driver={"v_max": 9.0, "speed": str(tmp_path / "v.csv")})
    assert read_scenario(tmp_path / "s.toml") == expected
    mean = 100.0 * math.log(6.0 / 5.0) / 100.0  # of 1/v, over the file's stretch; back over the rest of the round
    assert expected.seconds == math.ceil(mean * expected.round_length + 10.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + "lag = 0.1\n", "s.toml: a scenario has no field 'lag'; it is a field of steering and knowledge"),
        (HEAD + "[steering]\nlagg = 0.1\n", "s.toml: scenario: steering: no field 'lagg'; valid: command"),
        (HEAD + 'course = "no.csv"\n', "s.toml: scenario: course: .*no.csv cannot be read"),
        (HEAD + "steering = 3\n", "steering: 3, expected a table of command"),
        (HEAD + "lag = \n", "s.toml: not TOML"),
        (None, "s.toml cannot be read"),
    ],
)
def test_mistakes_in_a_file_name_file_key_and_valid_keys(text: str | None, message: str, tmp_path: FilePath) -> None:
    if text is not None:
        (tmp_path / "s.toml").write_text(text)
    with pytest.raises(ValueError, match=message) as refused:
        read_scenario(tmp_path / "s.toml")
    assert "\n" not in str(refused.value)
