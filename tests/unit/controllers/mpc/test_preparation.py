"""What is prepared for a sample's programme: each number has its place, and the path ahead is where the car will be."""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.controllers.mpc.path_model import CURVES, KAPPA_STEP, SPEEDS
from steerkit.controllers.mpc.preparation import chosen
from steerkit.controllers.mpc.programme import SOLUTION
from tests.support.predictive import controller, inputs, kinds

STATE = {"e": 0.3, "psi_e": -0.05, "r": 0.1, "v": 6.0, "kappa": 0.03}


@kinds
def test_every_number_that_changes_has_one_place(kind: Any) -> None:
    block = controller(kind)
    preparation, qp = block.programme.preparation, block.qp
    places, source = preparation.where
    assert len(set(places.tolist())) == len(places)
    assert set(source.tolist()) == set(range(len(block.programme.fresh)))
    before = qp.numbers.copy()
    for values in (STATE, {"e": -0.2, "v": 9.0, "kappa": -0.05}):
        block.programme(*block._asked(block.X((0.3,) * block.pieces, (0.1,) * 10, 0.0), inputs(block, **values), 2.0))
    changed = np.flatnonzero(qp.numbers != before)
    assert set(changed.tolist()) <= set(places.tolist())


@kinds
def test_the_motion_is_that_of_the_model(kind: Any) -> None:
    """The states of a solution are those that the stage map gives: exactly, where it is linear."""
    block = controller(kind)
    state = block.X((0.5,) * block.pieces, (0.0,) * block.horizon, 0.0)
    x = state.plan
    for _ in range(6):  # a nonlinear plan converges
        asked = block._asked(state._replace(plan=x), inputs(block, **STATE), SOLUTION)
        told = block.programme(*asked)
        x = tuple(told[-block.horizon :])
    qp, ahead = block.qp, block.programme.ahead
    stages = np.vstack((ahead[:6], qp._out["x"][qp.place["x"]]))
    v, kappa = asked[-4], block.programme.then[block.pieces + block.horizon + 1 :, 6]
    bends = block.programme.then[block.pieces + block.horizon + 1 :, :6]
    a, b, _, _ = block.model.at(v)
    step = block.model.linearised_step(block.model.substeps(v))
    for k in range(block.horizon):
        if kind.__name__ == "MPC":
            after = bends[k] + a @ (stages[k] - bends[k]) + b * x[k]
        else:
            after = step(stages[k], x[k], v, kappa[k])[0].full().ravel()
        np.testing.assert_allclose(stages[k + 1], after, atol=1e-6)
    assert np.abs(stages[:, 0]).max() > 0.1


def test_the_path_ahead_is_read_where_the_pace_of_its_bends_gets_to() -> None:
    """Against NumPy's interpolation, on a path that winds ever tighter."""
    block = controller()
    preview = 0.1 * np.linspace(0.0, 1.0, block.preview_points) ** 2
    u = inputs(block, v=4.2)._replace(preview=tuple(preview.tolist()))
    v, _, then = block._ahead(block.X((0.0,) * block.pieces, (0.0,) * block.horizon, 0.0), u)
    half = 0.5 * block.dt / block.model.steady(v, preview)[:, 6]
    knots = 2.0 * np.cumsum(half) - half - half[0]
    expected = np.interp(block.times, knots, preview)
    np.testing.assert_allclose(then[:, 6], expected, atol=1e-12)
    assert np.ptp(np.diff(knots)) > 1e-4


def test_steady_cornering_between_tabled_curvatures_is_linear() -> None:
    model = controller().model
    i, t = model.place(5.1)
    middle = CURVES // 2
    table = model.cornering.reshape(len(SPEEDS), CURVES, 7)
    between = (1.0 - t) * table[int(i)] + t * table[int(i) + 1]
    for place in (0.0, 0.25, 3.5, -7.75):
        low = int(np.floor(middle + place))
        part = middle + place - low
        expected = (1.0 - part) * between[low] + part * between[low + 1]
        np.testing.assert_allclose(model.steady(5.1, np.array([place * KAPPA_STEP]))[0], expected, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_one_function_of_several_is_chosen(count: int) -> None:
    x = casadi.SX.sym("x")
    choice = chosen("choice", [casadi.Function(f"f{i}", [x], [x + 10.0 * i]) for i in range(count)])
    assert [float(choice(i, 1.0)) for i in range(count)] == [1.0 + 10.0 * i for i in range(count)]
