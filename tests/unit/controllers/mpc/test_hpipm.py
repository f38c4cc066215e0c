"""HPIPM called from C: told only what has changed, it answers as if it had been told all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from steerkit.controllers.mpc import hpipm
from steerkit.controllers.mpc.block import FAILED, FALLBACK, NO_FAULT, SOLVED
from steerkit.controllers.mpc.qp import StageQp
from tests.support.predictive import driven, inputs, kinds, own


def filled(kind: Any, **values: float) -> StageQp:
    block = own(kind)
    driven(block, [inputs(block, **values)])
    return block.qp


@kinds
def test_it_finds_what_casadis_interface_to_it_finds(kind: Any) -> None:
    for values in ({"e": 0.05}, {"e": 0.7, "psi_e": -0.1, "r": 0.2}, {"e": -1.5, "v": 8.0}):
        qp = filled(kind, **values)
        assert qp.direct.solve()[1]
        direct = qp.answer.copy()
        qp._solve_and_check()
        np.testing.assert_allclose(direct[qp.at_u], qp._out["x"][qp.at_u], atol=2e-3)
        np.testing.assert_allclose(direct[qp.place["x"]], qp._out["x"][qp.place["x"]], atol=2e-4)


@kinds
def test_an_answer_owes_nothing_to_those_before_it(kind: Any) -> None:
    """Bit for bit: of what has not changed it is told nothing, and the solver starts anew."""
    qp = filled(kind, e=0.3, kappa=0.02)
    kept = qp.numbers.copy()
    qp.direct.solve()
    first = qp.answer.copy()
    for change in (filled(kind, e=-0.8, v=9.0, psi_e=0.3).numbers.copy(), np.full_like(kept, 1e3)):
        qp.numbers[:] = change
        qp.direct.solve()
        assert np.any(qp.answer != first)
        qp.numbers[:] = kept
        iterations, success = qp.direct.solve()
        assert success
        assert iterations >= 1.0
        np.testing.assert_array_equal(qp.answer, first)


@kinds
def test_every_number_of_a_programme_is_told(kind: Any) -> None:
    """A change of any number that is no bound far away changes the answer, or at least what stands in the solver."""
    qp = filled(kind, e=0.9, psi_e=0.1, v=9.0)
    struct = qp.direct.stages
    places = np.ctypeslib.as_array((hpipm.ctypes.c_longlong * _count(qp)).from_address(struct.from_))
    free = np.concatenate([qp.first[f"{side}bx"] + _unbounded(qp) for side in "lu"])
    uba = qp.first["uba"] + qp.place["gap"].ravel()  # equal to lba
    eyes = qp.first["a"] + qp.place["eye"].ravel()  # the minus in front of the next state
    expected = set(range(len(qp.numbers))) - set(free.tolist()) - set(uba.tolist()) - set(eyes.tolist())
    assert set(places.tolist()) == expected


def _count(qp: StageQp) -> int:
    parts = (hpipm.Part * qp.direct.stages.sets).from_address(qp.direct.stages.set)
    return int(parts[-1].first + parts[-1].size)


def _unbounded(qp: StageQp) -> np.ndarray:
    z = np.arange(qp.size[0])
    return np.setdiff1d(z, np.concatenate((qp.at_u, qp.place["x"][:, 5])))


@kinds
def test_a_programme_that_it_cannot_solve_is_no_success(kind: Any) -> None:
    qp = filled(kind, e=0.1)
    kept = qp.numbers.copy()
    qp.data["lbx"][qp.at_u], qp.data["ubx"][qp.at_u] = 5.0, -5.0
    iterations, success = qp.direct.solve()
    qp.numbers[:] = kept
    assert not success
    assert iterations > 1.0
    assert qp.direct.solve()[1]


def test_one_that_runs_out_of_iterations_is_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(hpipm._OPTIONS, "iter_max", 3)
    block = own()
    states: list[dict[str, float]] = [{"e": 1e-4, "kappa": 0.0}, {"e": 0.9, "psi_e": 0.1}]
    easy, hard = (driven(block, [inputs(block, **values)])[0] for values in states)
    assert (easy.status, easy.fault) == (SOLVED, NO_FAULT)
    assert (hard.status, hard.fault, hard.iterations) == (FALLBACK, FAILED, 3.0)
    assert block.qp.direct.solve() == (3.0, False)
