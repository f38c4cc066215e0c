"""Gradients of a run's cost are those of closed forms and of differences."""

import numpy as np
import pytest

from steerkit.compiled.gradient import gradient
from steerkit.diagram.simulation import simulate
from tests.support.traced_blocks import decay_loop, mixed_loop


def test_gradients_are_those_of_the_closed_form() -> None:
    cost = gradient(decay_loop(), 1.0, parameters=["decay.a"], cost=lambda y: y["decay.x"] ** 2)
    k = np.arange(20)
    for a in (0.5, 0.9, 0.99):
        value, slope = cost([a])
        assert value == pytest.approx(np.mean(a ** (2 * k)), rel=1e-12)
        assert slope[0] == pytest.approx(np.mean(2 * k * a ** (2.0 * k - 1)), rel=1e-12)


def test_gradients_agree_with_differences_where_tables_and_rates_mix() -> None:
    loop = mixed_loop(0.025)
    cost = gradient(loop, 0.5, parameters=["decay.a", "decay.b"], cost=lambda y: y["decay.x"] ** 2)
    p, h = np.array([0.9, 0.3]), 1e-6
    value, slope = cost(p)
    assert value == pytest.approx(float(np.mean(simulate(loop, 0.5)["decay.x"] ** 2)), rel=1e-12)
    steps = h * np.eye(2)
    np.testing.assert_allclose(slope, [(cost(p + d)[0] - cost(p - d)[0]) / (2 * h) for d in steps], rtol=1e-6)
