"""The linear car against CommonRoad's single-track model, at zero acceleration and a held steering angle."""

import numpy as np
import pytest

pytest.importorskip("vehiclemodels")

from steerkit.plants.single_track import LinearSingleTrack
from steerkit.vehicles import BMW_320I, FORD_ESCORT


def theirs(car):
    from vehiclemodels.parameters_vehicle1 import parameters_vehicle1
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

    return {"ford-escort": parameters_vehicle1, "bmw-320i": parameters_vehicle2}[car.name]()


@pytest.mark.parametrize("car", [BMW_320I, FORD_ESCORT], ids=lambda car: car.name)
def test_parameters(car):
    p = theirs(car)
    assert (car.m, car.i_z, car.l_f, car.l_r, car.mu) == (p.m, p.I_z, p.a, p.b, p.tire.p_dy1)
    stiffness = -p.tire.p_ky1 / p.tire.p_dy1
    assert car.c_f == pytest.approx(car.mu * stiffness * car.m * 9.81 * car.l_r / car.wheelbase, rel=1e-14)
    assert car.c_r == pytest.approx(car.mu * stiffness * car.m * 9.81 * car.l_f / car.wheelbase, rel=1e-14)


@pytest.mark.parametrize("car", [BMW_320I, FORD_ESCORT], ids=lambda car: car.name)
def test_right_hand_side(car):
    from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

    p, plant, random = theirs(car), LinearSingleTrack(vehicle=car), np.random.default_rng(1)
    for _ in range(200):
        v = float(random.uniform(3.0, 40.0))
        x, y, psi, beta, r, delta = random.uniform(-0.6, 0.6, 6).tolist()
        dx, dy, _, dv, dpsi, dr, dbeta = vehicle_dynamics_st([x, y, delta, v, psi, r, beta], [0.0, 0.0], p)
        assert dv == 0.0
        ours = plant.rhs((x, y, psi, beta, r), delta, v)
        assert ours == pytest.approx((dx, dy, dpsi, dbeta, dr), rel=1e-12, abs=1e-12)
