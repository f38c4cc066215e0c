"""The fleet: what its table says, names, and cars drawn by seed."""

from collections import Counter

import pytest

from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.vehicles import drawn_car, fleet, vehicle


def test_a_row_is_a_car() -> None:
    """HONDA_ODYSSEY, as opendbc has it."""
    member = fleet()["honda-odyssey"]
    car = member.vehicle
    assert (car.m, car.wheelbase, car.l_f, car.steer_ratio) == (2036.0, pytest.approx(3.0), 1.23, 14.35)
    assert (car.i_z, car.c_f, car.c_r, car.mu) == (4298.0, 215767.0, 237024.0, 0.9)
    assert (member.steer_delay, member.slowest, member.interface) == (0.1, 0.0, "torque")
    assert fleet()["ram-1500-5th-gen"].slowest == 14.5


def test_what_is_known_of_the_whole_fleet() -> None:
    cars = fleet()
    assert len(cars) == 243
    assert all(name == car.vehicle.name for name, car in cars.items())
    assert Counter(car.interface for car in cars.values()) == {"torque": 219, "angle": 24}
    delays = [car.steer_delay for car in cars.values()]
    assert (min(delays), max(delays)) == (0.07, 0.5)
    assert delays.count(0.1) > 0.5 * len(delays)
    assert all(car.vehicle.understeer_gradient > 0.0 for car in cars.values())
    for car in cars.values():
        NonlinearSingleTrack(vehicle=car.vehicle)  # refuses a car that its samples are too long for


def test_names() -> None:
    assert vehicle("toyota-rav4-prime") is vehicle("Toyota RAV4_Prime") is fleet()["toyota-rav4-prime"].vehicle
    with pytest.raises(
        ValueError, match=r"did you mean 'toyota-rav4-prime'\?\); valid: vw-passat, .*steerkit vehicles"
    ):
        vehicle("toyota-rav4-prim")


def test_a_number_draws_a_car_and_always_the_same() -> None:
    assert vehicle("fleet-17") is vehicle("Fleet 17") is drawn_car(17).vehicle
    assert drawn_car(17).vehicle.name == "toyota-highlander-tss2"
    found = Counter(drawn_car(number).vehicle.name for number in range(243 * 20))
    assert len(found) == 243
    assert max(found.values()) < 20 + 5 * 20**0.5
    for name in ("fleet-", "fleet--1", "fleet-1.5", "fleet-x"):
        with pytest.raises(ValueError, match="is not known"):
            vehicle(name)
    with pytest.raises(ValueError, match="expected a whole number"):
        drawn_car(-1)
