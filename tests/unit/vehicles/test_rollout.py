"""The roll-out: closed forms; and the real gate, frame by frame, never turns the wheel further than its model says."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.car.gate import gate
from steerkit.diagram.units import radians_of
from steerkit.vehicles.rollout import GateLimits, GateModel, Rollout, beside, lag_share, on_their_way, slewed

DT = 0.05


def gated(command: float, before: float, speeds: tuple[float, float], frames: tuple[float, ...]) -> float:
    """What the real gate has sent after frames so long."""
    for dt in frames:
        before = gate(GateLimits(), command, before, speeds, dt).delta_sw
    return before


def between(command: float, before: float, v: float, v_kit: float, first: float) -> list[float]:
    """The model's rightmost after five samples, the gate's, and the model's leftmost; the first frame is due so long
    after the last one [s]. The gate that goes to the side at which the model is slow may have its last frame late."""
    model, right, left = GateModel(), before, before
    for k in range(5):
        early = model.frame_dt if k == 0 else 0.0
        left = model.pushed(command, left, v, DT, early)
        right = -model.pushed(-command, -right, v, DT, early)
    frames = (first, *[0.02] * int((5 * DT - first) / 0.02 + 1e-9))
    soon, late = (gated(command, before, (v, v_kit), (*frames, *more)) for more in ((), (0.02, 0.02)))
    return [right, min(soon, late), soon, max(soon, late), left]


angle = st.floats(-9.0, 9.0)


@given(command=angle, before=angle, v=st.floats(0.5, 9.0), ahead=st.floats(-0.2, 0.2), first=st.floats(0.01, 0.03))
def test_the_gate_lies_between_the_two(command: float, before: float, v: float, ahead: float, first: float) -> None:
    before = round(before / radians_of(0.1)) * radians_of(0.1)
    right, low, soon, high, left = between(command, before, v, v + ahead, first)
    assert left + radians_of(0.11) >= (soon if soon > before else low)
    assert right - radians_of(0.11) <= (soon if soon < before else high)


def test_the_two_are_not_far_apart() -> None:
    """At 6 m/s 5 m/s^3 turn the wheel by 1 rad in the five samples; the model's doubt is a fraction of that."""
    right, _, real, _, left = between(9.0, 0.0, 6.0, 6.0, 0.02)
    assert 0.5 < real < 1.5
    assert left - right < 0.35


def test_from_side_to_side_it_takes_the_time_that_the_bounds_say() -> None:
    model = GateModel(limits=GateLimits(quantum=1e-9, arm=0.01), v_doubt=0.0)
    bound = 15.6 * math.atan(2.71 * 3.0 / 36.0)
    wheel, samples = -bound, 0
    while wheel < 0.99 * bound and samples < 100:
        wheel, samples = model.pushed(9.0, wheel, 6.0, DT), samples + 1
    assert samples * DT == pytest.approx(model.turning, abs=0.1)


def test_the_way_back_is_that_of_a_car_as_fast_as_the_gate_may_take_it_to_be() -> None:
    doubting, sure = GateModel(v_doubt=0.5), GateModel(v_doubt=0.0)
    assert doubting.pushed(-9.0, 0.0, 5.0, DT) == sure.pushed(-9.0, 0.0, 5.5, DT)
    assert doubting.pushed(-9.0, 0.0, 5.0, DT) > sure.pushed(-9.0, 0.0, 5.0, DT)
    assert doubting.pushed(9.0, 0.0, 5.0, DT) == sure.pushed(9.0, 0.0, 5.0, DT)


def test_more_command_is_never_less_wheel() -> None:
    rng, model = np.random.default_rng(0), GateModel()
    for _ in range(200):
        before, v, *two = (rng.uniform(-1.0, 1.0, 4) * (3.0, 4.0, 9.0, 9.0) + (0.0, 5.0, 0.0, 0.0)).tolist()
        less, more = (model.pushed(command, before, v, DT) for command in sorted(two))
        assert less <= more


def test_a_nan_is_seen() -> None:
    assert all(math.isnan(GateModel().pushed(*u, DT)) for u in ((0.1, math.nan, 5.0), (0.1, 0.0, math.nan)))


def test_a_slew_is_how_fast_the_angle_of_a_steady_bend_may_change() -> None:
    """delta = L a_y/v^2 + K a_y: at 20 m/s, where the tyres' share is a quarter of all."""
    car = dict(wheelbase=2.71, understeer=0.002, steer_ratio=15.6)
    steady = [15.6 * (2.71 * a_y / 20.0**2 + 0.002 * a_y) for a_y in (1.0, 1.0 + 5.0 * 0.05)]
    for rate_limit, slew, v, expected in (
        (9.6, 5.0, 20.0, (steady[1] - steady[0]) / 0.05),
        (0.1, 5.0, 20.0, 0.1),
        (9.6, None, 20.0, 9.6),
        (9.6, 5.0, 0.0, 9.6),
    ):
        assert slewed(SimpleNamespace(rate_limit=rate_limit, slew=slew, **car), v) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("delay", "spans"), [(0.0, ()), (0.05, (0.05,)), (0.12, (0.02, 0.05, 0.05)), (0.15, (0.05, 0.05, 0.05))]
)
def test_the_commands_on_their_way_act_for_the_delay_in_all(delay: float, spans: tuple[float, ...]) -> None:
    assert on_their_way(delay, DT) == pytest.approx(spans)
    pieces = Rollout(delay=delay, lag=0.08).pieces
    lengths, commands, middles, _ = zip(*pieces)
    assert lengths == pytest.approx([*spans, 0.04, 0.04])
    assert middles[-1] == pytest.approx(delay + 0.06)
    assert commands == (*range(len(spans)), *[max(len(spans), 1) - 1] * 2)


def test_a_lag_goes_its_share_and_none_goes_all_the_way() -> None:
    assert lag_share(0.05, 0.1) == pytest.approx(1.0 - math.exp(-0.5))
    assert (lag_share(0.05, 0.0), lag_share(0.0, 0.0)) == (1.0, 0.0)


@pytest.mark.parametrize("e", [0.0, 2.0, -3.0])
def test_a_car_on_a_circle_beside_a_circle_stays_there(e: float) -> None:
    """About the same centre, e to the left of the path: r = v/(R - e)."""
    v, radius = 5.0, 20.0
    found = beside(e, 0.0, 0.3, v, v / (radius - e), 0.0, 1.0 / radius)
    assert found == pytest.approx((e, 0.0), abs=1e-12)
    assert beside(-e, 0.0, 0.3, v, -v / (radius - e), 0.0, -1.0 / radius) == (-found[0], -found[1])


def test_a_step_beside_a_bent_path_is_of_second_order() -> None:
    """Half the step, a quarter of the error: in e and in psi_e."""

    def after(steps: int) -> np.ndarray:
        e, psi_e = 1.5, 0.3
        for _ in range(steps):
            e, psi_e = beside(e, psi_e, 1.0 / steps, 6.0, 0.5, 1.2, 0.12)
        return np.array([e, psi_e])

    exact = after(16384)
    assert (after(128) - exact) / (after(256) - exact) == pytest.approx([4.0, 4.0], rel=0.1)


@pytest.mark.parametrize("points", [1, 3])
def test_the_preview_is_linear_between_its_entries_and_holds_its_last(points: int) -> None:
    preview, model = (0.01, 0.03, 0.02)[:points], Rollout(preview_dt=0.1)
    times = [0.0, 0.05, 0.1, 0.15, 0.2, 0.9]
    assert [model.kappa(preview, t) for t in times] == pytest.approx(np.interp(times, 0.1 * np.arange(points), preview))
