"""Degrees and radians."""

import math

import numpy as np
import pytest
import scipy.constants

from steerkit.diagram.units import FACTORS, degrees_of, radians_of


def test_a_degree_is_that_of_the_tables_and_there_and_back_is_nothing() -> None:
    assert radians_of(1.0) == scipy.constants.degree
    assert radians_of(180.0) == math.pi
    assert degrees_of(math.pi) == 180.0
    angles = np.linspace(-720.0, 720.0, 97)
    np.testing.assert_allclose(degrees_of(radians_of(angles)), angles, rtol=1e-15)


@pytest.mark.parametrize(
    ("kind", "unit", "many", "si"),
    [
        ("s", "min", 2.0, 120.0),
        ("s", "ms", 250.0, 0.25),
        ("s", "us", 500.0, 5e-4),
        ("s", "ns", 500.0, 5e-7),
        ("rad/s", "deg/s", 180.0, math.pi),
        ("rad/s", "mrad/s", 20.0, 0.02),
        ("m", "km", 3.0, 3000.0),
        ("m", "cm", 50.0, 0.5),
        ("m", "mm", 50.0, 0.05),
        ("m/s", "km/h", 36.0, 10.0),
        ("m/s", "mph", 100.0, 44.704),
        ("m/s", "kn", 36.0, 18.52),
        ("m/s^2", "g", 2.0, 19.6133),
    ],
)
def test_what_a_files_units_are_in_si(kind: str, unit: str, many: float, si: float) -> None:
    assert many * FACTORS[kind][unit] == pytest.approx(si)
    assert FACTORS[kind][kind] == 1.0
