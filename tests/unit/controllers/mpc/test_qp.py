"""The programme of predictive steering and its solvers: they agree, and wrong answers do not pass the check."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.mpc.qp import SOLVERS
from tests.support.predictive import controller, driven, inputs, kinds, own


def problems() -> Iterator[dict[str, float]]:
    yield {"e": 0.02}
    yield {"e": 0.7, "psi_e": -0.1, "r": 0.2}  # rate, e and a_y limits are active
    yield {"e": -1.5, "v": 8.0}
    yield {"psi_e": 0.5, "v": 4.0, "delta_sw_meas": 8.9}


@kinds
@pytest.mark.parametrize("values", list(problems()))
def test_all_solvers_find_the_same(kind: Any, values: dict[str, float]) -> None:
    found = [driven(controller(kind, solver=solver), [inputs(controller(kind), **values)])[0] for solver in SOLVERS]
    assert [y.status for y in found] == [0.0] * 3
    for y in found[1:]:
        np.testing.assert_allclose(y.plan, found[0].plan, atol=2e-3)


@kinds
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_solution_owes_nothing_to_those_before_it(kind: Any, solver: str) -> None:
    """CasADi's HPIPM, bound to buffers of its own, went on answering the first problem."""
    used = controller(kind, solver=solver)
    for values in problems():
        fresh = own(kind, solver=solver)
        u = inputs(used, **values)
        np.testing.assert_allclose(driven(used, [u])[0].plan, driven(fresh, [u])[0].plan, atol=1e-7)


def test_the_check_sees_every_kind_of_wrong_answer() -> None:
    block = own()
    driven(block, [inputs(block, e=0.7, psi_e=-0.1)])
    qp = block.qp
    qp._condensed()
    clean = {name: array.copy() for name, array in qp._out.items()}

    def residual(name: str, entry: int, value: float) -> float:
        for key, array in clean.items():
            qp._out[key][:] = array
        qp._out[name][entry] = value
        qp.check()
        return float(qp._out["residual"][0])

    right = clean["x"][0]
    assert residual("x", 0, right) < 1e-9
    assert residual("x", 0, right + 0.01) >= 5e-4 - 1e-9  # 50 times the tolerance: the motion is broken
    assert residual("lam_x", 5, 0.01) >= 0.01 - 1e-9  # not stationary
    assert residual("lam_a", 3, clean["lam_a"][3] + 0.01) > 5e-3
    for name in ("x", "lam_x", "lam_a"):
        assert not residual(name, 2, math.nan) < math.inf
    slack = int(np.argmin(np.abs(clean["lam_x"])))
    assert residual("lam_x", slack, 1.0) > 0.5


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["x", "a"])
def test_the_check_is_the_same_to_both_sides(kind: str, side: float) -> None:
    """A programme at rest at z = 0, all bounds 1 away: each condition is broken alone, upwards or downwards."""
    qp = own().qp
    for name in ("h", "g", "a"):
        qp.data[name][:] = 0.0
    for name in ("lba", "lbx"):
        qp.data[name][:] = -1.0
        qp.data[name.replace("lb", "ub")][:] = 1.0

    def residual(**entries: float) -> float:
        for array in qp._out.values():
            array[:] = 0.0
        qp.data["g"][0] = entries.pop("g", 0.0)
        for name, value in entries.items():
            qp._out[name][0] = value
        qp.check()
        return float(qp._out["residual"][0])

    assert residual() == 0.0
    assert residual(x=1.5 * side) == pytest.approx(0.5)  # beyond a bound
    assert residual(g=0.3 * side) == pytest.approx(0.3)  # not stationary
    if kind == "x":  # a multiplier pulls although its bound is far: stationary, but not complementary
        assert residual(g=-0.3 * side, lam_x=0.3 * side) == pytest.approx(0.3)
        assert residual(g=-0.3 * side, lam_x=0.3 * side, x=side) == pytest.approx(0.0, abs=1e-12)  # it is met
    else:
        assert residual(lam_a=0.2 * side) == pytest.approx(0.2)


def test_limits_are_soft_in_e_and_a_y_and_hard_in_rate_and_angle() -> None:
    block = controller(horizon=20, soft_every=1)
    driven(block, [inputs(block, e=1.2, v=9.0)])
    x, soft = block.qp._out["x"], block.qp.soft
    stages = x[block.qp.place["x"]]
    assert np.abs(x[block.qp.at_u]).max() <= block.rate_limit + 1e-6
    assert np.abs(stages[:, 5]).max() <= block.limit + 1e-6
    slack = np.array([x[block.qp.at_u[k] + 1] for k in soft])
    np.testing.assert_allclose(slack, np.maximum(stages[[k - 1 for k in soft], 0] - block.e_limit, 0.0), atol=2e-2)
    assert slack[0] > 0.4
    wild = replace(block, q_a_y_limit=0.0)
    most = []
    for one in (block, wild):
        driven(one, [inputs(one, e=0.8, psi_e=0.2, v=9.0)])
        a_y = one.qp._out["x"][one.qp.place["x"]] @ one.model.at(9.0)[2]
        most.append(float(np.abs(a_y[:-1]).max()))  # the last stage has no soft limits
    assert most[0] < 3.1 < 5.0 < most[1]


def test_a_programme_that_is_not_finite_is_no_solution() -> None:
    block = own()
    driven(block, [inputs(block)])
    qp = block.qp
    qp.data["lba"][0] = math.nan
    answer = qp.solve()
    assert not answer.success
    assert answer.residual == math.inf
