"""What may import what, and that nothing heavy is loaded before it is used."""

import ast
import pkgutil
import subprocess
import sys

import pytest

import steerkit
from tests.support import house
from tests.support.house import imported
from tests.support.places import ROOT

HEAVY = ("torch", "casadi", "control", "matplotlib", "pandas", "pyarrow")

BASE = {"_support", "task"}
PARTS = {"diagram", "paths", "vehicles"}
LOOP = BASE | PARTS | {"doe", "plants", "estimators", "controllers", "compiled", "metrics", "plots", "scenario"}
MAY_IMPORT: dict[str, set[str]] = {
    "_support": set(),
    "task": set(),
    "diagram": BASE,
    "compiled": BASE | {"diagram"},
    "analysis": BASE | {"diagram", "plots"},
    "plots": BASE | PARTS,
    "vehicles": BASE | {"diagram"},
    "paths": BASE | {"diagram"},
    "doe": BASE | PARTS,
    "plants": BASE | PARTS,
    "estimators": BASE | PARTS,
    "controllers": BASE | PARTS | {"estimators"},
    "metrics": BASE | {"diagram"},
    "scenario": LOOP,
    "learning": LOOP,
    "logs": LOOP | {"car"},
    "identification": LOOP | {"logs"},
    "proving": LOOP | {"logs"},
    "gym": LOOP | {"learning"},
    "export": LOOP | {"learning", "gym"},
    "car": LOOP | {"learning", "proving"},
}
"""A folder, from the ground up, and which others it may import; itself always, `GROUND` too."""
GROUND = ("steerkit.diagram.maths", "steerkit.diagram.units")
"""Arithmetic and units: everything may import them, and they import nothing of ours but each other."""
PROGRAMS = ("__main__", "cli")
"""Programs over the library: they may import all of it."""
WHEN_USED = {"diagram": {"plots"}}
"""More that a floor may import inside a function: how a block, a loop or a log is shown."""
AT_HOME = {
    "torch": {"learning.nfq", "learning.report"},
    "casadi": {"compiled", "diagram.maths", "analysis", "controllers.mpc"},
    "control": {"analysis"},
    "matplotlib": {"plots", "learning.pictures"},
    "pandas": {"diagram.simulation"},
    "pyarrow": {"diagram.simulation", "logs.tables", "export.minari"},
    "typer": {"cli"},
    "onnx": {"export.onnx"},
    "onnxruntime": {"export.onnx"},
    "minari": {"export.minari"},
    "pythonfmu": {"export.fmu"},
    "fmpy": {"plants.fmu"},
    "rosbags": {"logs.ros"},
    "foxglove": {"logs.foxglove"},
    "asammdf": {"logs.tables"},
    "opendbc": {"logs.can_frames", "car.production"},
    "panda": {"car.production.port"},
    "gymnasium": {"gym", "export.minari"},
    "defusedxml": {"paths.importers.xml_stream"},
}
"""Where a package may be imported: a module or package of steerkit."""

MODULES = {name.partition(".")[2]: file for name, file in house.modules(ROOT, "steerkit").items() if "." in name}
LIBRARY = [name for name in MODULES if name.split(".")[0] not in PROGRAMS]


def test_a_folder_imports_only_what_the_table_allows() -> None:
    assert {name.split(".")[0] for name in LIBRARY} == set(MAY_IMPORT), "say in MAY_IMPORT what each folder may import"
    for module in LIBRARY:
        floor = module.split(".")[0]
        for name, top in imported(MODULES[module]):
            package, *rest = name.split(".")
            if package == "steerkit" and not name.startswith(GROUND):
                allowed = MAY_IMPORT[floor] | {floor} | (set() if top else WHEN_USED.get(floor, set()))
                allowed = set() if f"steerkit.{module}" in GROUND else allowed
                assert rest, f"{module} imports all of steerkit"
                assert rest[0] in allowed, f"{module} imports {name}; allowed: {sorted(allowed)}"


def test_at_the_root_stand_four_modules_beside_folders() -> None:
    root = {file.name for file in (ROOT / "steerkit").glob("*.py")}
    assert root == {"__init__.py", "__main__.py", "doe.py", "task.py"}


def test_heavy_packages_stay_where_they_are_used() -> None:
    for module in LIBRARY:
        for name, top in imported(MODULES[module]):
            package = name.split(".")[0]
            if package in AT_HOME:
                homes = AT_HOME[package]
                at_home = any(module == home or module.startswith(f"{home}.") for home in homes)
                assert at_home, f"{module} imports {name}; only {', '.join(sorted(homes))} may"
                if package in ("matplotlib", "pandas", "pyarrow"):
                    assert not top, f"{module} imports {name} at its top; do it in the function that needs it"


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Not even inside functions: what a block, a loop or a log looks like is drawn by code that needs them as types."""
    assert house.cycles(house.graph(house.modules(ROOT, "steerkit") | house.modules(ROOT, "benchmarks"))) == []


def loaded_by(code: str, packages: tuple[str, ...] = HEAVY) -> set[str]:
    """Those of the packages that are loaded after running `code` in a fresh interpreter."""
    report = f"{code}\nimport sys\nprint([name for name in {packages!r} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", report], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    return set(ast.literal_eval(answer.stdout.splitlines()[-1]))


def test_the_command_line_starts_with_nothing_heavy_not_even_arrays() -> None:
    assert loaded_by("import steerkit.cli.app", ("numpy", "scipy", *HEAVY)) == set()
    assert loaded_by("import benchmarks.app", ("scipy", "pandas", "joblib", "distributed", *HEAVY)) == set()


def test_building_and_driving_a_loop_and_an_environment_loads_nothing_heavy() -> None:
    code = """
import sys
from steerkit import Integrator, LinearSingleTrack, NfqPolicy, Stanley
from steerkit import course, placed, simulate, steering_loop, vehicle
from steerkit.plants.speed_driver import ConstantSpeed
path, passat = course("paper"), vehicle("vw-passat")
loop = steering_loop(car=placed(LinearSingleTrack(vehicle=passat, v0=5.0), path), path=path,
                     driver=ConstantSpeed(speed=5.0), controller=NfqPolicy(), doe=Integrator(),
                     recovery=Stanley.of(passat))
simulate(loop, 1.0)
assert "rich" not in sys.modules
import gymnasium
env = gymnasium.make("steerkit.gym:steerkit/TrackSteering-v0")  # one import is enough
env.reset(seed=0)
env.step(0)
"""
    assert loaded_by(code) == set()


def test_no_public_name_is_also_a_module_which_would_take_its_place() -> None:
    assert not set(steerkit.__all__) & {module.name for module in pkgutil.iter_modules(steerkit.__path__)}


def test_every_public_name_is_there() -> None:
    for name in steerkit.__all__:
        assert getattr(steerkit, name) is not None
    assert set(steerkit.__all__) <= set(dir(steerkit))
    with pytest.raises(AttributeError, match=r"'steerkit' has no attribute 'loop_'; it offers: Block, ConstantSpeed, "):
        _ = steerkit.loop_
