"""A quantity is read out of an estimator's outputs by its name, with its interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from steerkit.diagram.block import Block, Out
from steerkit.estimators.estimate import Estimated, estimated


@dataclass(frozen=True, eq=False, kw_only=True)
class Known(Block):
    """Two numbers, one of which is an estimate."""

    ratio = Out("1", direct=())
    ratio_deviation = Out("1", direct=())
    ratio_valid = Out("1", direct=())
    missing = Out("1", direct=())

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(15.0, 0.5, 1.0, 0.0)


def test_a_quantity_is_what_comes_with_deviation_and_validity() -> None:
    block = Known()
    assert estimated(block.output(0.0, (), ()), "ratio") == Estimated(15.0, 0.5, 1.0)


def test_an_unknown_quantity_is_answered_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"estimate 'missing' is not known; valid: ratio"):
        estimated(Known().output(0.0, (), ()), "missing")


def test_the_interval_holds_95_percent() -> None:
    got = Estimated(np.array([1.0, 2.0]), np.array([0.1, 0.2]), np.ones(2))
    share = norm.cdf(got.high, got.value, got.deviation) - norm.cdf(got.low, got.value, got.deviation)
    np.testing.assert_allclose(share, 0.95, atol=1e-4)
