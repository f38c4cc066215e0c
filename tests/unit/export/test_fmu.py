"""A loop as an FMU: driven by FMPy it gives the numbers of `simulate`, in a Python that knows no steerkit."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

from steerkit.controllers.stanley import Stanley
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.export.fmu import export_fmu
from steerkit.paths.courses import course
from steerkit.vehicles import VW_PASSAT as CAR
from tests.support.straight_road import looped, recorded_speed

OUTPUTS = ("path.e", "car.x", "car.v", "car.delta_sw", "controller.delta_sw")


def loop(k: float = 2.5) -> Loop:
    """With a human who repeats a record over time, which the FMU has to know."""
    human = recorded_speed((4.0, 6.0, 5.0, 7.0, 4.5), spacing=0.6)
    return looped(replace(Stanley.of(CAR), k=k), course("paper"), 5.0, 0.03, driver=human, s=20.0, e=0.3)


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("fmu") / "Drive.fmu"
    return export_fmu(loop(), file, outputs=OUTPUTS, parameters=["controller.k"])


@pytest.mark.parametrize("k", [2.5, 1.0])
def test_it_gives_the_numbers_of_simulate(fmu: Path, k: float) -> None:
    result = fmpy.simulate_fmu(str(fmu), stop_time=3.0, output_interval=0.05, start_values={"controller.k": k})
    log = simulate(loop(k), 3.01, every=5)
    assert np.ptp(log["car.v"]) > 1.0
    np.testing.assert_allclose(result["time"], log.t, atol=1e-12)
    for name in OUTPUTS:
        np.testing.assert_allclose(result[name], log[name], rtol=0, atol=1e-12)


@pytest.mark.parametrize("step", [0.013, 0.05, 0.7])
def test_the_master_may_step_as_it_likes(fmu: Path, step: float) -> None:
    """Between two samples of the loop, 0.01 s apart, outputs hold."""
    result = fmpy.simulate_fmu(str(fmu), stop_time=2.1, output_interval=step)
    log = simulate(loop(), 2.2)
    assert len(result) == 1 + int(np.ceil(2.1 / step - 1e-9))
    samples = np.floor(result["time"] / 0.01 + 1e-6).astype(int)
    for name in OUTPUTS:
        np.testing.assert_allclose(result[name], log[name][samples], rtol=0, atol=1e-12)


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


def test_a_state_that_is_restored_brings_time_and_parameters_back(fmu: Path) -> None:
    slave, numbers = slave_of(fmu)
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
    log = simulate(loop(), 1.51)
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


def test_mistakes_are_named(tmp_path: Path) -> None:
    with pytest.raises(KeyError, match=r"no signal 'path\.f' \(did you mean 'path\."):
        export_fmu(loop(), tmp_path / "Drive.fmu", outputs=["path.f"])
    with pytest.raises(ValueError, match=r"the ending \.fmu"):
        export_fmu(loop(), tmp_path / "a drive.fmu", outputs=["path.e"])
    with pytest.raises(ValueError, match=r"path\.preview is a vector"):
        export_fmu(loop(), tmp_path / "Drive.fmu", outputs=["path.preview"])
