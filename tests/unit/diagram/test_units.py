"""Degrees and radians."""

from __future__ import annotations

import math

import numpy as np
import scipy.constants

from steerkit.diagram.units import degrees_of, radians_of


def test_a_degree_is_that_of_the_tables_and_there_and_back_is_nothing() -> None:
    assert radians_of(1.0) == scipy.constants.degree
    assert radians_of(180.0) == math.pi
    assert degrees_of(math.pi) == 180.0
    angles = np.linspace(-720.0, 720.0, 97)
    np.testing.assert_allclose(degrees_of(radians_of(angles)), angles, rtol=1e-15)
