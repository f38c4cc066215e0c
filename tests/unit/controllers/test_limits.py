"""How far and how fast a command may turn the wheel."""

import math
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.controllers.limits import approach_angle, limited

CAR: dict[str, Any] = dict(
    wheelbase=2.71, l_r=1.49, understeer=0.002, steer_ratio=15.6, rate_limit=9.6, slew=None, limit=9.07, dt=0.05
)


def within(command: float, before: float, v: float, a_y: float, needed: float = 0.0, **changes: float) -> float:
    law = SimpleNamespace(**CAR | dict(a_y_max=a_y, a_y_reserve=0.5, a_y_limit=None) | changes)
    return limited(law, command, before, v, needed)


@given(e=st.floats(-3.0, 3.0), v=st.floats(3.0, 12.0), a_y=st.floats(0.5, 3.0))
def test_an_arc_of_the_approach_angle_meets_the_path(e: float, v: float, a_y: float) -> None:
    """e = R (1 - cos(angle)), R = v^2/a_y; a centimetre more, and the angle taken for small."""
    radius = v * v / a_y
    exact = 2.0 * math.asin(min(1.0, math.sqrt(0.5 * (abs(e) + 0.01) / radius)))
    assert approach_angle(e, v, a_y) <= exact * (1.0 + 1e-12)
    assert approach_angle(e, v, a_y) == pytest.approx(exact, rel=0.05 + 0.15 * (abs(e) + 0.01) / radius)


@given(e=st.floats(-3.0, 3.0), v=st.floats(3.0, 30.0), slew=st.floats(0.3, 5.0))
def test_a_turn_of_that_slew_from_the_approach_angle_meets_the_path(e: float, v: float, slew: float) -> None:
    """The lateral acceleration grows for half of the time and falls for the other; a centimetre more."""
    across = v * approach_angle(e, v, 1e6, slew)
    half = math.sqrt(across / slew)
    nearer = 2.0 * across * half - slew * half**3 * (1.0 / 6.0 + 0.5 + 0.5 - 1.0 / 6.0)
    assert nearer == pytest.approx(abs(e) + 0.01)
    assert approach_angle(e, v, 1.0, slew) == min(approach_angle(e, v, 1.0), approach_angle(e, v, 1e6, slew))


angles, speeds = st.floats(-9.0, 9.0), st.floats(0.0, 15.0)


@given(command=st.floats(-1e3, 1e3), before=angles, v=speeds, a_y=st.floats(0.5, 5.0))
def test_left_and_right_have_the_same_limits(command: float, before: float, v: float, a_y: float) -> None:
    assert within(-command, -before, v, a_y) == pytest.approx(-within(command, before, v, a_y))


@given(command=st.floats(-1e3, 1e3), before=angles, v=speeds, a_y=st.floats(0.5, 5.0))
def test_stop_and_wheel_speed_are_kept(command: float, before: float, v: float, a_y: float) -> None:
    out = within(command, before, v, a_y)
    assert abs(out) <= CAR["limit"]
    # back from beyond the bound at once, for a car that has become faster; else no faster than the motor
    assert abs(out - before) <= CAR["rate_limit"] * CAR["dt"] + 1e-9 or abs(out) < abs(before)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("v", [2.0, 5.0, 9.0])
@pytest.mark.parametrize("a_y", [1.0, 2.9])
def test_a_command_held_ends_in_the_steady_curve_and_never_feels_more(v: float, a_y: float, side: float) -> None:
    """delta = atan(L a_y/v^2) + K a_y; on the way the rolling car feels (v^2 tan(delta) + v l_r delta')/L."""
    wheel, felt = 0.0, []
    for _ in range(400):
        before, wheel = wheel, within(99.0 * side, wheel, v, a_y)
        delta, rate = wheel / CAR["steer_ratio"], (wheel - before) / CAR["steer_ratio"] / CAR["dt"]
        rolling = delta - CAR["understeer"] * a_y * side
        felt.append(abs(v * v * math.tan(rolling) + v * CAR["l_r"] * rate) / CAR["wheelbase"])
    steady = CAR["steer_ratio"] * (math.atan(CAR["wheelbase"] * a_y / v**2) + CAR["understeer"] * a_y)
    assert wheel * side == pytest.approx(min(steady, CAR["limit"]), rel=1e-6)
    assert max(felt) < 1.15 * a_y


def test_a_nan_stays_and_one_before_limits_nothing() -> None:
    assert math.isnan(within(math.nan, 0.0, 5.0, 2.0))
    assert within(0.1, math.nan, 5.0, 2.0) == 0.1


@pytest.mark.parametrize(
    ("needed", "most", "a_y"), [(0.0, None, 2.0), (1.4, None, 2.0), (2.5, None, 3.0), (2.5, 2.2, 2.2), (0.0, 1.5, 1.5)]
)
def test_a_path_that_needs_more_is_followed_with_a_reserve_up_to_what_the_car_can(needed, most, a_y) -> None:
    wheel, v = 0.0, 9.0
    for _ in range(400):
        wheel = within(99.0, wheel, v, 2.0, needed, a_y_limit=most)
    steady = CAR["steer_ratio"] * (math.atan(CAR["wheelbase"] * a_y / v**2) + CAR["understeer"] * a_y)
    assert wheel == pytest.approx(steady, rel=1e-6)
