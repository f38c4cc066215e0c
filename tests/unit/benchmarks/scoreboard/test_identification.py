"""Nonlinear least squares as others have it, and errors of a model that is the truth."""

from itertools import islice

import numpy as np
import pytest

from benchmarks.scoreboard.identification import driven, held_out, kinds, least_squares_tyres, recorded


def test_without_noise_least_squares_finds_the_car_and_the_truth_has_no_error() -> None:
    for kind in islice(kinds(0), 1, 3):
        assert kind.theta is not None
        true = driven(kind, 0, 20.0)
        one, second = held_out(kind.vehicle, kind.theta, true)
        assert max(*one, *second) < 1e-4
        ratio = float(kind.vehicle.steer_ratio)
        found = least_squares_tyres(kind.vehicle, recorded(true, 0.0, 0, ratio), filtered=False)
        noisy = least_squares_tyres(kind.vehicle, recorded(true, 0.1, 0, ratio), filtered=False)
        assert found["c_f"] == pytest.approx(kind.theta["c_f"], rel=0.1)
        assert np.all(held_out(kind.vehicle, noisy, true)[0] > held_out(kind.vehicle, found, true)[0])
