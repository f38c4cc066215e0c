"""A sample's programme gives the same by parts, in one call of C, and without a compiler."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit._support import native
from steerkit.controllers.mpc.block import PredictiveSteering
from steerkit.controllers.mpc.programme import NOTHING, PREDICTION, SOLUTION, found
from tests.support.predictive import controller, driven, inputs, kinds

CASES: list[dict[str, float]] = [
    {"e": 0.02},
    {"e": 0.7, "psi_e": -0.1, "r": 0.2, "beta": 0.03, "kappa": -0.02},
    {"e": -0.4, "v": 0.6, "delta_sw_meas": 1.0, "kappa": 0.2},
    {"e": 0.1, "v": 30.0, "kappa": 0.4},
]


def question(block: PredictiveSteering, wanted: float, **values: float) -> Any:
    state = block.X(tuple(0.1 * i for i in range(block.pieces)), tuple(0.02 * i for i in range(block.horizon)), 0.0)
    return block._asked(state, inputs(block, **values), wanted)


@kinds
@pytest.mark.parametrize("values", CASES)
def test_by_parts_and_in_one_call_of_c(kind: Any, values: dict[str, float]) -> None:
    block = controller(kind)
    for wanted in (SOLUTION, PREDICTION, NOTHING):
        asked = question(block, wanted, **values)
        np.testing.assert_array_equal(block.programme(*asked), block.programme.by_parts(*asked))


@kinds
@pytest.mark.parametrize("in_c", [True, False])
def test_what_is_not_wanted_is_not_done(kind: Any, in_c: bool) -> None:
    block = controller(kind)
    run = block.programme if in_c else block.programme.by_parts
    asked = question(block, SOLUTION, e=0.3)
    whole, prediction = found(run(*asked)), found(run(PREDICTION, *asked[1:]))
    assert whole.success == 1.0
    assert whole.iterations >= 1.0
    assert whole.residual <= block.tolerance
    assert prediction.ahead == whole.ahead
    assert {*prediction[:3], *prediction.rates} == {0.0}
    nothing = run(NOTHING, *[math.nan] * (len(asked) - 1))
    assert {*nothing} == {0.0}
    assert len(nothing) == block.programme.size


@kinds
@pytest.mark.parametrize("in_c", [True, False])
def test_a_motion_that_is_not_finite_is_not_solved(kind: Any, in_c: bool) -> None:
    block = controller(kind)
    asked = list(question(block, SOLUTION, e=0.3))
    asked[2] = math.nan  # e
    told = found((block.programme if in_c else block.programme.by_parts)(*asked))
    assert (told.success, told.iterations, told.residual, {*told.rates}) == (0.0, 0.0, math.inf, {0.0})
    again = found(block.programme(*question(block, SOLUTION, e=0.3)))
    assert again.success == 1.0


@kinds
def test_without_a_compiler_commands_are_the_same_to_the_solvers_tolerance(
    kind: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """CasADi's virtual machine prepares the same numbers, and its interface to HPIPM stands around the solver."""
    block = controller(kind)
    bare = replace(block)
    vars(bare)["model"] = block.model  # its tables are not what is tested, and take a while
    samples = [inputs(block, **values) for values in (*CASES, *reversed(CASES))]
    with monkeypatch.context() as without:
        without.setattr(native, "compiler", lambda: None)
        slow = driven(bare, samples)
        assert not bare.qp.in_c
    quick = driven(block, samples)
    assert [y.status for y in slow] == [y.status for y in quick] == [0.0] * len(samples)
    np.testing.assert_allclose([y.delta_sw for y in slow], [y.delta_sw for y in quick], atol=2e-4)
    with pytest.raises(TypeError, match="solver 'hpipm' is not called from C here"):
        _ = bare.programme.native
    for values in CASES:
        asked = question(block, SOLUTION, **values)
        for one in (block, bare):
            one.programme.look(int(asked[1]), asked[2:])
        np.testing.assert_allclose(bare.programme.fresh, block.programme.fresh, rtol=1e-9, atol=1e-9)
