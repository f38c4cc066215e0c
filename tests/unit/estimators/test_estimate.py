"""A quantity is read out of an estimator's outputs by its name, with its interval."""

import numpy as np
import pytest
from scipy.stats import norm

from steerkit.estimators.estimate import Estimated, estimated
from steerkit.estimators.steering_hysteresis import SteeringFriction

Y = SteeringFriction.Y(friction=15.0, friction_deviation=0.5, friction_valid=1.0, missing=0.0)


def test_a_quantity_is_what_comes_with_deviation_and_validity() -> None:
    assert estimated(Y, "friction") == Estimated(15.0, 0.5, 1.0)
    with pytest.raises(ValueError, match=r"estimate 'missing' is not known.*; valid: friction"):
        estimated(Y, "missing")


def test_the_interval_holds_95_percent() -> None:
    got = Estimated(np.array([1.0, 2.0]), np.array([0.1, 0.2]), np.ones(2))
    share = norm.cdf(got.high, got.value, got.deviation) - norm.cdf(got.low, got.value, got.deviation)
    np.testing.assert_allclose(share, 0.95, atol=1e-4)
