"""Dead reckoning against the pose: closed forms of what is noticed and when; a sound car passes."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.car.motion import HORIZON, READ_LATE, MotionCheck, MotionLimits
from steerkit.diagram.units import radians_of

LENGTH, RATIO, DT = 2.71, 15.6, 0.01
LIMITS = MotionLimits()


def drive(
    seconds: float,
    *,
    v: float = 5.0,
    kappa: float = 0.0,
    drift: tuple[float, float] = (0.0, 0.0),
    psi_rate: float = 0.0,
    r_gain: float = 1.0,
    wheel_off: float = 0.0,
    late: float = 0.0,
    beta: float = 0.0,
    since: float = 0.0,
    understeer: float = 0.0,
) -> tuple[float, str]:
    """(when it was noticed [s], what was said) of a car on a circle; its pose drifts (along, across) after `since`."""
    motion = MotionCheck(LIMITS, wheelbase=LENGTH, steer_ratio=RATIO, understeer=understeer)
    psi, x, y = 0.3, 1.0, 2.0
    for k in range(round(seconds / DT)):
        t = k * DT + (late if k % 37 == 36 else 0.0)
        r = v * kappa
        delta_sw = RATIO * math.atan(LENGTH * kappa) + wheel_off
        seen = psi + psi_rate * k * DT
        motion.moves(t, psi=math.remainder(seen, math.tau), v=v, r=r_gain * r, beta=beta, delta_sw=delta_sw)
        what = motion.pose(t, x, y)
        if what:
            return k * DT, what
        middle = psi + beta + 0.5 * r * DT
        along, across = drift if k * DT >= since else (0.0, 0.0)
        x += DT * ((v + along) * math.cos(middle) - across * math.sin(middle))
        y += DT * ((v + along) * math.sin(middle) + across * math.cos(middle))
        psi += r * DT
    return math.inf, ""


@given(v=st.floats(-1.0, 12.0), kappa=st.floats(-0.08, 0.08))
def test_a_sound_car_is_not_accused(v: float, kappa: float) -> None:
    assert drive(6.0, v=v, kappa=kappa) == (math.inf, "")


@pytest.mark.parametrize("kappa", [0.0, 0.04])
@pytest.mark.parametrize("rate", [0.2, -0.5, 1.0, -2.0])
def test_a_drift_across_is_noticed_when_it_exceeds_what_a_heading_may_be_off(rate: float, kappa: float) -> None:
    """|rate| T = pose_jump + motion_across v T; a sample is kept every 50 ms, so up to that much later."""
    v = 5.0
    expected = LIMITS.pose_jump / (abs(rate) - LIMITS.motion_across * v)
    when, what = drive(6.0, v=v, kappa=kappa, drift=(0.0, rate))
    assert expected <= when <= expected + 0.1
    assert "across the heading" in what


@pytest.mark.parametrize("rate", [1.0, -1.0, -5.0])
def test_a_drift_along_is_noticed_when_it_exceeds_what_the_speed_may_be_off(rate: float) -> None:
    v = 5.0
    expected = (LIMITS.pose_jump + READ_LATE * v) / (abs(rate) - LIMITS.motion_along * v)
    when, what = drive(6.0, v=v, drift=(rate, 0.0))
    assert expected <= when <= expected + 0.1
    assert "along from where" in what


def test_a_drift_within_the_heading_s_error_goes_unseen_and_moves_the_car_as_slowly_as_promised() -> None:
    slowest = LIMITS.motion_across * 5.0 + LIMITS.pose_jump / HORIZON
    assert drive(20.0, drift=(0.0, 0.95 * slowest))[0] == math.inf
    assert drive(20.0, drift=(0.0, 1.1 * slowest))[0] < math.inf


@pytest.mark.parametrize(
    ("turning", "apart"),
    [
        *[({"v": 0.0, "psi_rate": radians_of(rate)}, radians_of(abs(rate))) for rate in (2.0, -10.0, 60.0)],
        *[({"kappa": 0.05, "r_gain": a}, 0.25 * (abs(1.0 - a) - 0.05 * abs(a))) for a in (-1.0, 0.0, 0.5, 1.6)],
    ],
)
def test_a_heading_that_leaves_the_yaw_rate_is_noticed(turning: Any, apart: float) -> None:
    """By so much a second they come apart, less what the turning excuses."""
    expected = LIMITS.heading_slack / (apart - LIMITS.heading_rate)
    when, what = drive(6.0, **turning)
    assert expected <= when <= expected + 0.1
    assert "the heading is" in what


@pytest.mark.parametrize(("off", "understeer"), [(100.0, 0.0), (-60.0, 0.0), (60.0, 0.02)])
def test_a_wheel_that_the_car_does_not_obey_is_noticed(off: float, understeer: float) -> None:
    rate = 5.0 * math.tan(radians_of(abs(off)) / RATIO) / (LENGTH + understeer * 25.0)
    expected = LIMITS.wheel_slack / ((1.0 - LIMITS.wheel_share) * rate - LIMITS.wheel_rate)
    when, what = drive(6.0, wheel_off=radians_of(off), understeer=understeer)
    assert expected <= when <= expected + 0.1
    assert "than its wheel says" in what
    assert drive(6.0, v=2.0, wheel_off=radians_of(20.0))[0] == math.inf  # an offset that a kit may have


def test_after_a_pause_however_short_it_begins_anew() -> None:
    motion = MotionCheck(LIMITS, wheelbase=LENGTH, steer_ratio=RATIO)
    motion.moves(0.0, psi=0.0, v=5.0, r=0.0, beta=0.0, delta_sw=0.0)
    assert motion.pose(0.0, 0.0, 0.0) == ""
    motion.forget()
    motion.moves(1.0, psi=1.0, v=5.0, r=0.0, beta=0.0, delta_sw=0.0)
    assert motion.pose(1.0, 70.0, 3.0) == ""


@pytest.mark.parametrize("more", [{"late": 0.05}, {"beta": 0.03}, {"beta": -0.03}])
@pytest.mark.parametrize("kappa", [0.0, 0.05, -0.05])
def test_nor_is_one_whose_frames_are_read_late_now_and_then_or_that_slides(kappa: float, more: Any) -> None:
    assert drive(6.0, v=7.0 if "late" in more else 5.0, kappa=kappa, **more) == (math.inf, "")


def test_a_drift_is_noticed_as_soon_whenever_it_begins() -> None:
    """Windows overlap and never start anew, not even when the oldest sample is dropped."""
    took = [drive(9.0, drift=(0.0, 0.2), since=since)[0] - since for since in (0.0, 1.0, 3.0, 3.5, 4.5)]
    assert max(took) <= min(took) + 0.1


def test_a_position_may_come_a_tenth_of_a_second_before_the_speed_of_its_moment() -> None:
    motion, v = MotionCheck(LIMITS, wheelbase=LENGTH, steer_ratio=RATIO), 12.0
    for k in range(100):
        motion.moves(k * DT, psi=0.0, v=v, r=0.0, beta=0.0, delta_sw=0.0)
        assert motion.pose(k * DT, v * k * DT, 0.0) == ""
    assert motion.pose(1.09, v * 1.09, 0.0) == ""
