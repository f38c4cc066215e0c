"""The damping of a steering law's loop, against closed forms and python-control."""

import math
from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest

from steerkit.analysis import margins as margins_of
from steerkit.controllers.delay import delayed_stanley
from steerkit.controllers.lqr import Lqr, LqrDesign
from steerkit.controllers.margins import Doubt, SteeredCar, damping, least_damping, linearised
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.vehicles import VW_PASSAT as PASSAT

MATRICES = LinearSingleTrack(vehicle=PASSAT).matrices
CAR = SteeredCar(vehicle=PASSAT, matrices=MATRICES, delay=0.2, lag=0.1)
STEERING: dict[str, Any] = dict(delay=0.2, lag=0.1)
LQR = Lqr.of(PASSAT, MATRICES, **STEERING, v_min=5.0, v_max=20.0, v_step=5.0)


@pytest.mark.parametrize("v", [5.0, 10.0, 20.0])
def test_on_the_car_it_was_made_for_an_lqr_has_the_poles_of_its_riccati_solution(v: float) -> None:
    design = LqrDesign(matrices=MATRICES, reference=PASSAT.l_f, **STEERING)
    a, b, _ = design.model(v)
    z = np.linalg.eigvals(a - np.outer(b, design.gains(v, 24)[0]))
    s = np.log(z[np.abs(z) > 1e-6].astype(complex))
    assert damping(linearised(LQR, v), CAR, v, LQR.dt) == pytest.approx(float(np.min(-s.real / np.abs(s))), rel=1e-3)


@pytest.mark.parametrize("block", [LQR, delayed_stanley(PASSAT, **STEERING)])
def test_the_poles_are_those_of_python_control(block: Any) -> None:
    v = 10.0
    law = linearised(block, v)
    a, b, rows = CAR.system(v, block.dt)
    seen = np.array([rows[name] for name in law.inputs])
    car = control.ss(a, b[:, None], seen, 0.0, block.dt)
    closed = control.feedback(car, control.ss(law.a, law.b, law.c[None], law.d[None], block.dt), sign=1)
    z = control.poles(closed)
    moving = (np.abs(z) > 1e-6) & (np.abs(z - 1.0) > 1e-9)
    s = np.log(z[moving].astype(complex))
    assert damping(law, CAR, v, block.dt) == pytest.approx(float(np.min(-s.real / np.abs(s))), rel=1e-3)


def test_a_loop_swings_beyond_its_margins_and_not_before() -> None:
    law = linearised(LQR, 10.0)
    a, b, rows = CAR.system(10.0, LQR.dt)
    car = control.ss(a, b[:, None], np.array([rows[name] for name in law.inputs]), 0.0, LQR.dt)
    found = margins_of(control.ss(law.a, law.b, -law.c[None], -law.d[None], LQR.dt) * car)

    def damped(gain: float = 1.0, later: float = 0.0) -> float:
        return damping(law, replace(CAR, gain=gain, delay=CAR.delay + later), 10.0, LQR.dt)

    assert damped(gain=0.99 * found.gain) > 0.0 > damped(gain=1.01 * found.gain)
    assert damped(later=0.99 * found.delay) > 0.0 > damped(later=1.01 * found.delay)


def test_the_corners_of_a_doubt_are_both_gains_at_both_delays_and_none_acts_before_its_command() -> None:
    early = replace(CAR, delay=0.05).corners(Doubt(gain=1.25, delay=0.1))
    assert [(car.gain, car.delay) for car in early] == [
        (0.8, 0.0),
        (0.8, pytest.approx(0.15)),
        (1.25, 0.0),
        (1.25, pytest.approx(0.15)),
    ]
    least = [damping(linearised(LQR, 10.0), car, 10.0, LQR.dt) for car in CAR.corners(Doubt())]
    assert least_damping(LQR, CAR, Doubt(), [10.0]) == min(least)
    assert least_damping(LQR, CAR, Doubt(gain=1.0, delay=0.0), [10.0]) > min(least)


def test_what_has_no_model_is_named() -> None:
    from steerkit.controllers.safety_filter import SafetyFilter

    with pytest.raises(ValueError, match=r"SafetyFilter needs .*, which has no model here"):
        linearised(SafetyFilter.of(PASSAT, delay=0.1, lag=0.1, rate_limit=5.0), 5.0)
    assert math.isfinite(least_damping(LQR, CAR, Doubt(), [5.0]))
