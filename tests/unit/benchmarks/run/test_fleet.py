"""The study of the fleet: what counts as GOOD, as a ratio, and as the worst."""

import math
from dataclasses import replace

import pytest

from benchmarks.run import fleet
from benchmarks.run.fleet import KINDS, FleetOutcome, of_fleet, of_kind, one_car, summarise
from steerkit.learning.settings import setting

CAR = dict(name="fleet-0", seed=0, car="a", delay=0.1, lag=0.2, offset_deg=1.0, play_deg=0.0)
LEARNT = dict(good=10.0, failures=1, departure=2.0, stuck=0, nets=30, held=True, dead_time=0.15)
DROVE = dict(rms_e=0.01, max_e=0.1, wheel_deg=40.0, jerk=0.4, rms_x_data_sheet=0.3)
BESIDE = dict(best="mpc", rms_x_oracle=0.9, wheel_x_oracle=1.0, jerk_x_oracle=1.1, best_on_data_sheet="stanley")
GOOD = FleetOutcome(**CAR, **LEARNT, **DROVE, **BESIDE)


def test_medians_and_worst_cases_count_a_car_that_never_got_there_as_infinite() -> None:
    slow = replace(GOOD, good=30.0, rms_x_oracle=1.2, failures=3)
    lost = replace(GOOD, good=None, held=False, rms_x_oracle=math.inf)
    two = summarise([GOOD, slow])
    assert (two["good_share"], two["good_median_s"], two["good_worst_s"]) == (1.0, 20.0, 30.0)
    assert (two["rms_x_oracle"], two["worst_rms_x_oracle"]) == pytest.approx((1.05, 1.2))
    three = summarise([GOOD, slow, lost])
    assert (three["good_share"], three["held_share"]) == pytest.approx((2 / 3, 2 / 3))
    assert (three["good_worst_s"], three["worst_rms_x_oracle"]) == (None, None)
    assert (three["rms_x_oracle"], three["failures_worst"]) == (1.2, 3)
    far = summarise([GOOD, replace(GOOD, departure=7.0)])
    assert (far["departure_median_m"], far["departure_worst_m"]) == (4.5, 7.0)


def test_a_car_that_hardly_learned_is_told_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "ORACLE", ("stanley-delay",))
    monkeypatch.setattr(fleet, "TOLD_DATA_SHEET", ("stanley",))
    (*_, car) = of_fleet(4, rounds=0.1)
    outcome = one_car((car, 0, setting("model-free"), 0.05))
    assert (outcome.name, outcome.best, outcome.best_on_data_sheet) == ("fleet-3", "stanley-delay", "stanley")
    assert outcome.delay == fleet.fleet_scenario(3).steering.delay
    assert outcome.good is None
    assert outcome.departure > 0.5  # it has failed, and nobody hides by how much
    assert not outcome.held


def test_every_kind_of_car_starts_where_it_is_straight_and_can_be_told_the_truth() -> None:
    for kind in KINDS:
        cars = of_kind(kind, course={"rounds": 0.5})
        assert len({car.name for car in cars}) == len(cars)
        for car in cars:
            assert car.course.rounds == 0.5
            assert abs(car.path().kappa(car.course.start)) < 0.01
            assert car.with_(knowledge={"oracle": True}).design_model().gain == car.steering.gain
    assert [car.steering.delay for car in of_kind("delays")] == list(fleet.DELAYS)
