"""A loop as an FMU: driven by FMPy it gives the numbers of `simulate`, in a Python that knows no steerkit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.export.fmu import export_fmu
from steerkit.paths.courses import course
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.speed_driver import RecordedSpeed, SpeedDriver
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.vehicles import vehicle

CAR = vehicle("vw-passat")
HUMAN, RECORDED = SpeedDriver(seed=4), RecordedSpeed(speeds=(4.0, 6.0, 5.0, 7.0, 4.5), spacing=0.6)
OUTPUTS = ("path.e", "car.x", "car.v", "car.delta_sw", "controller.delta_sw")


def loop(k: float = 2.5, driver: Block = HUMAN) -> Loop:
    path = course("paper")
    return steering_loop(
        car=placed(LinearSingleTrack(vehicle=CAR, v0=5.0), path, s=20.0, e=0.3),
        path=path,
        driver=driver,
        controller=replace(Stanley.of(CAR), k=k),
        actuator=SteeringActuator(delay=0.03),
    )


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_fmu(
        loop(), tmp_path_factory.mktemp("fmu") / "Drive.fmu", outputs=OUTPUTS, parameters=["controller.k"]
    )


@pytest.mark.parametrize("k", [2.5, 1.0])
def test_it_gives_the_numbers_of_simulate(fmu: Path, k: float) -> None:
    result = fmpy.simulate_fmu(str(fmu), stop_time=3.0, output_interval=0.05, start_values={"controller.k": k})
    log = simulate(loop(k), 3.01, every=5)
    np.testing.assert_allclose(result["time"], log.t, atol=1e-12)
    for name in OUTPUTS:
        np.testing.assert_allclose(result[name], log[name], rtol=0, atol=1e-12)


@pytest.fixture(scope="module")
def timed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_fmu(
        loop(driver=RECORDED),
        tmp_path_factory.mktemp("fmu") / "Timed.fmu",
        outputs=OUTPUTS,
        parameters=["controller.k"],
    )


def test_it_knows_the_time(timed: Path) -> None:
    """A human who repeats a record over time: the FMU goes through it as `simulate` does."""
    result = fmpy.simulate_fmu(str(timed), stop_time=3.0, output_interval=0.05)
    log = simulate(loop(driver=RECORDED), 3.01, every=5)
    assert np.ptp(log["car.v"]) > 1.0
    for name in OUTPUTS:
        np.testing.assert_allclose(result[name], log[name], rtol=0, atol=1e-12)


def slave_of(file: Path) -> tuple[Any, dict[str, int]]:
    """A running instance, at its start, and the numbers of its variables."""
    about = fmpy.read_model_description(str(file))
    slave: Any = FMU2Slave(
        guid=about.guid, unzipDirectory=fmpy.extract(str(file)), modelIdentifier=about.coSimulation.modelIdentifier
    )
    slave.instantiate()
    slave.setupExperiment()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave, {v.name: v.valueReference for v in about.modelVariables}


def test_a_state_that_is_restored_brings_its_time_and_its_parameters_back(timed: Path) -> None:
    slave, numbers = slave_of(timed)
    outputs, gain = [numbers[name] for name in OUTPUTS], [numbers["controller.k"]]
    slave.doStep(0.0, 0.7)
    state = slave.getFMUstate()
    slave.doStep(0.7, 0.8)
    first = slave.getReal(outputs)
    slave.setReal(gain, [9.0])
    slave.doStep(1.5, 0.5)
    slave.setFMUstate(state)
    assert slave.getReal(gain) == [2.5]
    slave.doStep(0.7, 0.8)
    assert slave.getReal(outputs) == first
    log = simulate(loop(driver=RECORDED), 1.51)
    np.testing.assert_allclose(first, [log[name][-1] for name in OUTPUTS], rtol=0, atol=1e-12)
    slave.freeFMUstate(state)
    slave.terminate()
    slave.freeInstance()


def test_it_holds_no_steerkit_and_is_valid(fmu: Path) -> None:
    import zipfile

    with zipfile.ZipFile(fmu) as archive:
        text = archive.read("resources/drive_model.py").decode()
    assert "import steerkit" not in text
    assert "numpy" not in text
    assert validate_fmu(str(fmu)) == []


def test_its_state_can_be_saved_and_restored_and_odd_steps_are_refused(fmu: Path) -> None:
    slave, numbers = slave_of(fmu)
    slave.doStep(0.0, 0.5)
    state = slave.getFMUstate()
    ends = []
    for _ in range(2):
        slave.setFMUstate(state)
        slave.doStep(0.5, 0.5)
        ends.append(slave.getReal([numbers["car.x"]])[0])
    assert ends[0] == ends[1] == pytest.approx(simulate(loop(), 1.01)["car.x"][-1], abs=1e-12)
    with pytest.raises(FMICallException):
        slave.doStep(1.0, 0.013)
    slave.freeFMUstate(state)
    slave.terminate()
    slave.freeInstance()


def test_mistakes_are_named(tmp_path: Path) -> None:
    with pytest.raises(KeyError, match=r"no signal 'path\.f'; did you mean 'path\."):
        export_fmu(loop(), tmp_path / "Drive.fmu", outputs=["path.f"])
    with pytest.raises(ValueError, match=r"the ending \.fmu"):
        export_fmu(loop(), tmp_path / "a drive.fmu", outputs=["path.e"])
    with pytest.raises(ValueError, match=r"path\.preview is a vector"):
        export_fmu(loop(), tmp_path / "Drive.fmu", outputs=["path.preview"])
