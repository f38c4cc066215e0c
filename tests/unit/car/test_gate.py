"""The gate: whatever comes in, what goes out is finite, in range, and no faster than allowed."""

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from steerkit.car.gate import GateLimits, gate, pessimistic

LIMITS = GateLimits()
any_float = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
odd = st.sampled_from([0.0, -0.0, math.nan, math.inf, -math.inf, 5e-324, -5e-324, 1.7e308, -1.7e308, 9.07, 9.08])
anything = any_float | odd
angle = st.floats(-LIMITS.delta_sw_max, LIMITS.delta_sw_max)
speed = st.floats(0.0, 15.0)
pause = st.floats(LIMITS.dt_min, 1.0)
TINY = 1e-5 * LIMITS.quantum


def kappa(delta_sw: float) -> float:
    return math.tan(delta_sw / LIMITS.steer_ratio) / LIMITS.wheelbase


@settings(max_examples=600)
@given(request=anything, last=anything, speeds=st.lists(anything, max_size=3), dt=anything)
@example(request=math.nan, last=0.0, speeds=[5.0], dt=0.02)
@example(request=1e308, last=9.07571, speeds=[], dt=math.inf)
@example(request=-math.inf, last=0.0, speeds=[math.nan], dt=0.02)
@example(request=9.0, last=9.0, speeds=[1e200], dt=0.02)
def test_no_input_gets_a_bad_command_out(request: float, last: float, speeds: list[float], dt: float) -> None:
    verdict = gate(LIMITS, request, last, speeds, dt)
    if not verdict.send:
        assert verdict.why
        assert verdict.delta_sw == 0.0
        return
    assert math.isfinite(request)
    assert math.isfinite(verdict.delta_sw)
    assert abs(verdict.delta_sw) <= LIMITS.delta_sw_max
    assert abs(verdict.delta_sw - last) <= LIMITS.rate_max * LIMITS.dt_max + 1.5 * LIMITS.quantum
    counts = verdict.delta_sw / LIMITS.quantum
    assert counts == pytest.approx(round(counts), abs=1e-9)


@settings(max_examples=400)
@given(request=st.floats(-20, 20), last=angle, v=speed, dt=pause)
def test_rate_curvature_and_its_change_are_bounded(request: float, last: float, v: float, dt: float) -> None:
    last = round(last / LIMITS.quantum) * LIMITS.quantum
    if abs(last) > LIMITS.delta_sw_max:
        return
    out = gate(LIMITS, request, last, [v], dt).delta_sw
    v, dt = max(v, 1.0), min(dt, LIMITS.dt_max)
    bound = LIMITS.a_y_max / v**2
    slope = kappa(abs(out) + TINY) - kappa(abs(out))
    assert abs(out - last) <= LIMITS.rate_max * dt + TINY
    assert abs(kappa(out) - kappa(last)) <= LIMITS.jerk_max / v**2 * dt + slope
    assert abs(kappa(out)) <= max(bound, abs(kappa(last))) + slope
    if abs(kappa(last)) > bound + slope:  # the speed has jumped: towards the bound
        assert abs(out) <= abs(last)


@settings(max_examples=200)
@given(goal=st.floats(-9, 9), start=angle, v=st.floats(0.0, 10.0))
def test_a_steady_request_is_reached_up_to_the_curvature_bound(goal: float, start: float, v: float) -> None:
    last = round(start / LIMITS.quantum) * LIMITS.quantum * 0.999
    for _ in range(4000):
        before, last = last, gate(LIMITS, goal, last, [v], 0.02).delta_sw
        if last == before:
            break
    bound = LIMITS.steer_ratio * math.atan(LIMITS.wheelbase * LIMITS.a_y_max / max(v, 1.0) ** 2)
    wanted = max(-bound, min(bound, goal))
    assert abs(last - wanted) <= LIMITS.quantum * (1.0 + 1e-3)


@given(speeds=st.lists(anything, max_size=4))
def test_the_speed_is_taken_pessimistically(speeds: list[float]) -> None:
    v = pessimistic(LIMITS, speeds)
    assert v >= LIMITS.v_floor
    assert all(v >= abs(s) for s in speeds if math.isfinite(s))
    if not speeds or not all(map(math.isfinite, speeds)):
        assert v >= LIMITS.v_max


WIDE = GateLimits(v_floor=0.1, rate_max=100.0, a_y_max=100.0, jerk_max=1e4)
"""Limits of which only that of the angle acts in a standing car."""
MOST = LIMITS.delta_sw_max
BOUND = LIMITS.steer_ratio * math.atan(LIMITS.wheelbase * LIMITS.a_y_max / 64.0)
"""What a_y allows at 8 m/s."""


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("limits", "request_", "last", "v", "dt", "why"),
    [
        (LIMITS, 0.1, 0.1, 4.0, 0.02, ""),
        (LIMITS, 3.0, 0.0, 4.0, 0.02, "rate limit"),
        (LIMITS, BOUND, BOUND, 8.0, 0.02, ""),
        (LIMITS, BOUND + 1e-6, BOUND, 8.0, 0.02, "a_y limit"),
        (WIDE, MOST, MOST, 0.5, 0.02, ""),
        (WIDE, MOST + 1e-6, MOST, 0.5, 0.02, "delta_sw limit"),
        (LIMITS, MOST, 0.0, 8.0, 0.02, "a_y limit, rate limit"),
        (LIMITS, MOST + 1e-6, 0.0, 8.0, 0.02, "delta_sw limit, rate limit"),
        (LIMITS, 0.0, 0.0, 4.0, LIMITS.dt_min, ""),
        (LIMITS, 0.0, 0.0, 4.0, 0.0099, "too soon after the last frame"),
        (LIMITS, math.nan, 0.0, 4.0, 0.02, "request is no finite number"),
        (LIMITS, 0.0, math.nan, 4.0, 0.02, "last command is out of range"),
        (WIDE, MOST, MOST + LIMITS.quantum, 0.5, 0.02, ""),
        (WIDE, MOST, MOST + 1.01 * LIMITS.quantum, 0.5, 0.02, "last command is out of range"),
    ],
)
def test_each_limit_is_named(
    limits: GateLimits, request_: float, last: float, v: float, dt: float, why: str, side: float
) -> None:
    verdict = gate(limits, side * request_, side * last, [v], dt)
    assert verdict.why == why
    assert verdict.send is ("limit" in why or not why)


def test_a_pause_earns_no_jump() -> None:
    steps = [abs(gate(LIMITS, 9.0, 0.0, [1.0], dt).delta_sw) for dt in (0.02, 0.06, 0.5, 100.0)]
    assert steps == sorted(steps)
    assert steps[1:] == [pytest.approx(steps[1])] * 3


@given(goal=st.floats(-9, 9), start=st.floats(-2.0, 2.0), v=st.floats(1.0, 10.0))
def test_the_centre_of_gravity_is_not_swung_beyond_the_limit(goal: float, start: float, v: float) -> None:
    """a_y = v^2 kappa + v arm dkappa/dt of a kinematic car; one quantum is always let through."""
    bound = LIMITS.steer_ratio * math.atan(LIMITS.wheelbase * LIMITS.a_y_max / v**2)
    last = max(-bound, min(bound, round(start / LIMITS.quantum) * LIMITS.quantum))
    slack = 2.0 * v * LIMITS.arm * LIMITS.quantum * (1.0 + 0.4) / (0.02 * LIMITS.steer_ratio * LIMITS.wheelbase)
    for _ in range(100):
        before, last = last, gate(LIMITS, goal, last, [v], 0.02).delta_sw
        growth = (kappa(last) - kappa(before)) / 0.02
        if abs(kappa(last)) > abs(kappa(before)) and kappa(last) * growth > 0.0:
            assert abs(v * v * kappa(last) + v * LIMITS.arm * growth) <= LIMITS.a_y_max + slack


@pytest.mark.parametrize("v", [1.0, 4.0, 9.0])
def test_a_first_step_is_the_largest_that_the_centre_of_gravity_bears(v: float) -> None:
    """Where neither rate nor jerk acts: v^2 kappa + v arm kappa/dt is within a_y_max, and beyond one quantum later."""
    limits = GateLimits(rate_max=100.0, jerk_max=1e4)
    out = gate(limits, 9.0, 0.0, [v], 0.02).delta_sw
    felt = [(v * v + v * limits.arm / 0.02) * kappa(wheel) for wheel in (out - TINY, out + limits.quantum + TINY)]
    assert felt[0] <= limits.a_y_max < felt[1]


def test_limits_go_together() -> None:
    with pytest.raises(ValueError, match=r"expected delta_sw_max/steer_ratio < 1\.4 rad"):
        GateLimits(delta_sw_max=22.0, steer_ratio=15.6)
