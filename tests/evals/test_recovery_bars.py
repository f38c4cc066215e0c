"""What recovery is counted on for: a round of the course under delay, and a car whose delay nobody knows."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies.foreign import Job, one_drive
from steerkit import compile, course, simulate
from steerkit.controllers.delay import delayed_stanley
from steerkit.learning.learner_state import untrained
from steerkit.learning.settings import DEFAULT
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.plants.speed_driver import CurveSpeedDriver, SpeedDriver
from steerkit.scenario import Scenario
from steerkit.scenario.drive import assembled
from tests.support.straight_road import PASSAT, looped


@pytest.mark.parametrize("delay", [0.0, 0.2])
def test_a_round_of_the_course_stays_within_a_tenth_of_a_metre(delay: float) -> None:
    """Nonlinear car, 0.1 s lag; the driver would drive 9 m/s. Tyres and ratio off: still within 0.3 m."""
    path = course("paper")
    car = NonlinearSingleTrack(vehicle=PASSAT, v0=5.0)
    driver = CurveSpeedDriver(path=path, driver=SpeedDriver(v_min=9.0, v_max=9.0))
    loop = looped(delayed_stanley(PASSAT, delay=delay, lag=0.1), path, 5.0, delay, car=car, driver=driver)
    stiffness, ratio = PASSAT.c_f * np.array([1.0, 0.7]), PASSAT.steer_ratio * np.array([1.0, 1.1])
    cars = {"car.vehicle.c_f": stiffness, "car.vehicle.steer_ratio": ratio}
    log = compile(loop, record=["path.e", "path.progress"], every=5, parameters=list(cars)).run(130.0, parameters=cars)
    assert log["path.progress"][-1].min() > path.length
    assert (np.abs(log["path.e"]).max(axis=0) < [0.1, 0.3]).all()


@pytest.mark.parametrize(
    ("recovery", "low", "high"), [("adaptive", 0.0, 0.15), ("auto", 0.0, 0.15), ("stanley", 1.0, math.inf)]
)
def test_only_the_adaptive_one_recovers_a_car_of_unknown_delay(recovery: str, low: float, high: float) -> None:
    """The largest |e| from 10 s on while nothing is learned."""
    place = Scenario.under("hard", steering={"delay": 0.35, "lag": 0.28}, knowledge={"delay": 0.0}, recovery=recovery)
    never = replace(untrained(DEFAULT, 0), ready_from=math.inf)
    loop = assembled(place, never, doe=DEFAULT.element(place.nominal), recovery=place.recovery_controller())
    e = simulate(loop, 15.0, every=round(0.05 / loop.dt), allow_nonfinite=True)["path.e"]
    assert low < np.abs(e[200:]).max() < high


def test_where_the_gain_grows_with_what_is_asked_no_bend_leaves_half_a_metre() -> None:
    """A car steered by torque that no one here wrote, at 16 m/s, told nothing of its dead time: of 240 drives the worst
    but one with a ratio alone, 0.65 m."""
    drive = one_drive(Job("torque", 16.0, "none", "auto", seed=11, seconds=40.0, conditions="clean"))
    assert drive["stays"]
    assert drive["max_e"] < 0.45
    assert drive["swing"] == 0.0
