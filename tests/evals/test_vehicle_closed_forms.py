"""The cars against closed forms: steady curves, circles, the matrix exponential, tyre limits, integration order."""

import math
import re
from dataclasses import replace

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from steerkit.plants.single_track import V_DYNAMIC, V_KINEMATIC, LinearSingleTrack, NonlinearSingleTrack, fiala
from steerkit.vehicles import VEHICLES, VW_PASSAT, G, Vehicle

PLANTS = [LinearSingleTrack, NonlinearSingleTrack]
CARS = pytest.mark.parametrize("car", VEHICLES.values(), ids=VEHICLES)


def driven(plant, delta_sw, v, seconds, x=None):
    """States at every sample under constant inputs."""
    x = plant.init() if x is None else x
    u = plant.U(delta_sw, v)
    states = [x]
    for _ in range(round(seconds / plant.dt)):
        x = plant.update(0.0, x, u, None)
        states.append(x)
    return states


def out(plant, x):
    return plant.output(0.0, x, plant.D())


@CARS
@pytest.mark.parametrize("v", [3.0, 5.0, 9.0, 20.0])
def test_steady_curve_of_the_linear_car(car, v):
    plant = LinearSingleTrack(vehicle=car, v0=v)
    delta = 0.02
    y = out(plant, driven(plant, delta * car.steer_ratio, v, 12.0)[-1])
    bend = delta / (car.wheelbase + car.understeer_gradient * v * v)
    assert y.r == pytest.approx(v * bend, rel=1e-9)
    assert y.beta == pytest.approx(bend * (car.l_r - car.m * car.l_f * v * v / (car.c_r * car.wheelbase)), rel=1e-8)
    assert y.a_y == pytest.approx(v * v * bend, rel=1e-8)


@pytest.mark.parametrize("cls", PLANTS)
@pytest.mark.parametrize("delta", [-0.5, 0.1, 0.55])
def test_kinematic_circle_at_walking_pace(cls, delta):
    plant = cls(vehicle=VW_PASSAT)
    states = driven(plant, delta * VW_PASSAT.steer_ratio, 0.9, 40.0)[200:]
    at = np.array([s[:2] for s in states])
    psi = states[0].psi
    # the rear axle's centre runs round the turning centre, at L/tan(delta) to its left
    side = VW_PASSAT.wheelbase / math.tan(delta)
    forward, left = np.array([math.cos(psi), math.sin(psi)]), np.array([-math.sin(psi), math.cos(psi)])
    centre = at[0] - VW_PASSAT.l_r * forward + side * left
    radius = math.hypot(VW_PASSAT.l_r, side)
    assert np.hypot(*(at - centre).T) == pytest.approx(np.full(len(at), radius), abs=1e-6)


@CARS
@pytest.mark.parametrize("v", [0.0, 0.7, 2.0, 3.0, 7.5, 30.0])
def test_linear_car_follows_the_matrix_exponential(car, v):
    plant = LinearSingleTrack(vehicle=car, dt=0.01, substeps=8)
    (row1, row2), (b1, b2) = plant.matrices(v)
    block = np.zeros((3, 3))
    block[:2] = [[*row1, b1], [*row2, b2]]
    delta = 1e-4  # small: the kinematic share is nonlinear in delta
    exact = expm(block * 0.5) @ [0.0, 0.0, delta]
    x = driven(plant, delta * car.steer_ratio, v, 0.5)[-1]
    assert x[3:5] == pytest.approx(exact[:2], rel=1e-6, abs=1e-13)


def fastest(plant):
    """Largest |eigenvalue|*step over all speeds; the amplification of a Runge-Kutta step must stay below 1."""
    speeds = np.linspace(0.0, 40.0, 401)
    z = [np.linalg.eigvals(np.array(plant.matrices(v)[0])) * plant.dt / plant.substeps for v in speeds.tolist()]
    assert max(abs(1.0 + s + s**2 / 2.0 + s**3 / 6.0 + s**4 / 24.0).max() for s in z) < 1.0
    return max(abs(s).max() for s in z)


@settings(max_examples=30)
@given(
    l_f=st.floats(0.8, 2.0),
    l_r=st.floats(0.8, 2.0),
    grip_f=st.floats(5.0, 60.0),
    margin=st.floats(0.8, 1.0),
    inertia=st.floats(0.6, 2.0),
)
def test_any_understeering_car_that_is_accepted_is_stable(l_f, l_r, grip_f, margin, inertia):
    load = 1500.0 * G / (l_f + l_r)
    car = Vehicle(
        name="any",
        m=1500.0,
        i_z=inertia * 1500.0 * l_f * l_r,
        l_f=l_f,
        l_r=l_r,
        c_f=margin * grip_f * load * l_r,
        c_r=grip_f * load * l_f,
        steer_ratio=16.0,
    )
    with pytest.raises(ValueError, match=r"dt = 1\.0 \[s\], expected .*raise substeps") as error:
        LinearSingleTrack(vehicle=car, dt=1.0)
    longest = float(re.search(r"to ([0-9.e-]+);", str(error.value))[1])
    assert fastest(LinearSingleTrack(vehicle=car, dt=0.999 * longest)) < 2.6


@CARS
@pytest.mark.parametrize("v", [0.5, 1.7, 3.0, 7.5, 40.0])
def test_nonlinear_car_about_straight_driving_is_the_linear_one(car, v):
    x, delta = casadi.SX.sym("x", 5), casadi.SX.sym("delta")
    rate = casadi.vertcat(*NonlinearSingleTrack(vehicle=car).rhs(casadi.vertsplit(x), delta, v))
    slopes = casadi.Function("j", [x, delta], [casadi.jacobian(rate[3:], casadi.vertcat(x[3:], delta))])
    found = np.array(slopes(np.zeros(5), 0.0))
    ((a11, a12), (a21, a22)), (b1, b2) = LinearSingleTrack(vehicle=car).matrices(v)
    assert found == pytest.approx(np.array([[a11, v * a12, v * b1], [a21 / v, a22, b2]]), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("cls", PLANTS)
def test_runge_kutta_is_of_fourth_order(cls):
    def end(substeps):
        # from inside a curve: no slip angle changes its sign, where the tyre's curve has a kink
        plant = cls(vehicle=VW_PASSAT, dt=0.04, substeps=substeps)
        x = plant.init()._replace(sway=-0.01 if cls is LinearSingleTrack else -0.06, r=0.3)
        return np.array(driven(plant, 2.0, 6.0, 0.2, x)[-1][:5])

    exact = end(256)
    errors = [np.abs(end(n) - exact).max() for n in (4, 8, 16)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert errors[0] < 1e-4
    assert ((orders > 3.7) & (orders < 4.4)).all(), (errors, orders)


@pytest.mark.parametrize("cls", PLANTS)
@pytest.mark.parametrize("v", [V_KINEMATIC, V_DYNAMIC])
def test_blend_is_smooth_in_speed(cls, v):
    plant = cls(vehicle=VW_PASSAT)
    x, step = (0.0, 0.0, 0.3, 0.05, 0.2), 1e-6
    below, at, above = (np.array(plant.rhs(x, 0.1, s)) for s in (v - step, v, v + step))
    assert below == pytest.approx(above, abs=5e-3)
    kink = (above - at) - (at - below)
    assert np.abs(kink).max() / step < 1e-3


@pytest.mark.parametrize("cls", PLANTS)
def test_a_car_at_rest_stays_where_it_is(cls):
    plant = cls(vehicle=VW_PASSAT, x0=3.0, y0=-2.0, psi0=1.0)
    for x in driven(plant, 9.0, 0.0, 5.0):
        assert x[:3] == (3.0, -2.0, 1.0)
        assert x.r == 0.0
        assert all(map(math.isfinite, out(plant, x)))


@pytest.mark.parametrize("cls", PLANTS)
def test_a_y_is_the_acceleration_of_the_centre_of_gravity(cls):
    plant = cls(vehicle=VW_PASSAT, dt=1e-3)
    states = driven(plant, 2.0, 6.0, 0.3)
    p = np.array([s[:2] for s in states])
    acceleration = (p[2:] - 2.0 * p[1:-1] + p[:-2]) / plant.dt**2
    for k in (30, 100, 250):  # while it still builds up
        y = out(plant, states[k + 1])
        across = y.psi + (y.beta if cls is LinearSingleTrack else 0.0)  # of the velocity; of the car's axis
        found = acceleration[k] @ [-math.sin(across), math.cos(across)]
        assert found == pytest.approx(y.a_y, rel=2e-3)
        assert abs(found - y.v * y.r) > 0.02 or k > 30  # v*r alone is not it


def test_fiala_tyre():
    c, grip = 2e5, 8e3
    slide = 3.0 * grip / c
    assert fiala(1e-9, c, grip) / 1e-9 == pytest.approx(c, rel=1e-6)
    assert fiala(slide, c, grip) == grip == fiala(50.0, c, grip)
    z = np.linspace(0.0, 1.0, 101)
    published = c * z * slide - c**2 / (3.0 * grip) * (z * slide) ** 2 + c**3 / (27.0 * grip**2) * (z * slide) ** 3
    assert fiala(z * slide, c, grip) == pytest.approx(published, rel=1e-12)
    assert (np.diff(fiala(z * slide, c, grip)) > 0.0).all()
    assert fiala(-z, c, grip) == pytest.approx(-fiala(z, c, grip), rel=1e-15)


@given(
    v=st.floats(3.0, 40.0),
    v_y=st.floats(-20.0, 20.0),
    r=st.floats(-5.0, 5.0),
    delta_sw=st.floats(-9.0, 9.0),
    mu=st.floats(0.05, 1.5),
)
def test_friction_limits_lateral_acceleration(v, v_y, r, delta_sw, mu):
    plant = NonlinearSingleTrack(vehicle=replace(VW_PASSAT, mu=mu))
    y = out(plant, plant.init()._replace(sway=v_y, r=r, v=v, delta_sw=delta_sw))
    assert abs(y.a_y) <= mu * G * (1.0 + 1e-12) + 1e-12 * (v + abs(v_y)) * abs(r) * 10.0


def test_friction_is_used_up_when_the_car_slides_out():
    plant = NonlinearSingleTrack(vehicle=VW_PASSAT)
    a_y = [out(plant, x).a_y for x in driven(plant, 3.0, 20.0, 3.0)]
    assert 0.9 * VW_PASSAT.mu * G < max(a_y) <= VW_PASSAT.mu * G * (1.0 + 1e-12)
