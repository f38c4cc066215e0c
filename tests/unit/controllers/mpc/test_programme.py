"""A sample's programme: what is asked is done and no more; the path ahead is read where the car will be; the quadratic
programme says what its docstring says, and wrong answers fail the check."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.controllers.mpc import programme as module
from steerkit.controllers.mpc.block import FAILED, FALLBACK, MPC, NO_FAULT, SOLVED, PredictiveSteering
from steerkit.controllers.mpc.path_model import CURVES, KAPPA_STEP, SPEEDS
from steerkit.controllers.mpc.programme import DATA, NOTHING, PREDICTION, SOLUTION, violation
from steerkit.plants.single_track import LinearSingleTrack
from tests.support.places import ROOT
from tests.support.predictive import CAR, STEERING, controller, driven, inputs, kinds, own, steady, table


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
def test_where_the_tyres_cannot_hold_a_bend_the_wheel_stays_where_they_do_their_best(kind: Any) -> None:
    block = controller(kind)
    bends = KAPPA_STEP * np.arange(CURVES // 2 + 1)
    turns = np.diff([steady(block, float(v), bends)[:, 4] for v in SPEEDS], axis=1) / block.steer_ratio
    assert turns.min() > -1e-12
    assert turns.max() < 0.1


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


# ---- what it states -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({}, 0.0),
        ({"z": 1.5}, 0.5),  # beyond a bound
        ({"a": 4.0, "z": 0.5}, 1.0),  # beyond a row's
        ({"g": 0.3}, 0.3),  # not stationary
        ({"g": -0.3, "lam_z": 0.3}, 0.3),  # the multiplier pulls although its bound is far: not complementary
        ({"g": -0.3, "lam_z": 0.3, "z": 1.0}, 0.0),  # the bound is met
        ({"lam_a": 0.2}, 0.2),
        ({"lam_a": 0.2, "a": 1.0, "g": -0.2, "z": 1.0}, 0.0),
        *[({name: math.nan}, math.inf) for name in ("z", "lam_z", "lam_a")],
    ],
)
def test_the_check_sees_every_kind_of_wrong_answer(wrong: dict[str, float], expected: float, side: float) -> None:
    """One variable and one row, both between -1 and 1 and without a cost: each condition is broken alone."""
    signed = {name: value * (1.0 if name == "a" else side) for name, value in wrong.items()}
    data = {"h": 0.0, "g": 0.0, "a": 0.0, "lba": -1.0, "uba": 1.0, "lbx": -1.0, "ubx": 1.0} | signed
    z, lam_z, lam_a = (casadi.DM(data.pop(name, 0.0)) for name in ("z", "lam_z", "lam_a"))
    assert float(violation({k: casadi.DM(v) for k, v in data.items()}, z, lam_z, lam_a)) == pytest.approx(expected)


# ---- what the solver finds ------------------------------------------------------------------------------------------


def problems() -> Iterator[dict[str, float]]:
    yield {"e": 0.02}
    yield {"e": 0.7, "psi_e": -0.1, "r": 0.2}  # rate, e and a_y limits are active
    yield {"e": -1.5, "v": 8.0}
    yield {"psi_e": 0.5, "v": 4.0, "delta_sw_meas": 8.9}


@kinds
@pytest.mark.parametrize("values", list(problems()))
def test_an_active_set_solver_finds_the_same(kind: Any, values: dict[str, float]) -> None:
    block = controller(kind)
    plan = driven(block, [inputs(block, **values)])[0].plan
    data = block.qp.statement.data
    given = {k: casadi.DM(data.sparsity_out(k), block.programme.found[k]) for k in DATA}
    shapes = {name: data.sparsity_out(name) for name in ("h", "a")}
    other = casadi.conic("other", "qpoases", shapes, {"printLevel": "none", "sparse": False})(**given)
    np.testing.assert_allclose(plan, np.array(other["x"])[block.qp.statement.rates, 0], atol=2e-3)


@kinds
def test_a_solution_owes_nothing_to_those_before_it(kind: Any) -> None:
    """CasADi's HPIPM, bound to buffers of its own, goes on answering the first problem."""
    used = controller(kind)
    for values in problems():
        u, fresh = inputs(used, **values), own(kind)
        assert driven(used, [u])[0].plan == driven(fresh, [u])[0].plan


def test_limits_are_soft_in_e_and_a_y_and_hard_in_rate_and_angle(monkeypatch: pytest.MonkeyPatch) -> None:
    assert controller(horizon=20).qp.soft == [1, 2, 3, 4, 8, 12, 16]
    monkeypatch.setattr(module, "_SOFT_EVERY", 1)
    block = own(horizon=20)
    driven(block, [inputs(block, e=1.2, v=9.0)])
    z, at, soft = block.programme.found["z"], block.qp.statement, block.qp.soft
    stages = z[at.states].reshape(-1, 6)
    assert np.abs(z[at.rates]).max() <= block.rate_limit + 1e-6
    assert np.abs(stages[:, 5]).max() <= block.limit + 1e-6
    slack = np.array([z[at.rates[k] + 1] for k in soft])
    np.testing.assert_allclose(slack, np.maximum(stages[[k - 1 for k in soft], 0] - block.e_limit, 0.0), atol=2e-2)
    assert slack[0] > 0.4
    most = []
    for one in (block, replace(block, q_a_y_limit=0.0)):
        driven(one, [inputs(one, e=0.8, psi_e=0.2, v=9.0)])
        a_y = one.programme.found["z"][at.states].reshape(-1, 6) @ table(one, 9.0)[2]
        most.append(float(np.abs(a_y[:-1]).max()))  # the last stage has no soft limits
    assert most[0] < 3.1 < 5.0 < most[1]


def test_one_that_runs_out_of_iterations_is_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(module._HPIPM, "iter_max", 3)
    block = own()
    states: list[dict[str, float]] = [{"e": 1e-4, "kappa": 0.0}, {"e": 0.9, "psi_e": 0.1}]
    easy, hard = (driven(block, [inputs(block, **values)])[0] for values in states)
    assert (easy.status, easy.fault) == (SOLVED, NO_FAULT)
    assert (hard.status, hard.fault, hard.iterations) == (FALLBACK, FAILED, 3.0)


def test_one_without_a_solution_is_no_success() -> None:
    """The last command is so far beyond its limit that no rate brings the next one within it."""
    block = own()
    state = block.X((0.0,) * block.waiting, (0.0,) * block.horizon, 0.0)
    for beyond, success in ((40.0, 0.0), (0.0, 1.0)):
        before = state._replace(commands=(*state.commands[1:], beyond))
        found, _, residual, *_ = block.programme(*block._asked(before, inputs(block, e=0.1), 2.0))
        assert (found, residual <= block.tolerance) == (success, bool(success))
