"""The loop that is fitted is the plants' own."""

from __future__ import annotations

from dataclasses import replace

import pytest

from steerkit.identification.model import stiffnesses
from tests.support.recorded_cars import BASE


def test_stiffnesses_and_gradient_are_the_vehicles_own() -> None:
    c_f, c_r = stiffnesses(BASE, 0.007, 0.004)
    assert replace(BASE, c_f=c_f, c_r=c_r).understeer_gradient == pytest.approx(0.003, rel=1e-12)
