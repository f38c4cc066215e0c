"""A sample's programme: what is asked is done and no more, and the path ahead is read where the car will be."""

import json
import math
from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.controllers.mpc.block import MPC, PredictiveSteering
from steerkit.controllers.mpc.path_model import CURVES, KAPPA_STEP, SPEEDS
from steerkit.controllers.mpc.programme import NOTHING, PREDICTION, SOLUTION
from steerkit.plants.single_track import LinearSingleTrack
from tests.support.places import ROOT
from tests.support.predictive import CAR, STEERING, ahead, controller, inputs, kinds, steady, table

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


@pytest.mark.parametrize("car", [CAR, LinearSingleTrack(vehicle=CAR.vehicle)], ids=["nonlinear", "linear"])
def test_the_model_has_the_numbers_written_down(car: Any) -> None:
    """Sums over what is tabled, stepped and linearised, at speeds and curvatures within the tables, at their ends, and
    beyond; from straight driving and far from it."""
    block = MPC.of(car, delay=STEERING["delay"], horizon=10, clock=None, lag=0.13, q_psi=0.3, q_r=0.02, reference=1.1)
    model, bends = block.model, [-0.3, -0.2475, -0.1, -0.011, 0.0, 0.0025, 0.05, 0.17, 0.2475, 0.26]
    x, far = [0.1, -0.05, 0.02, 0.1, 0.4, 0.7], [-0.9, 0.6, -0.2, -0.8, 6.0, 3.0]
    found = [float(model.sway_is_speed), *[float(np.ravel(steps) @ range(1, 159)) for steps in [model._substeps]]]
    for v in (0.3, 0.5, 1.1, 4.9, 11.0, 19.9, 31.0, 40.0, 51.0):
        parts: list[Any] = [steady(block, v, bends), *table(block, v)]
        for state, kappa in ((x, 0.02), (far, -0.15)):
            parts += [casadi.vertcat(*[casadi.vec(one) for one in model.affine_step(3)(state, 0.5, v, kappa)])]
            parts += [model.predictor((0.02, 0.05, 0.05), 2)(state[:5], [0.1, 0.5, -0.4], v, [kappa, 0.1, 0.0])]
            parts += [casadi.DM([model.a_y(state[:4], state[4], v), *model.motion(state[:4], state[4], v, kappa)])]
        found += [float(np.ravel(part) @ np.sqrt(1.0 + np.arange(np.size(part)))) for part in map(np.array, parts)]
    expected = json.loads((ROOT / "tests/golden/predictive.json").read_text(encoding="utf-8"))[type(car).__name__]
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-7), json.dumps([float(f"{one:.8g}") for one in found])
