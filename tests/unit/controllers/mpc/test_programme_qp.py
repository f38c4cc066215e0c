"""The quadratic programme of predictive steering: it says what its docstring says, and wrong answers fail the check."""

import math
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.controllers.mpc import programme as module
from steerkit.controllers.mpc.block import FAILED, FALLBACK, NO_FAULT, SOLVED
from steerkit.controllers.mpc.programme import DATA, FAR, StageQp, violation
from tests.support.predictive import controller, driven, inputs, kinds, own, table

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
