"""Cars out: what other programs make of the numbers is the same car."""

from dataclasses import replace

import numpy as np
import pytest

from steerkit.export.car import commonroad, opendbc
from steerkit.vehicles import G, vehicle


def test_a_commonroad_set_holds_the_same_axle_forces() -> None:
    """mu C m g l_r/L at the front, l_f/L at the rear; a car of one coefficient comes back whole."""
    yaml = pytest.importorskip("ruamel.yaml").YAML(typ="safe")
    car = vehicle("vw-passat")
    load = float(car.m) * G / float(car.wheelbase)
    even = replace(car, c_f=20.0 * car.mu * load * car.l_r, c_r=20.0 * car.mu * load * car.l_f)
    data = yaml.load(commonroad(even))
    coefficient = -data["tire"]["p_ky1"] / data["tire"]["p_dy1"]
    assert coefficient == pytest.approx(20.0, rel=1e-12)
    assert (data["a"], data["b"], data["m"], data["I_z"]) == (even.l_f, even.l_r, even.m, even.i_z)
    assert data["steering"]["max"] == -data["steering"]["min"] == pytest.approx(even.delta_sw_max / even.steer_ratio)
    front = float(car.c_f) / (float(car.mu) * load * float(car.l_r))
    assert f"front {front:.6g}" in commonroad(car)


def test_a_row_of_opendbc_names_the_same_numbers() -> None:
    car = vehicle("vw-passat")
    row = opendbc(car, delay=0.2)
    assert row["wheelbase"] == car.l_f + car.l_r
    assert (row["centerToFront"], row["tireStiffnessFront"], row["steerRatio"]) == (car.l_f, car.c_f, car.steer_ratio)
    assert row["steerActuatorDelay"] == 0.2
    assert "steerActuatorDelay" not in opendbc(car)
    with pytest.raises(ValueError, match="a batch of cars"):
        opendbc(replace(car, m=np.array([1500.0, 1600.0])))
