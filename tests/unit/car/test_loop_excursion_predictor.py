"""How far a car will get: closed forms, the mirror, and what the real gate makes of it."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.car.gate import gate
from steerkit.car.loop import ExcursionPredictor
from steerkit.diagram.units import radians_of
from steerkit.vehicles.rollout import GateLimits, GateModel

RATIO, LENGTH = 15.6, 2.71


def reach(e: float, psi_e: float, kappa: float, v: float, doe: float, **settings: Any) -> float:
    block = ExcursionPredictor(**settings)
    return float(block.output(0.0, (), block.D(e, psi_e, kappa, v, doe)).reach)


def test_a_steady_bend_is_left_no_further_than_the_wheel_is_turned() -> None:
    """At the front axle psi_e = -delta in the steady bend; kappa is that of the front axle's circle, sin(delta)/L."""
    delta = radians_of(200.0) / RATIO
    assert reach(0.0, -delta, math.sin(delta) / LENGTH, 4.0, RATIO * delta) == pytest.approx(0.0, abs=1e-9)


def test_while_the_wheels_are_held_it_goes_straight_on() -> None:
    """With the whole horizon held and no bend, e grows by v T sin(psi_e)."""
    v, psi_e = 3.0, 0.2
    far = reach(0.1, psi_e, 0.0, v, 0.0, hold=9.0, horizon=1.0)
    assert far == pytest.approx(0.1 + v * 1.0 * math.sin(psi_e), abs=1e-12)


def test_the_slower_the_wheel_the_further() -> None:
    """Small angles: e' = v (psi_e + delta), delta' = -w: from psi_e the car has turned when delta = -psi_e, at once
    for a fast wheel; then it is psi_e^2 v / (2 w) off."""
    v, psi_e, jerk = 1.0, 0.1, 0.2
    turn = LENGTH * jerk / v**2  # rad/s of the road wheels
    gates = [
        GateModel(v_doubt=0.0, limits=GateLimits(quantum=1e-9, jerk_max=j)) for j in (2.0 * jerk, jerk, 0.5 * jerk)
    ]
    fast, found, slow = (reach(0.0, psi_e, 0.0, v, 0.0, hold=0.0, gate=gate) for gate in gates)
    assert found == pytest.approx(v * psi_e**2 / (2.0 * turn), rel=0.05)  # psi_e turns a little meanwhile
    assert fast < found < slow


small = st.floats(-1.0, 1.0)


@given(e=small, psi_e=small, kappa=st.floats(-0.1, 0.1), v=st.floats(0.0, 10.0), doe=st.floats(-9.0, 9.0))
def test_it_is_the_same_in_the_mirror_and_never_nearer_than_now(
    e: float, psi_e: float, kappa: float, v: float, doe: float
) -> None:
    far = reach(e, psi_e, kappa, v, doe)
    assert far >= abs(e)
    assert far == reach(-e, -psi_e, -kappa, v, -doe)
    block = ExcursionPredictor()
    assert block.output(0.0, (), block.D(e, psi_e, kappa, v, doe)).distance == max(abs(e), 0.4 * far)


def driven(psi_e: float, kappa: float, v: float, doe: float) -> float:
    """How far the front axle of a kinematic car gets from a circle in the plane, its rear axle rolling at v, stepped
    finely, its wheel turned back by the real gate, frame by frame [m]."""
    limits, h = GateLimits(), 0.004
    furthest = 0.0
    for lock in (-radians_of(520.0), radians_of(520.0)):
        x, y, psi, command = -LENGTH * math.cos(psi_e), -LENGTH * math.sin(psi_e), psi_e, doe  # of the rear axle
        for n in range(500):
            if n % 5 == 0 and n * h >= 0.15:
                command = gate(limits, lock, command, (v, v), 5 * h).delta_sw
            half = 0.5 * h * v * math.tan(command / RATIO) / LENGTH
            x, y, psi = x + h * v * math.cos(psi + half), y + h * v * math.sin(psi + half), psi + 2.0 * half
            front = x + LENGTH * math.cos(psi), y + LENGTH * math.sin(psi)
            away = math.hypot(kappa * front[0], kappa * front[1] - 1.0)  # from the circle's centre, in radii
            e = (1.0 - away) / kappa if abs(kappa) > 1e-6 else front[1]
            furthest = max(furthest, abs(e) if e * lock < 0.0 else 0.0)
    return furthest


def test_nor_from_states_drawn_uniformly() -> None:
    """Hypothesis likes small and round numbers; the gate's rounding and its bounds show in all the others."""
    rng = np.random.default_rng(0)
    states = [(0.0, 0.0, 9.0, 2.0), *(rng.uniform(-1.0, 1.0, (150, 4)) * (0.5, 0.05, 4.0, 3.0) + (0.0, 0.0, 5.0, 0.0))]
    for state in np.array(states).tolist():
        promised, far = reach(0.0, *state), driven(*state)
        assert far - 0.01 <= promised <= 1.15 * far + 0.03, state


def test_a_wheel_beyond_the_bound_comes_back_no_faster_than_the_gate_lets_it() -> None:
    """At 9 m/s 3 m/s^2 are 1.6 rad; from 3 rad the wheel needs a while, in which the car turns left all the more."""
    bound = RATIO * math.atan(LENGTH * 3.0 / 81.0)
    far, near = (reach(0.0, -0.8, 0.0, 9.0, doe) for doe in (bound, 3.0))
    assert near < far - 0.5
