"""Pure pursuit: its circle, its baseline behaviour, and the ends of a path."""

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.controllers.pure_pursuit import PurePursuit
from steerkit.paths.courses import circle, straight
from steerkit.paths.path import Path
from tests.support.straight_road import PASSAT

ROAD = straight(50.0)


def steered(pursuit: PurePursuit, **u: float) -> float:
    return float(pursuit.output(0.0, (), pursuit.D(**u)).delta_sw)


@settings(max_examples=25)
@given(v=st.floats(0.0, 9.0), radius=st.floats(12.0, 60.0))
def test_on_a_circle_it_steers_that_circle(v: float, radius: float) -> None:
    """The rear axle on a circle and tangent to it: the arc through any of its points is the circle."""
    pursuit = PurePursuit.of(PASSAT, circle(radius))
    at = {"s": 0.0, "x": PASSAT.l_r, "y": 0.0, "psi": 0.0, "v": v}
    assert steered(pursuit, **at) == pytest.approx(PASSAT.steer_ratio * math.atan(PASSAT.wheelbase / radius), rel=2e-4)


SLANTING = Path.from_waypoints(25.0 * np.outer(range(3), (0.8, 0.6)), closed=False)


@given(over=st.floats(0.0, 30.0))
def test_beyond_the_end_of_an_open_path_it_goes_straight_on(over: float) -> None:
    pursuit = PurePursuit.of(PASSAT, ROAD)
    assert steered(pursuit, s=50.0, x=50.0 + over, y=0.0, psi=0.0, v=5.0) == pytest.approx(0.0, abs=1e-9)
    aside = steered(pursuit, s=50.0, x=50.0 + PASSAT.l_r + over, y=0.2, psi=0.0, v=9.0)
    assert aside == pytest.approx(steered(pursuit, s=20.0, x=20.0 + PASSAT.l_r, y=0.2, psi=0.0, v=9.0))
    ahead = 50.0 + PASSAT.l_r + over
    there = {"x": 0.8 * ahead - 0.6 * 0.2, "y": 0.6 * ahead + 0.8 * 0.2, "psi": math.atan2(0.6, 0.8)}
    assert steered(PurePursuit.of(PASSAT, SLANTING), s=50.0, v=9.0, **there) == pytest.approx(aside)


def test_parameters_are_within_their_ranges() -> None:
    for make, wrong in (
        (partial(PurePursuit, vehicle=PASSAT, path=ROAD), {"look_max": 2.4}),
        (partial(PurePursuit.of, PASSAT, ROAD), {"delay": 2.1}),
    ):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            make(**wrong)


@pytest.mark.parametrize(("v", "look"), [(-3.0, 2.5), (0.0, 2.5), (8.0, 4.0), (30.0, 15.0), (100.0, 20.0)])
def test_beside_a_straight_it_is_the_circle_through_the_goal(v: float, look: float) -> None:
    """e = 0.5 m to the left, along the path: 1/R = 2 e/d^2, d the distance from the rear axle to the goal."""
    e, block = 0.5, PurePursuit.of(PASSAT, straight(200.0))
    u = block.D(s=50.0, x=50.0 + PASSAT.l_r, y=e, psi=0.0, v=v)
    delta = block.output(0.0, (), u).delta_sw / PASSAT.steer_ratio
    assert math.tan(delta) / PASSAT.wheelbase == pytest.approx(-2.0 * e / (look**2 + e**2), rel=1e-6)


def test_a_goal_under_the_rear_axle_is_regular_and_a_delay_moves_the_goal_away() -> None:
    block = PurePursuit.of(PASSAT, straight(200.0))
    goal = dict(s=50.0, x=52.5 + PASSAT.l_r, y=-0.001, psi=0.0, v=0.0)
    assert steered(block, **goal) == pytest.approx(
        PASSAT.steer_ratio * math.atan2(2.0 * PASSAT.wheelbase * 0.001, 0.01)
    )
    late = PurePursuit.of(PASSAT, ROAD, delay=0.1)
    assert (late.look_time, late.look_min) == pytest.approx((0.7, 3.3))
    plain = PurePursuit(vehicle=PASSAT, path=ROAD)
    assert (plain.look_time, plain.look_min, plain.reference) == (block.look_time, block.look_min, -PASSAT.l_r)
