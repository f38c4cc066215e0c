"""The LQR: its model, its gains, what delay states are, and that it holds bends without an offset."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.controllers.lqr import Lqr, LqrDesign, cost_to_go
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.steering_actuator import SteeringActuator
from tests.support.straight_road import PASSAT

MATRICES = LinearSingleTrack(vehicle=PASSAT).matrices


def design(**changes: Any) -> LqrDesign:
    return replace(LqrDesign(matrices=MATRICES, reference=PASSAT.l_f), **changes)


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.05, 0.12])
def test_its_model_is_the_car_behind_the_actuator(delay: float) -> None:
    """Three samples of the linear model against the blocks, stepped finely; small angles and no limits."""
    v, fine = 6.0, 0.001
    model, step_in, kappa_in = design(delay=delay, lag=0.1).model(v)
    car = LinearSingleTrack(vehicle=PASSAT, v0=v, dt=fine, x0=0.0)
    actuator = SteeringActuator(delay=delay, lag=0.1, dt=fine)
    x, z = car.init(), actuator.init()
    state = np.zeros(len(step_in))
    command = 0.0
    for step in (1e-3, -4e-4, 2e-4, 0.0):
        state = model @ state + step_in * step
        command += step
        for _ in range(50):
            y = actuator.output(0.0, z, ())
            x = car.update(0.0, x, car.U(y.delta_sw, v), car.output(0.0, x, ()))
            z = actuator.update(0.0, z, actuator.U(command * PASSAT.steer_ratio), y)
    e = x.y + PASSAT.l_f * math.sin(x.psi)
    expected = (e, x.psi, x.sway, x.r, z[0] / PASSAT.steer_ratio)
    np.testing.assert_allclose(state[:5], expected, rtol=0.02, atol=2e-6)
    assert np.any(kappa_in[:2])


@pytest.mark.parametrize("delay", [0.0, 0.12, 0.2])
def test_the_block_closes_the_loop_of_its_own_model(delay: float) -> None:
    """For small errors on a straight: x+ = (A - B K) x, commands on their way and all."""
    v, made = 6.0, design(delay=delay)
    lqr = Lqr.of(PASSAT, MATRICES, delay=delay, v_step=1.0, preview_points=2)
    a, b, _ = made.model(v)
    k, _ = made.gains(v, 2)
    x = np.zeros(len(b))
    x[:4] = 1e-4, -2e-4, 1e-4, 3e-4
    state = lqr.init()
    for _ in range(40):
        e, theta, beta, r, delta = x[:5].tolist()
        e_dot = v * (theta + beta) + made.reference * r
        u = lqr.U(e, e_dot, (0.0, 0.0), v, beta, r, delta * PASSAT.steer_ratio)
        y = lqr.output(0.0, state, lqr.D(*u))
        before, x = x[-1], (a - np.outer(b, k)) @ x
        assert y.delta_sw / PASSAT.steer_ratio == pytest.approx(x[-1], abs=1e-9)
        assert before == pytest.approx(state[-1] / PASSAT.steer_ratio, abs=1e-9)
        state = lqr.update(0.0, state, u, y)
    np.testing.assert_allclose(np.array(state) / PASSAT.steer_ratio, x[5:], atol=1e-9)


def test_preview_gains_are_the_best_use_of_a_known_bend() -> None:
    """Against brute force: the least cost of 200 samples over all command steps, for a kink seen 4 samples ahead."""
    made, v, n, ahead = design(), 6.0, 200, 4
    a, b, d = made.model(v)
    k, g = made.gains(v, 30)
    kappa = np.where(np.arange(n + 30) >= ahead, 0.01, 0.0)
    rows = np.zeros((2, len(b)))
    rows[0, 0] = 1.0 / made.e_size
    rows[1, 1:4] = np.array((v, v, made.reference)) / made.e_dot_size
    free, answer = np.zeros(len(b)), np.zeros((len(b), n))
    costs, constants = [], []
    for i in range(n):
        free, answer = a @ free + d * kappa[i], a @ answer
        answer[:, i] += b
        costs.append(rows @ answer)
        constants.append(rows @ free)
    matrix = np.vstack((*costs, np.eye(n) / made.step_size))
    right = -np.concatenate((*constants, np.zeros(n)))
    best = np.linalg.lstsq(matrix, right, rcond=None)[0]
    x, steps = np.zeros(len(b)), []
    for i in range(40):
        steps.append(-k @ x - g @ kappa[i : i + 30])
        x = a @ x + b * steps[-1] + d * kappa[i]
    np.testing.assert_allclose(steps, best[:40], atol=2e-4 * np.abs(best).max())


def test_standstill_counts_as_walking_pace_and_a_bend_within_the_wheelbase_is_regular() -> None:
    lqr = replace(Lqr.of(PASSAT, MATRICES, preview_points=1, v_max=3.0), rate_limit=1e3, a_y_max=1e3)
    u = dict(e=0.0, e_dot=0.0, preview=(0.0,), v=0.0, beta=0.0, r=0.0, delta_sw_meas=0.0)

    def asked(**changes: Any) -> float:
        wheel = lqr.output(0.0, lqr.init(), lqr.D(**u | changes)).delta_sw
        return math.tan(float(wheel) / PASSAT.steer_ratio)

    k = lqr.table.rows[0]
    assert asked(e_dot=0.01) == pytest.approx(-k[1] * 0.01)  # theta = e_dot/1 m/s
    assert asked(preview=(1.0,)) == pytest.approx(-k[-1] / math.sqrt(0.1))


def test_gains_are_linear_between_the_speeds_of_the_table_and_those_of_its_ends_beyond() -> None:
    lqr = Lqr.of(PASSAT, MATRICES, preview_points=1, v_min=2.0, v_max=8.0, v_step=2.0)
    rows = lqr.table.rows
    for v, expected in ((0.0, rows[0]), (2.0, rows[0]), (4.5, 0.75 * rows[1] + 0.25 * rows[2]), (6.0, rows[2])):
        assert lqr._gains(v) == pytest.approx(expected)
    for v, expected in ((7.0, 0.5 * (rows[2] + rows[3])), (8.0, rows[3]), (9.0, rows[3])):
        assert lqr._gains(v) == pytest.approx(expected)


def test_it_refuses_designs_that_cannot_be() -> None:
    with pytest.raises(ValueError, match=r"LqrDesign: delay = 2.1 \[s\], expected 0 to 2"):
        design(delay=2.1)
    lqr = Lqr.of(PASSAT, MATRICES, preview_points=2, v_min=4.0, v_max=5.0)
    with pytest.raises(ValueError, match="table of 8 columns"):
        replace(lqr, preview_points=3)
    with pytest.raises(ValueError, match="preview_points = 0"):
        Lqr.of(PASSAT, MATRICES, preview_points=0)
    for speeds in ({"v_min": 0.0}, {"v_min": 5.0, "v_max": 5.0}, {"v_step": 0.0}):
        with pytest.raises(ValueError, match=r"Lqr: speeds .* m/s"):
            Lqr.of(PASSAT, MATRICES, **speeds)


# ---- the cost to go: its equation, a case solved by hand, and that what is kept cannot be written into ---------------

TWO_A = np.array([[1.0, 0.05], [0.0, 0.9]])
TWO_B = np.array([0.001, 0.05])


@given(e=st.floats(0.1, 10.0), rate=st.floats(0.0, 10.0), r=st.floats(1e-3, 1e3))
def test_it_solves_the_riccati_equation(e: float, rate: float, r: float) -> None:
    q = np.diag([e, rate])
    p = cost_to_go(TWO_A, TWO_B, q, r)
    gain = (TWO_B @ p @ TWO_A) / (r + TWO_B @ p @ TWO_B)
    assert p == pytest.approx(q + TWO_A.T @ p @ TWO_A - np.outer(TWO_A.T @ p @ TWO_B, gain), rel=1e-8, abs=1e-9)
    assert np.abs(np.linalg.eigvals(TWO_A - np.outer(TWO_B, gain))).max() < 1.0


def test_each_system_weight_and_effort_has_its_own_and_writing_into_it_changes_no_other() -> None:
    q = np.eye(2)
    first = cost_to_go(TWO_A, TWO_B, q, 1.0)
    kept = first.copy()
    first[:] = 0.0
    assert (cost_to_go(TWO_A, TWO_B, q, 1.0) == kept).all()
    for other in ((TWO_A.T.copy(), TWO_B), (TWO_A, 2.0 * TWO_B)):
        assert (cost_to_go(*other, q, 1.0) != kept).any()
    assert (cost_to_go(TWO_A, TWO_B, 2.0 * q, 1.0) != kept).any()
    assert (cost_to_go(TWO_A, TWO_B, q, 2.0) != kept).any()


def test_a_transposed_view_is_read_as_it_looks() -> None:
    """An array's bytes in memory may be in another order than its rows."""
    assert (cost_to_go(TWO_A.T, TWO_B, np.eye(2), 1.0) == cost_to_go(TWO_A.T.copy(), TWO_B, np.eye(2), 1.0)).all()
