"""A car from an FMU drives as the same car in steerkit; its state goes in and comes out."""

import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

from steerkit._support import native
from steerkit.compiled import TraceError, compile
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.export.fmu import export_fmu
from steerkit.paths.courses import course
from steerkit.plants.fmu import FmuPlant
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.vehicles import VW_PASSAT as CAR
from tests.support.places import SUPPORT
from tests.support.straight_road import looped

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="the FMU needs a compiler")
STATES = ("x", "y", "psi", "beta", "r")
PARAMETERS = ("m", "i_z", "l_f", "l_r", "c_f", "c_r", "steer_ratio")
NAMES = (*STATES, *(f"der_{s}" for s in STATES), "wheel", "speed", "a_y", *PARAMETERS)
PATH = course("paper")


def description(kind: str, *, events: int = 0) -> str:
    def variable(i: int, name: str) -> str:
        causality = {"wheel": "input", "speed": "input"}.get(name, "output" if i < 5 or name == "a_y" else "local")
        if name in PARAMETERS:
            return (
                f'<ScalarVariable name="{name}" valueReference="{i}" causality="parameter" variability="fixed">'
                '<Real start="1"/></ScalarVariable>'
            )
        real = f'<Real derivative="{i - 4}"/>' if name.startswith("der_") else "<Real/>"
        real = '<Real start="0"/>' if causality == "input" else real
        return f'<ScalarVariable name="{name}" valueReference="{i}" causality="{causality}">{real}</ScalarVariable>'

    def unknowns(rows: range | list[int]) -> str:
        return "".join(f'<Unknown index="{i + 1}"/>' for i in rows)

    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="car" guid="car" numberOfEventIndicators="{events}">
<{kind} modelIdentifier="car"/>
<ModelVariables>{"".join(variable(i, name) for i, name in enumerate(NAMES))}</ModelVariables>
<ModelStructure><Outputs>{unknowns([*range(5), NAMES.index("a_y")])}</Outputs>
<Derivatives>{unknowns(range(5, 10))}</Derivatives></ModelStructure>
</fmiModelDescription>"""


def packed(file: Path, library: Path, text: str) -> str:
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(library, f"binaries/{fmpy.platform}/car{fmpy.sharedLibraryExtension}")
        archive.writestr("resources/", "")
    return str(file)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("fmu") / "car.so"
    headers = Path(fmpy.__file__).parent / "c-code"
    source = str(SUPPORT / "fmu_car" / "car.c")
    words = ["-shared", "-fPIC", "-w", "-O1", f"-I{headers}", source, "-o", str(made), "-lm"]
    subprocess.run([*(native.compiler() or ["cc"]), *words], check=True)
    return made


@pytest.fixture(scope="module")
def fmu(library: Path) -> str:
    return packed(library.parent / "car.fmu", library, description("ModelExchange"))


def plant(fmu: str) -> FmuPlant:
    return FmuPlant(
        file=fmu,
        variables={"delta_sw_cmd": "wheel", "v_cmd": "speed"},
        v0=5.0,
        parameters={name: float(getattr(CAR, name)) for name in PARAMETERS},
    )


def loop(car: FmuPlant | LinearSingleTrack) -> Loop:
    """At another speed than before the first sample."""
    return looped(Stanley.of(CAR), PATH, 6.0, 0.0, car=car, actuator=None, s=30.0, e=0.3, psi_e=0.05)


def test_it_drives_as_the_same_car_of_ours(fmu: str) -> None:
    ours = simulate(loop(LinearSingleTrack(vehicle=CAR, v0=5.0)), 5.0)
    theirs = simulate(loop(plant(fmu)), 5.0)
    for name in ("x", "y", "psi", "v", "beta", "r", "a_y", "delta_sw"):
        np.testing.assert_allclose(theirs[f"car.{name}"], ours[f"car.{name}"], atol=1e-9)
    assert np.abs(theirs["path.e"]).max() > 0.1


def test_its_state_can_be_kept_and_two_cars_of_one_file_do_not_meet(fmu: str, tmp_path: Path) -> None:
    here = loop(plant(fmu))
    whole = simulate(here, 2.0)
    half = simulate(here, 1.0)
    simulate(here, 0.5)  # the same block, driven elsewhere meanwhile
    assert half.state is not None
    here.save_state(half.state, tmp_path / "state.npz")
    rest = simulate(here, 1.0, state=here.load_state(tmp_path / "state.npz"))
    np.testing.assert_array_equal(rest["car.x"], whole["car.x"][100:])


def test_it_is_given_the_time(fmu: str, monkeypatch: pytest.MonkeyPatch) -> None:
    car, times = plant(fmu), list[float]()
    monkeypatch.setattr(car._fmu._model, "setTime", times.append)
    x = car.init()
    y = car.output(3.5, x, ())
    car.update(4.5, x, car.U(0.0, 5.0), y)
    assert (times[0], set(times[1:])) == (3.5, {4.5})


def test_a_batch_is_its_cars_and_none_is_compiled(fmu: str) -> None:
    one, two = simulate(loop(plant(fmu)), 0.5), simulate(loop(plant(fmu)), 0.5, batch=2)
    for car in range(2):
        np.testing.assert_allclose(two["car.psi"][:, car], one["car.psi"], atol=1e-12)
    with pytest.raises(TraceError, match=r"\(FmuPlant\) cannot be run on symbols.*an FMU is machine code"):
        compile(loop(plant(fmu)), backend="python")


def test_what_does_not_fit_is_refused(fmu: str, library: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"has no variable .'delta_sw_cmd'.; it has: a_y, beta"):
        FmuPlant(file=fmu)
    with pytest.raises(ValueError, match="has 2 event indicators, expected a model without events"):
        plant(packed(tmp_path / "e.fmu", library, description("ModelExchange", events=2)))
    cosim = export_fmu(loop(LinearSingleTrack(vehicle=CAR, v0=5.0)), tmp_path / "Cosim.fmu", outputs=["car.x"])
    with pytest.raises(ValueError, match="is for co-simulation only: its state stays inside"):
        plant(str(cosim))
    (tmp_path / "no.fmu").write_text("no")
    with pytest.raises(ValueError, match="is no FMU that can be read"):
        plant(str(tmp_path / "no.fmu"))
    with pytest.raises(ValueError, match="there is no such file"):
        plant(str(tmp_path / "none.fmu"))
