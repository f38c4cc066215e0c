"""Stanley's law, term by term, and its symmetries."""

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.controllers.stanley import Stanley, StanleyState
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.vehicles import VW_PASSAT as PASSAT

FREE = dict(a_y_max=1e3, rate_limit=1e3)
BARE = Stanley(k_d_yaw=0.0, k_d_steer=0.0, steer_ratio=1.0, **FREE)
OF_PASSAT = replace(Stanley.of(PASSAT), **FREE)
AT_REST: dict[str, float] = {"e": 0.0, "psi_e": 0.0, "kappa": 0.0, "v": 5.0, "r": 0.0, "delta_sw_meas": 0.0}


def steered(stanley: Stanley, before: float = 0.0, **signals: float) -> Any:
    return stanley.output(0.0, StanleyState(before, 0.0), stanley.D(**(AT_REST | signals))).delta_sw


@given(e=st.floats(-50.0, 50.0), v=st.floats(0.0, 10.0))
def test_the_approach_angle_is_limited(e: float, v: float) -> None:
    limited = steered(BARE, e=e, v=v)
    assert abs(degrees_of(limited)) <= 30.0 + 1e-12
    free = steered(replace(BARE, approach_limit=math.pi / 2.0), e=e, v=v)
    assert limited == pytest.approx(max(-radians_of(30.0), min(radians_of(30.0), free)))


def test_above_a_speed_it_corrects_the_less_the_faster_it_is() -> None:
    fast = replace(OF_PASSAT, v_full=6.0, mass=0.0)
    for signals in ({"psi_e": 0.01}, {"e": 0.02, "psi_e": 0.01}):
        for v, slower in ((5.0, 1.0), (6.0, 1.0), (12.0, 0.5)):
            as_slow = replace(fast, v_full=None, share=slower, k=slower * fast.k)
            assert steered(fast, v=v, **signals) == pytest.approx(steered(as_slow, v=v, **signals))


def test_a_share_of_it_corrects_less_and_holds_the_same_bend() -> None:
    half = replace(OF_PASSAT, share=0.5)
    assert steered(half, e=0.1, psi_e=0.02) == pytest.approx(0.5 * steered(OF_PASSAT, e=0.1, psi_e=0.02))
    v, kappa = 8.0, 0.02
    steady = OF_PASSAT.steer_ratio * (OF_PASSAT.wheelbase + OF_PASSAT.understeer * v * v) * kappa
    bent = dict(v=v, kappa=kappa, r=v * kappa)
    asked = steered(OF_PASSAT, e=0.05, **bent)
    assert steered(half, e=0.05, **bent) == pytest.approx(0.5 * (asked + steady))


signals = st.fixed_dictionaries(
    {
        "e": st.floats(-5.0, 5.0),
        "psi_e": st.floats(-3.0, 3.0),
        "kappa": st.floats(-0.1, 0.1),
        "v": st.floats(0.0, 12.0),
        "r": st.floats(-1.0, 1.0),
        "delta_sw_meas": st.floats(-9.0, 9.0),
    }
)


@given(signals=signals, before=st.floats(-0.6, 0.6))
def test_its_mirror_image_is_its_negative_within_the_stops(signals: dict[str, float], before: float) -> None:
    stanley = Stanley.of(PASSAT)
    there = steered(stanley, before, **signals)
    back = steered(stanley, -before, **{name: x if name == "v" else -x for name, x in signals.items()})
    assert there == -back
    assert abs(there) <= radians_of(520.0)


def test_all_terms_together_with_the_gains_of_the_paper_and_of_the_study() -> None:
    e, psi_e, v, kappa, r, wheel, before = 0.1, 0.02, 8.0, 0.03, 0.3, 0.5, 0.02
    r_path = v * kappa / math.sqrt(1.0 - (PASSAT.wheelbase * kappa) ** 2)
    psi_ss = PASSAT.m * v * r_path * PASSAT.l_r / (PASSAT.c_f * PASSAT.wheelbase)
    damping = 0.15 * (r - r_path) + 0.3 * (wheel / PASSAT.steer_ratio - before)
    delta = -(psi_e - psi_ss) - math.atan(2.5 * e / (1.0 + v)) - damping
    found = steered(OF_PASSAT, before, e=e, psi_e=psi_e, v=v, kappa=kappa, r=r, delta_sw_meas=wheel)
    assert found == pytest.approx(PASSAT.steer_ratio * delta)
    tight = replace(BARE, k_d_yaw=0.15)  # a circle within the wheelbase: the root stays regular
    assert steered(tight, kappa=1.0, r=5.0 / math.sqrt(0.1)) == pytest.approx(0.0)


def test_the_textbook_form_is_heading_and_cross_track_only() -> None:
    textbook = Stanley.textbook(PASSAT)
    expected = -PASSAT.steer_ratio * (0.1 + math.atan(2.5 * 0.2 / (5.0 + 1e-3)))
    assert steered(textbook, before=0.3, e=0.2, psi_e=0.1, kappa=0.05, r=0.7) == pytest.approx(expected)


def test_far_off_it_approaches_only_as_steeply_as_it_can_turn_back() -> None:
    """sqrt(a_spare |e|)/v, half of the 3 m/s^2 for turning onto the path; near it, the law's own arctan."""
    stanley = replace(BARE, a_y_max=3.0, approach_limit=1.5, a_y_reserve=1.5)
    assert steered(stanley, e=2.0, v=9.0, psi_e=-math.sqrt(3.0 * 2.01) / 9.0) == pytest.approx(0.0, abs=1e-12)
    assert steered(stanley, e=0.1, v=9.0, psi_e=-math.atan(2.5 * 0.1 / 10.0)) == pytest.approx(0.0, abs=1e-12)
    reserve = -math.sqrt(1.5 * 2.01) / 9.0  # the bend takes 1.62 of the 3 m/s^2; 1.5 stay reserved
    assert steered(stanley, e=2.0, v=9.0, psi_e=reserve, kappa=0.02) == pytest.approx(0.0, abs=1e-12)
    slow = -((0.5 * 0.6 * 2.01**2) ** (1.0 / 3.0)) / 9.0  # and half of its slew
    assert steered(replace(stanley, slew=0.6), e=2.0, v=9.0, psi_e=slow) == pytest.approx(0.0, abs=1e-12)
