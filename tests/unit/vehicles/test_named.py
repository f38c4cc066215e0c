"""Cars by name."""

import pytest

from steerkit.vehicles import BMW_320I, FORD_ESCORT, VW_PASSAT, G, Vehicle, scaled, vehicle


def test_named_cars():
    assert vehicle("vw-passat") is vehicle("VW Passat") is vehicle("vw_passat") is VW_PASSAT
    assert isinstance(BMW_320I, Vehicle)
    assert VW_PASSAT.wheelbase == pytest.approx(2.71)
    with pytest.raises(ValueError, match=r"'pasat' is not known \(did you mean 'vw-passat'\?\); valid: vw-passat, bmw"):
        vehicle("pasat")
    with pytest.raises(ValueError, match="'zzz' is not known; valid: vw-passat"):
        vehicle("zzz")


@pytest.mark.parametrize("car", [BMW_320I, FORD_ESCORT], ids=lambda car: car.name)
def test_commonroads_cars_have_its_tyre_on_both_axles(car):
    """Stiffness over the axle's load is the tyre's p_ky1 = 21.92, in front and behind."""
    assert car.c_f / (car.m * G * car.l_r / car.wheelbase) == pytest.approx(21.92)
    assert car.c_r / (car.m * G * car.l_f / car.wheelbase) == pytest.approx(21.92)


@pytest.mark.parametrize(("m", "wheelbase"), [(1462.0, 2.7), (1639.0, 2.71), (900.0, 2.3)])
def test_a_scaled_car_has_the_measured_ones_stiffness_for_its_load(m, wheelbase):
    """m 1462, l_f = 0.4 L, c_f 192150, c_r 202500, i_z 2500; the scaled one's centre of gravity is at 0.45 L."""
    car = scaled("x", m=m, wheelbase=wheelbase)
    assert (car.l_f, car.l_r) == (pytest.approx(0.45 * wheelbase), pytest.approx(0.55 * wheelbase))
    assert car.c_f / (m * 0.55) == pytest.approx(192150.0 / (1462.0 * 0.6))
    assert car.c_r / (m * 0.45) == pytest.approx(202500.0 / (1462.0 * 0.4))
    assert car.i_z / (m * wheelbase**2) == pytest.approx(2500.0 / (1462.0 * 2.7**2))
