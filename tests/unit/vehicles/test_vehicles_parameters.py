"""A car's numbers are checked when they are given."""

import math
from dataclasses import replace

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.vehicles import BMW_320I, VW_PASSAT, G, Vehicle, scaled, vehicle


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(c_f=-1e5), r"Vehicle 'vw-passat': c_f = -100000.0 \[N/rad\], expected .* positive, per axle"),
        (dict(c_r=3446.0), "per radian and not per degree"),
        (dict(steer_ratio=radians_of(15.6)), r"steer_ratio = 0.27.* \[1\], expected 1 to 50; a pure number"),
        (dict(delta_sw_max=520.0), r"delta_sw_max = 520.0 \[rad\], .*radians_of\(520\)"),
        (dict(m=1.6), "c_f = .*expected"),
        (dict(m=math.nan), r"m = nan \[kg\]"),
        (dict(i_z=3e5), r"i_z = 300000.0 \[kg m\^2\], expected .*0.2 to 5 times m l_f l_r"),
        (dict(l_f="1.2"), r"l_f = '1.2', expected a number \[m\]"),
        (dict(mu=np.array([0.9, -0.9])), "mu = .*ice"),
    ],
)
def test_teaching_errors_of_vehicle(change, message):
    with pytest.raises(ValueError, match=message):
        replace(VW_PASSAT, **change)


@pytest.mark.parametrize(("axle", "share"), [("c_f", 0.8), ("c_r", 0.2)])
def test_a_stiffness_is_judged_by_its_own_axles_load(axle, share):
    """A car with four fifths of its weight in front: 2 to 100 times the axle's load."""
    loads = {"c_f": 0.8 * 1500.0 * G, "c_r": 0.2 * 1500.0 * G}
    fine = dict(name="x", m=1500.0, i_z=1500.0, l_f=0.5, l_r=2.0, steer_ratio=15.0)
    fine |= {name: 20.0 * load for name, load in loads.items()}
    load = share * 1500.0 * G
    for times in (2.1, 99.0):
        Vehicle(**fine | {axle: times * load})
    for times in (1.9, 101.0):
        with pytest.raises(ValueError, match=f"{axle} = "):
            Vehicle(**fine | {axle: times * load})


def test_a_car_with_its_weight_and_grip_alike_steers_neutrally():
    """c_f l_f = c_r l_r; less grip in front makes it understeer, more makes it oversteer."""
    neutral = replace(VW_PASSAT, c_f=1e5 / VW_PASSAT.l_f, c_r=1e5 / VW_PASSAT.l_r)
    assert neutral.understeer_gradient == pytest.approx(0.0, abs=1e-12)
    assert replace(neutral, c_f=0.9 * neutral.c_f).understeer_gradient > 1e-4
    assert replace(neutral, c_f=1.1 * neutral.c_f).understeer_gradient < -1e-4


def test_named_cars():
    assert vehicle("vw-passat") is vehicle("VW Passat") is vehicle("vw_passat") is VW_PASSAT
    assert isinstance(BMW_320I, Vehicle)
    assert VW_PASSAT.wheelbase == pytest.approx(2.71)
    with pytest.raises(ValueError, match=r"'pasat' is not known \(did you mean 'vw-passat'\?\); valid: vw-passat, bmw"):
        vehicle("pasat")


@pytest.mark.parametrize(("m", "wheelbase"), [(1462.0, 2.7), (1639.0, 2.71), (900.0, 2.3)])
def test_a_scaled_car_has_the_measured_ones_stiffness_for_its_load(m, wheelbase):
    """m 1462, l_f = 0.4 L, c_f 192150, c_r 202500, i_z 2500; the scaled one's centre of gravity is at 0.45 L."""
    car = scaled("x", m=m, wheelbase=wheelbase)
    assert (car.l_f, car.l_r) == (pytest.approx(0.45 * wheelbase), pytest.approx(0.55 * wheelbase))
    assert car.c_f / (m * 0.55) == pytest.approx(192150.0 / (1462.0 * 0.6))
    assert car.c_r / (m * 0.45) == pytest.approx(202500.0 / (1462.0 * 0.4))
    assert car.i_z / (m * wheelbase**2) == pytest.approx(2500.0 / (1462.0 * 2.7**2))
