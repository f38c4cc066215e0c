"""Wrong beliefs about a car: off by the stated amounts, with all signs; everything else is true."""

import math

import pytest

from benchmarks.wrong_belief import driven, unlike, wrong_belief


def test_eight_cars_in_a_row_are_wrong_by_the_same_with_all_signs() -> None:
    signs = set()
    for number in range(3000, 3008):
        wrong, true = wrong_belief(number)
        late = wrong.believed_dead_time - true.believed_dead_time
        assert (abs(late), abs(true.steering.offset_deg)) == pytest.approx((0.2, 3.0))
        assert true.vehicle.ratio in (0.8, 1.25)
        assert wrong.design_model().delay >= 0.0
        assert (wrong.design_model().offset, true.design_model().offset) == (
            0.0,
            pytest.approx(true.steering.offset_deg * 0.0174532925),
        )
        assert wrong.design_model().vehicle.steer_ratio * true.vehicle.ratio == pytest.approx(
            true.design_model().vehicle.steer_ratio
        )
        assert wrong.with_(knowledge={"oracle": True, "delay": None}) == true
        signs.add((late > 0.0, true.steering.offset_deg > 0.0, true.vehicle.ratio > 1.0))
    assert len(signs) == 8


def test_a_controller_with_wrong_belief_drives_worse() -> None:
    wrong, true = wrong_belief(3004)
    oracle, mistaken = (driven("lqr", scenario, seed=1, seconds=16.0) for scenario in (true, wrong))
    assert oracle.rms_e < 0.03 < 0.5 * mistaken.rms_e
    assert oracle.max_e < mistaken.max_e
    assert oracle.rms_wheel_deg > 1.0


def test_cars_are_wrong_by_what_is_said_and_behind_an_estimator_nothing_is_late() -> None:
    zeros = set()
    for number in (3004, 3008):
        raw, behind = unlike(number, "none"), unlike(number, "adaptive-state")
        wrong, true = wrong_belief(number)
        assert (raw.knowledge.delay, behind.sensors.estimator) == (wrong.knowledge.delay, "adaptive-state")
        assert behind.believed_dead_time == pytest.approx(max(raw.believed_dead_time - raw.sensors.latency, 0.0))
        assert (raw.vehicle.ratio, raw.steering.offset_deg) == (true.vehicle.ratio, true.steering.offset_deg)
        assert 0.8 <= raw.vehicle.tyres <= 1.25
        assert abs(raw.sensors.gyro_zero_deg) <= 0.3
        assert raw.sensors.kind == "no sideslip"
        zeros.add(raw.steering.wheel_zero_deg)
    assert zeros == {3.0, -3.0}


def test_errors_are_those_of_what_is_seen_and_an_estimator_sees_better() -> None:
    raw, behind = (
        driven("stanley-adaptive", unlike(4001, kind), seed=4001, seconds=10.0) for kind in ("none", "adaptive-state")
    )
    assert math.isnan(raw.nis_mean)
    assert 0.5 < behind.nis_mean < 2.0
    assert 0.7 < behind.nis_share <= 1.0
    assert behind.rms_heading < 0.7 * raw.rms_heading < 0.03  # 50 ms of latency are 0.4 degrees and more
    assert 0.001 < raw.rms_side < 0.05
    assert raw.max_e > raw.rms_e > 0.0
