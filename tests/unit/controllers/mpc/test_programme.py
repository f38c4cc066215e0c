"""A sample's programme: what is asked is done and no more, and the path ahead is read where the car will be."""

import math
from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.controllers.mpc.block import PredictiveSteering
from steerkit.controllers.mpc.path_model import CURVES, KAPPA_STEP, SPEEDS
from steerkit.controllers.mpc.programme import NOTHING, PREDICTION, SOLUTION
from tests.support.predictive import ahead, controller, inputs, kinds, steady, table

STATE = {"e": 0.3, "psi_e": -0.05, "r": 0.1, "v": 6.0, "kappa": 0.03}


def question(block: PredictiveSteering, wanted: float, **values: float) -> Any:
    state = block.X(tuple(0.1 * i for i in range(block.waiting)), tuple(0.02 * i for i in range(block.horizon)), 0.0)
    return block._asked(state, inputs(block, **values), wanted)


@kinds
def test_what_is_not_wanted_is_not_done(kind: Any) -> None:
    block = controller(kind)
    asked = question(block, SOLUTION, e=0.3)
    whole, prediction = (block.programme(wanted, *asked[1:]) for wanted in (SOLUTION, PREDICTION))
    success, iterations, residual, *found = whole
    assert (success, iterations >= 1.0, residual <= block.tolerance) == (1.0, True, True)
    assert found[:7] == list(prediction[3:10])
    assert {*prediction[:3], *prediction[10:]} == {0.0}
    nothing = block.programme(NOTHING, *[math.nan] * (len(asked) - 1))
    assert {*nothing} == {0.0}
    assert len(nothing) == block.programme.size


@kinds
def test_a_motion_that_is_not_finite_is_not_solved(kind: Any) -> None:
    block = controller(kind)
    asked = list(question(block, SOLUTION, e=0.3))
    asked[1] = math.nan  # e
    answer = block.programme(*asked)
    assert (*answer[:3], {*answer[10:]}) == (0.0, 0.0, math.inf, {0.0})
    assert block.programme(*question(block, SOLUTION, e=0.3))[0] == 1.0


@kinds
def test_the_motion_is_that_of_the_model(kind: Any) -> None:
    """The states of a solution are those that the stage map gives: exactly, where it is linear."""
    block = controller(kind)
    state = block.X((0.5,) * block.waiting, (0.0,) * block.horizon, 0.0)
    x = state.plan
    for _ in range(6):  # a nonlinear plan converges
        asked = block._asked(state._replace(plan=x), inputs(block, **STATE), SOLUTION)
        x = tuple(block.programme(*asked)[10:])
    found = block.programme.found
    stages = np.append(found["ahead"][:6], found["z"][block.qp.statement.states]).reshape(-1, 6)
    between = found["then"].reshape(-1, 7)[block.waiting + block.horizon + 1 :]
    a, b, _, _ = table(block, 6.0)
    step = block.model.affine_step(2)
    for k in range(block.horizon):
        if kind.__name__ == "MPC":
            after = between[k, :6] + a @ (stages[k] - between[k, :6]) + b * x[k]
        else:
            after = step(stages[k], x[k], asked[-3], between[k, 6])[0].full().ravel()
        np.testing.assert_allclose(stages[k + 1], after, atol=1e-6)
    assert np.abs(stages[:, 0]).max() > 0.1


def test_the_path_ahead_is_read_where_the_pace_of_its_bends_gets_to() -> None:
    """Against NumPy's interpolation, on a path that winds ever tighter."""
    block = controller()
    preview = 0.1 * np.linspace(0.0, 1.0, block.preview_points) ** 2
    u = inputs(block, v=4.2)._replace(preview=tuple(preview.tolist()))
    _, then = ahead(block, u)
    half = 0.5 * block.dt / steady(block, 4.2, preview)[:, 6]
    knots = 2.0 * np.cumsum(half) - half - half[0]
    np.testing.assert_allclose(then[:, 6], np.interp(block.programme.times, knots, preview), atol=1e-12)
    np.testing.assert_allclose(then[:, :6], steady(block, 4.2, then[:, 6])[:, :6], atol=1e-12)
    assert np.ptp(np.diff(knots)) > 1e-4


def test_steady_cornering_between_tabled_speeds_and_curvatures_is_linear() -> None:
    block = controller()
    i, t = np.divmod(5.1 - SPEEDS[0], SPEEDS[1] - SPEEDS[0])
    t /= SPEEDS[1] - SPEEDS[0]
    low, high = (steady(block, float(v), KAPPA_STEP * (np.arange(CURVES) - CURVES // 2)) for v in SPEEDS[int(i) :][:2])
    for place in (0.0, 0.25, 3.5, -7.75, CURVES):
        at = np.clip(place + CURVES // 2, 0, CURVES - 1)
        expected = [np.interp(at, np.arange(CURVES), (1.0 - t) * a + t * b) for a, b in zip(low.T, high.T)]
        np.testing.assert_allclose(steady(block, 5.1, [place * KAPPA_STEP])[0], expected, atol=1e-12)


@kinds
def test_where_the_tyres_cannot_hold_a_bend_the_wheel_stays_where_they_do_their_best(kind: Any) -> None:
    block = controller(kind)
    bends = KAPPA_STEP * np.arange(CURVES // 2 + 1)
    turns = np.diff([steady(block, float(v), bends)[:, 4] for v in SPEEDS], axis=1) / block.steer_ratio
    assert turns.min() > -1e-12
    assert turns.max() < 0.1


@pytest.mark.parametrize("v", [0.5, 0.74, 3.0, 20.0, 30.0])
def test_a_slow_car_is_driven_in_more_steps(v: float) -> None:
    """So many that Runge-Kutta's method is stable for the fastest of the car's rates (2.785)."""
    block = controller()
    model = block.model
    x = casadi.MX.sym("v")
    steps = model.all_substeps[int(casadi.Function("which", [x], [model.which_substeps(x)])(v))]
    rates = np.linalg.eigvals(model._slopes(min(v, 20.0))[0].full()[:, :4])
    assert steps >= 2
    assert np.abs(rates).max() * block.dt / steps <= 2.3 + 1e-9
    assert steps == 2 or np.abs(rates).max() * block.dt / (steps - 1) > 2.3 * (1.0 - 0.5 / v)
