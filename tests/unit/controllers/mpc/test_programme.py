"""A sample's programme: what is asked is done and no more; the path ahead is read where the car will be; the quadratic
programme says what its docstring says, and wrong answers fail the check."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.controllers.mpc import programme as module
from steerkit.controllers.mpc.block import FAILED, FALLBACK, MPC, NO_FAULT, SOLVED, PredictiveSteering
from steerkit.controllers.mpc.path_model import CURVES, KAPPA_STEP, SPEEDS
from steerkit.controllers.mpc.programme import DATA, FAR, NOTHING, PREDICTION, SOLUTION, StageQp, violation
from steerkit.plants.single_track import LinearSingleTrack
from tests.support.places import ROOT
from tests.support.predictive import CAR, STEERING, ahead, controller, driven, inputs, kinds, own, steady, table

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


# ---- what it states -------------------------------------------------------------------------------------------------


def test_the_numbers_are_those_of_the_stated_cost_and_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a random z of three stages, the second with soft limits, against the formulas of the docstring."""
    q, q_slack = (1.0, 0.5, 0.0, 0.2, 0.0, 0.0), (10.0, 100.0)
    weights = dict(q_e=1.0, q_psi=0.5, q_r=0.2, q_rate=0.3, q_e_limit=10.0, q_a_y_limit=100.0)
    monkeypatch.setattr(module, "_SOFT_FIRST", 1)
    qp = StageQp(SimpleNamespace(horizon=3, limit=8.0, e_limit=0.5, **weights))
    random = np.random.default_rng(1)
    a, b, gap, slope = (random.normal(size=(6, n)) for n in (12, 3, 3, 3))
    row, half = random.normal(size=(6, 1)), random.normal(size=(6, 6))
    p, low, high, fastest = half @ half.T, -1.5, 2.5, 4.0
    data = {
        name: np.array(casadi.DM(value))
        for name, value in zip(DATA, qp.statement.data(a, b, gap, slope, row, low, high, p, fastest))
    }
    z = random.normal(size=(len(data["g"]), 1))
    rates, x = z[qp.statement.rates, 0], z[qp.statement.states, 0].reshape(3, 6).T
    slack = z[[8, 9], 0]  # u_0, six states, the rate of u_1
    cost = 0.5 * (z.T @ data["h"] @ z) + data["g"].T @ z
    expected = 0.5 * (0.3 * rates @ rates + q_slack @ slack**2 + x[:, 2] @ p @ x[:, 2]) + (slope * x).sum()
    expected += 0.5 * sum(np.array(q) @ x[:, k] ** 2 for k in (0, 1))
    assert cost.item() == pytest.approx(expected, rel=1e-12)
    moved = [b[:, 0] * rates[0] - x[:, 0]]
    moved += [a[:, 6 * k : 6 * k + 6] @ x[:, k] + b[:, k + 1] * rates[k + 1] - x[:, k + 1] for k in (0, 1)]
    soft = [x[0, 0] - slack[0], row[:, 0] @ x[:, 0] - slack[1]]
    np.testing.assert_allclose((data["a"] @ z)[:, 0], [*moved[0], *moved[1], *soft, *moved[2]], atol=1e-12)
    for name, limits in (("lba", (-0.5, low)), ("uba", (0.5, high))):
        np.testing.assert_array_equal(data[name][:, 0], [*gap[:, 0], *gap[:, 1], *limits, *gap[:, 2]])
    far = [FAR] * 5 + [8.0]
    np.testing.assert_array_equal(data["ubx"][:, 0], [fastest, *far, fastest, FAR, FAR, *far, fastest, *far])
    np.testing.assert_array_equal(data["lbx"], -data["ubx"])


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
