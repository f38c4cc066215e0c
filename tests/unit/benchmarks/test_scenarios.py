"""What the suites drive: where it begins, where it is judged, and what a compiled drive leaves open."""

from pathlib import Path

import pytest

from benchmarks.entries import controller
from benchmarks.scenarios import (
    DELAYS,
    KINDS,
    MULTI_BODY,
    facts,
    of_kind,
    open_parameters,
    scene,
    shape,
    suite_loop,
    unlike_the_data_sheet,
)
from tests.support.yard import yard

STEP = scene(name="step", course="curvature-step", driver={"v_min": 7.0, "v_max": 7.0})


def test_an_open_course_is_driven_from_5_m_on_and_judged_where_the_controller_steers() -> None:
    loop = suite_loop(STEP, controller("pure-pursuit").make(STEP))  # type: ignore[misc]
    assert loop.sample(loop.init())["path.s"] == pytest.approx(5.0 - STEP.nominal.l_r, abs=1e-6)
    assert loop.blocks["path"].reference == -STEP.nominal.l_r  # type: ignore[attr-defined]
    circle = STEP.with_(course="circle")
    loop = suite_loop(circle, controller("stanley").make(circle))  # type: ignore[misc]
    assert loop.blocks["path"].reference == STEP.nominal.l_f  # type: ignore[attr-defined]


def test_scenarios_that_differ_in_what_is_open_share_a_shape() -> None:
    other = STEP.with_(
        name="other",
        vehicle={"tyres": 0.8, "ratio": 1.1},
        steering={"offset_deg": 3.0, "lag": 0.3},
        driver={"v_min": 5.0, "v_max": 6.0},
    )
    told = other.with_(knowledge={"lag": STEP.steering.lag})  # what a controller is told is built into it
    assert shape(told) == shape(STEP) != shape(other)
    assert shape(STEP.with_(disturbances={"wind": 0.1})) != shape(STEP)
    for case in (other, told, STEP.with_(sensors={"latency": 0.05}), STEP.with_(knowledge={"delay": 0.3, "lag": 0.05})):
        believed, meant = shape(case).design_model(), case.design_model()
        assert (believed.delay, believed.lag) == (meant.delay, meant.lag)
    assert "car.block.vehicle.c_f" in open_parameters(STEP.with_(disturbances={"wind": 0.1}))
    assert "driver.driver.v_min" not in open_parameters(STEP.with_(course="iso3888-1"))
    assert open_parameters(STEP.with_(vehicle={"plant": MULTI_BODY, "name": "bmw-320i"})) == ()


def test_what_a_controller_that_knows_the_truth_knows_is_not_left_out_of_the_shape() -> None:
    known = STEP.with_(knowledge={"oracle": True}, vehicle={"ratio": 1.25, "tyres": 0.6}, steering={"offset_deg": 2.0})
    assert shape(known).design_model() == known.design_model()
    assert shape(known) != shape(known.with_(vehicle={"ratio": 1.2}))


def test_cars_unlike_their_data_sheet_begin_where_their_scenario_says_and_tell_nothing() -> None:
    cars = unlike_the_data_sheet()
    delays = [one.steering.delay for one in cars if one.name.startswith("fleet-")]
    assert delays == [0.1, 0.12, 0.15, 0.2]
    for one in cars:
        believed = one.design_model()
        assert (believed.delay, believed.lag, believed.vehicle) == (0.0, 0.0, one.nominal)
    slow = cars[0]
    loop = suite_loop(slow, controller("stanley").make(slow))  # type: ignore[misc]
    front = loop.sample(loop.init())["path.s"] % slow.path().length
    assert front == pytest.approx(slow.course.start + slow.nominal.l_f, abs=0.1)


def test_every_kind_of_car_starts_where_it_is_straight_and_can_be_told_the_truth() -> None:
    for kind in KINDS:
        cars = of_kind(kind, course={"rounds": 0.5})
        assert len({car.name for car in cars}) == len(cars)
        for car in cars:
            assert car.course.rounds == 0.5
            assert abs(car.path().kappa(car.course.start)) < 0.01
            assert car.with_(knowledge={"oracle": True}).design_model().gain == car.steering.gain
    assert [car.steering.delay for car in of_kind("delays")] == list(DELAYS)


def test_the_protocol_tells_one_file_from_another(tmp_path: Path) -> None:
    one = facts(STEP.with_(course=str(yard(tmp_path))))
    two = facts(STEP.with_(course=str(yard(tmp_path, radius=30.0))))
    assert one["course.name"] == two["course.name"] == "yard.csv"
    assert len({one["course.text"], two["course.text"], facts(STEP)["course.text"]}) == 3
