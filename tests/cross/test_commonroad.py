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


def test_drive_through_a_slalom():
    from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

    car, p = BMW_320I, theirs(BMW_320I)
    plant = LinearSingleTrack(vehicle=car, v0=7.0)
    x, z = plant.init(), np.zeros(7)
    z[3] = 7.0
    for k in range(300):
        delta = 0.05 * np.sign(np.sin(0.03 * k)).item()
        x = plant.update(0.0, x, plant.U(delta * car.steer_ratio, 7.0), None)
        z[2] = delta
        k1, h = np.array(vehicle_dynamics_st(z, [0.0, 0.0], p)), plant.dt
        k2 = np.array(vehicle_dynamics_st(z + 0.5 * h * k1, [0.0, 0.0], p))
        k3 = np.array(vehicle_dynamics_st(z + 0.5 * h * k2, [0.0, 0.0], p))
        k4 = np.array(vehicle_dynamics_st(z + h * k3, [0.0, 0.0], p))
        z = z + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    assert x[:5] == pytest.approx(z[[0, 1, 4, 6, 5]], rel=1e-10, abs=1e-11)
    assert abs(x.y) > 1.0
