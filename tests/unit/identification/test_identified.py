"""What was identified predicts other drives and comes back from its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from steerkit.controllers.stanley import Stanley
from steerkit.identification import Drive
from steerkit.identification.identified import Identified, Simulator, predict, stiffnesses
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.steering_actuator import steering_of
from steerkit.scenario import Scenario
from steerkit.vehicles import vehicle
from tests.support.recorded_cars import BASE, driven


def test_held_out_drive(found: Identified) -> None:
    other = Drive.of(driven(seconds=40.0, v_low=6.0, v_high=15.0))
    seen = found.predict(other)
    assert seen.rms < 0.002
    shifted = found.predict(replace(other, delta_sw=other.delta_sw + 0.05))
    assert shifted.rms > 3.0 * seen.rms
    assert shifted.zero_shift == pytest.approx(-0.05, abs=0.02)
    assert shifted.rms_rezeroed < 1.5 * seen.rms + 1e-3


def test_the_zero_of_a_gyroscope_is_predicted_too_unless_it_is_calibrated(found: Identified) -> None:
    theta = found.theta | {"rate_zero": 0.01}
    calibrated, raw = (
        predict(Simulator(replace(found.drive, calibrated=zeroed), found.base), theta).r for zeroed in (True, False)
    )
    assert raw - calibrated == pytest.approx(0.01)


def test_the_vehicle_file_comes_back_and_drives(found: Identified, tmp_path: Path) -> None:
    file = tmp_path / "my-car.toml"
    found.save(file, command="steerkit identify lap", held_out=found.fit)
    assert vehicle(str(file)) == found.vehicle
    motor = steering_of(file)
    assert motor.delay + motor.lag == pytest.approx(found.theta["delay"] + found.theta["lag"] - 0.01, abs=1e-12)
    assert motor.offset == found.theta["offset"]
    for block in (LinearSingleTrack(vehicle=vehicle(str(file))), NonlinearSingleTrack(vehicle=vehicle(str(file)))):
        assert block.vehicle.c_f == found.vehicle.c_f
    assert Stanley.of(vehicle(str(file)))
    text = file.read_text()
    for words in ("[provenance]", 'log = "lap"', "held_out_rms", 'source = "log"', 'command = "steerkit identify lap"'):
        assert words in text
    with pytest.raises(ValueError, match=r"a vehicle file ends in \.toml"):
        found.save(tmp_path / "car.json")


def test_a_vehicle_file_serves_a_scenario(found: Identified, tmp_path: Path) -> None:
    found.save(tmp_path / "car.toml")
    assert Scenario(vehicle=str(tmp_path / "car.toml")).nominal == found.vehicle


def test_stiffnesses_and_gradient_are_the_vehicles_own() -> None:
    c_f, c_r = stiffnesses(BASE, 0.007, 0.004)
    assert replace(BASE, c_f=c_f, c_r=c_r).understeer_gradient == pytest.approx(0.003, rel=1e-12)
