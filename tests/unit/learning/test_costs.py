"""Costs by hand, symmetric and within one."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.learning.costs import COSTS, BandCost, Cost, IdoeCost, SmoothCost, TanhCost
from tests.support.records import ACTIONS, states


@pytest.mark.parametrize(
    ("cost", "e", "action", "costs"),
    [
        (BandCost(), [0.0, 0.049, -0.051, 0.4, -0.6], 1.0, [0.0, 0.0, 0.01, 0.01, 1.0]),
        (IdoeCost(), [0.01, -0.01, 0.0], [0.0, -0.0, 0.1], [0.0, 0.0, 0.01]),  # free with the wheel left alone
        (TanhCost(), [0.0, 0.05, -0.05, 0.4, 0.51], 0.0, [0.0, 0.95 * 0.04, 0.95 * 0.04, 0.04, 1.0]),
        (TanhCost(), [0.0, 0.4, 0.51], 0.1, [0.01, 0.05, 1.0]),
        (TanhCost(action_unit=0.2), [0.0] * 4, [0.1, -0.1, 0.2, 0.3], [0.005, 0.005, 0.01, 0.01]),
    ],
)
def test_costs_by_hand(cost: Cost, e: list[float], action: Any, costs: list[float]) -> None:
    c, terminal = cost(states([0.0] * len(e)), np.broadcast_to(action, len(e)), states(e))
    assert c == pytest.approx(costs, abs=1e-12)
    assert terminal.tolist() == [abs(one) > 0.5 for one in e]


def test_a_well_is_as_wide_as_the_driving_is_good() -> None:
    cost = TanhCost(goal=0.15, goal_least=0.05)
    for e, goal in ((0.001, 0.05), (0.004, 0.1), (0.02, 0.15)):
        assert cost.suited(np.array([e, -e, 3.0 * e, 0.0, e])).goal == pytest.approx(goal)
    assert [cost.suited(np.zeros(3), fast).goal for fast in (1.0, 2.0, 4.0)] == [0.05, 0.1, 0.15]
    assert TanhCost(goal=0.15).suited(np.zeros(3)).goal == 0.15
    assert cost.suited(np.zeros(0)) == cost
    with pytest.raises(ValueError, match="goal_least <= goal"):
        TanhCost(goal=0.1, goal_least=0.2)


def test_noise_makes_a_fast_car_dearer_to_steer_until_steering_costs_as_much_as_failing() -> None:
    cost = TanhCost(action_cost=0.02)
    costs = [cost.suited(np.zeros(3), fast) for fast in (1.0, 2.0, 3.0, 100.0)] + [cost.suited(np.zeros(3), 2.0, 3.0)]
    assert [cost.action_cost for cost in costs] == pytest.approx([0.02, 0.04, 0.06, 0.96, 0.12])
    torque = [TanhCost(action_cost=0.02, dear_from=2.0).suited(np.zeros(3), fast) for fast in (1.5, 3.0, 100.0)]
    assert [cost.action_cost for cost in torque] == pytest.approx([0.02, 0.045, 0.96])
    assert all(cost.suited(np.zeros(0)) == cost for cost in costs)


def test_smooth_cost_by_hand() -> None:
    """5 m/s: 0.05 rad/s more yaw rate in 0.05 s is a jerk of 5 m/s^3."""
    cost = SmoothCost(cost=TanhCost(action_cost=0.0), jerk_cost=0.01, jerk_unit=10.0, wheel_cost=0.02, wheel_unit=0.4)
    s, s_next = states([0.0] * 4), states([0.0, 0.0, 0.0, 0.6])
    s_next[0, 4] = 0.05
    s_next[1, 5] = -0.2
    s_next[2, 4:] = 10.0
    c, terminal = cost(s, np.zeros(4), s_next)
    assert c == pytest.approx([0.01 / 4, 0.02 / 4, 0.01 + 0.02, 1.0])
    assert terminal.tolist() == [False, False, False, True]


@given(e=st.floats(-2.0, 2.0), a=st.sampled_from(ACTIONS), cost=st.sampled_from(COSTS))
def test_costs_are_symmetric_and_within_one(e: float, a: float, cost: type) -> None:
    c, terminal = cost()(states([0.0, 0.0]), np.array([a, -a]), states([e, -e]))
    assert c[0] == c[1]
    assert 0.0 <= c[0] <= 1.0
    assert terminal[0] == (abs(e) > 0.5)


def test_costs_say_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="expected 0 < goal < trip"):
        BandCost(goal=0.6)
    with pytest.raises(ValueError, match="action_cost"):
        TanhCost(action_cost=1.0)
