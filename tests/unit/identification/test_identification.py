"""The shipped drives give the figures of the documentation; what is identified drives as the car that was recorded."""

from pathlib import Path

import numpy as np
import pytest

from steerkit import simulate
from steerkit.diagram.loop import Loop
from steerkit.identification import identify, read_drive, shipped_drives
from steerkit.identification.fit import Identified
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.speed_driver import Playback
from steerkit.plants.steering_actuator import steering_of
from steerkit.vehicles import vehicle
from tests.support.recorded_cars import BASE, DT, driven


def test_the_shipped_drives_have_the_figures_of_the_docs() -> None:
    """Fitted on one real lap, the other predicted; see docs/identification.md."""
    fit, other = (read_drive(name) for name in shipped_drives())
    assert fit.notes[1].startswith("yaw rate: -0.00519 rad/s")
    answer = identify(fit, BASE)
    seen = answer.predict(other)
    assert answer.fit.rms == pytest.approx(0.0034, abs=2e-4)
    assert seen.rms == pytest.approx(0.0053, abs=4e-4)
    assert seen.rms_rezeroed < 0.005
    assert answer["ratio_wheelbase"].value == pytest.approx(43.2, abs=1.0)


def test_the_identified_loop_drives_as_the_car_that_was_recorded(found: Identified, tmp_path: Path) -> None:
    """File to blocks to simulation, in another loop than the one that was fitted, at another step."""
    found.save(tmp_path / "car.toml")
    truth = driven(seconds=40.0)
    play = Playback(angles=tuple(truth["delta_sw"].tolist()), speeds=tuple(truth["v"].tolist()), dt=DT)
    motor = steering_of(tmp_path / "car.toml", dt=DT, limit=30.0, rate_limit=200.0)
    plant = LinearSingleTrack(vehicle=vehicle(str(tmp_path / "car.toml")), v0=truth["v"][0], dt=DT, substeps=2)
    loop = Loop(
        blocks={"drive": play, "actuator": motor, "car": plant},
        wires=[(play.delta_sw, motor.delta_sw_cmd), (motor.delta_sw, plant.delta_sw_cmd), (play.v, plant.v_cmd)],
    )
    rate = simulate(loop, 40.0)["car.r"]
    error = (rate - truth["r"])[100:]
    assert np.sqrt(np.mean(error**2)) < 0.003
