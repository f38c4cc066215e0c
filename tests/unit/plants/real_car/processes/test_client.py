"""The car's block says that it is one car."""

from __future__ import annotations

import pytest

from steerkit.plants.real_car.processes.client import RealCar, ReplayLink


def test_a_car_that_is_traced_or_batched_says_so() -> None:
    import casadi

    car = RealCar(link=ReplayLink([]))
    with pytest.raises(TypeError, match="one car"):
        car.init((3,))
    with pytest.raises(TypeError, match="cannot be traced"):
        car.output(casadi.SX.sym("t"), (), ())
    assert not car.pure
