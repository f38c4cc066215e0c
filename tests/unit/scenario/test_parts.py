"""What a scenario is made of, when its steering is worn and its sensors are poor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from steerkit.plants.poor_sensors import PoorSensors
from steerkit.plants.sensors import Sensors
from steerkit.plants.steering_column import SteeringColumn
from steerkit.plants.steering_link import SteeringLink
from steerkit.scenario import Scenario
from steerkit.scenario.drive import assembled, controller, drive
from steerkit.units import degrees_of, radians_of

PLAIN = Scenario()


def test_what_is_not_there_is_left_out() -> None:
    assert (PLAIN.link(), PLAIN.column(), PLAIN.sensors(0)) == (None, None, None)
    loop = assembled(PLAIN, controller("stanley", PLAIN))
    assert not {"link", "column"} & set(loop.names)


def test_fields_become_blocks() -> None:
    worn = Scenario(play_deg=2.0, friction_deg=1.0, dead_band_deg=0.5, quantum_deg=0.1, delay_jitter=0.03)
    link, column = worn.link(seed=7), worn.column()
    assert isinstance(link, SteeringLink)
    assert isinstance(column, SteeringColumn)
    assert (link.quantum, link.dead_band) == (radians_of(0.1), radians_of(0.5))
    assert (link.jitter, link.seed) == (0.03, 7)
    assert (column.play, column.friction) == (radians_of(2.0), radians_of(1.0))
    assert worn.random
    assert not replace(worn, delay_jitter=0.0, v_min=5.0, v_max=5.0).random
    loop = assembled(worn, controller("stanley", worn))
    assert loop.inputs_of("link")["delta_sw_cmd"] == "controller.delta_sw"
    assert loop.inputs_of("actuator")["delta_sw_cmd"] == "link.delta_sw"
    assert loop.inputs_of("column")["delta_sw_in"] == "actuator.delta_sw"
    assert loop.inputs_of("car")["delta_sw_cmd"] == "column.delta_sw"
    assert loop.inputs_of("controller")["delta_sw_meas"] == "column.delta_sw_meas"


def test_controllers_are_told_the_mean_of_a_delay_that_varies() -> None:
    assert Scenario(delay=0.1, latency=0.05, delay_jitter=0.04).belief().delay == pytest.approx(0.17)


def test_real_sensors() -> None:
    real, hard = Scenario.under("real"), Scenario.under("hard")
    assert replace(real, sensing="hard") == hard
    assert isinstance(hard.sensors(3), Sensors)
    sensors = real.sensors(3)
    assert isinstance(sensors, PoorSensors)
    assert (sensors.block.seed, sensors.block.latency, sensors.rear) == (3, 0.05, real.nominal.l_r)
    twice = replace(real, noise=2.0, latency=0.1).sensors(3)
    assert isinstance(twice, PoorSensors)
    assert (twice.block.v_noise, twice.block.latency, twice.jump) == (0.1, 0.1, 0.04)
    assert replace(real, noise=0.0, v_min=5.0, v_max=5.0).random
    with pytest.raises(ValueError, match="sensing 'perfect'; valid: hard, real"):
        Scenario(sensing="perfect")


def test_a_car_with_all_of_it_is_driven_worse_but_driven() -> None:
    """And the loop is in the way that it is wired: the road wheels are within play and friction of the motor."""
    worn = Scenario.under(
        "real", play_deg=2.0, friction_deg=1.0, dead_band_deg=0.5, quantum_deg=0.1, delay_jitter=0.03, rounds=0.2
    )
    log = drive(worn, controller("stanley", worn), seed=1)
    gap = degrees_of(abs(log["car.delta_sw"][1:] - log["actuator.delta_sw"][:-1]))
    assert abs(log["column.delta_sw"] - log["actuator.delta_sw"]).max() == pytest.approx(radians_of(2.0), rel=0.05)
    assert len(gap) > 100
    clean = drive(Scenario(rounds=0.2), controller("stanley", Scenario()), seed=1)
    rms, best = (float(np.sqrt(np.mean(e["path.e"] ** 2))) for e in (log, clean))
    assert best < rms < 0.2
    assert float(abs(log["path.e"]).max()) < 0.5
