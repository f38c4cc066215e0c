"""The cost to go: its equation, a case solved by hand, and that what is remembered is nobody else's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.controllers.riccati import cost_to_go

A = np.array([[1.0, 0.05], [0.0, 0.9]])
B = np.array([0.001, 0.05])


def test_the_golden_ratio() -> None:
    """x+ = x + u at cost x^2 + u^2: P = 1 + P - P^2/(1 + P), so P^2 = P + 1."""
    one = np.eye(1)
    assert cost_to_go(one, one[0], one, 1.0) == pytest.approx(np.array([[0.5 * (1.0 + math.sqrt(5.0))]]), rel=1e-12)


@given(e=st.floats(0.1, 10.0), rate=st.floats(0.0, 10.0), r=st.floats(1e-3, 1e3))
def test_it_solves_the_riccati_equation(e: float, rate: float, r: float) -> None:
    q = np.diag([e, rate])
    p = cost_to_go(A, B, q, r)
    gain = (B @ p @ A) / (r + B @ p @ B)
    assert p == pytest.approx(q + A.T @ p @ A - np.outer(A.T @ p @ B, gain), rel=1e-8, abs=1e-9)
    assert np.abs(np.linalg.eigvals(A - np.outer(B, gain))).max() < 1.0


def test_each_system_weight_and_effort_has_its_own_and_writing_into_it_changes_no_other() -> None:
    q = np.eye(2)
    first = cost_to_go(A, B, q, 1.0)
    kept = first.copy()
    first[:] = 0.0
    assert (cost_to_go(A, B, q, 1.0) == kept).all()
    for other in ((A.T.copy(), B), (A, 2.0 * B)):
        assert (cost_to_go(*other, q, 1.0) != kept).any()
    assert (cost_to_go(A, B, 2.0 * q, 1.0) != kept).any()
    assert (cost_to_go(A, B, q, 2.0) != kept).any()


def test_a_transposed_view_is_read_as_it_looks() -> None:
    """An array's bytes in memory may be in another order than its rows."""
    assert (cost_to_go(A.T, B, np.eye(2), 1.0) == cost_to_go(A.T.copy(), B, np.eye(2), 1.0)).all()
