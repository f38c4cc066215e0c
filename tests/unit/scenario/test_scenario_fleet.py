"""Scenarios drawn by seed."""

import numpy as np
import pytest

from steerkit.paths.courses import random_course
from steerkit.scenario import LAG, OFFSET_DEG, PLAY_DEG, Scenario, fleet_scenario, straightest
from steerkit.vehicles import drawn_car, fleet

MANY = 250


def test_a_drawn_scenario_has_the_cars_own_delay_and_an_unseen_course() -> None:
    for number in (0, 1, 17, 39):
        scenario, car = fleet_scenario(number), drawn_car(number)
        assert scenario.nominal == car.vehicle
        assert scenario.steering.delay == pytest.approx(car.steer_delay)
        assert scenario.sensors == Scenario.under("hard").sensors
        assert scenario.course.name == f"random-{1000 + number}"
        assert (scenario.path().samples.kappa == random_course(1000 + number).samples.kappa).all()
        assert scenario.course.start == straightest(scenario.path())
        assert scenario == fleet_scenario(number)


def test_the_straightest_stretch_bends_least_in_its_worst_place() -> None:
    path = random_course(1003)
    worst = [abs(path.kappa(s + np.arange(20.0))).max() for s in range(round(path.length))]
    assert abs(path.kappa(straightest(path) + np.arange(20.0))).max() == pytest.approx(min(worst), rel=0.02)
    assert min(worst) < 0.7 * np.median(worst)


def test_what_is_drawn_is_uniform_and_independent() -> None:
    drawn = [fleet_scenario(number, course={"start": 0.0}) for number in range(MANY)]  # courses take long to make
    rows = np.array(
        [[scenario.steering.lag, scenario.steering.offset_deg, scenario.steering.play_deg] for scenario in drawn]
    )
    for column, (least, largest) in zip(rows.T, (LAG, (-OFFSET_DEG, OFFSET_DEG), (0.0, PLAY_DEG))):
        span = largest - least
        assert (column >= least).all()
        assert (column <= largest).all()
        assert column.mean() == pytest.approx(0.5 * (least + largest), abs=4.0 * span / np.sqrt(12.0 * MANY))
        assert column.std() == pytest.approx(span / np.sqrt(12.0), rel=0.1)
    order = {name: k for k, name in enumerate(fleet())}
    places = np.array([order[scenario.vehicle.name] for scenario in drawn])
    assert (abs(np.corrcoef(np.column_stack((rows, places)).T)[np.triu_indices(4, 1)]) < 4.0 / np.sqrt(MANY)).all()


def test_a_field_that_is_given_is_not_drawn() -> None:
    assert fleet_scenario(3, course={"start": 12.0}) == fleet_scenario(3).with_(course={"start": 12.0})
    changed = fleet_scenario(3, steering={"lag": 0.2})
    assert changed == fleet_scenario(3).with_(steering={"lag": 0.2})
