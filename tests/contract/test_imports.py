"""What may import what, and that nothing heavy is loaded before it is used."""

from __future__ import annotations

import ast
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import steerkit
from tests.support import house
from tests.support.house import imported
from tests.support.places import ROOT

HEAVY = ("torch", "casadi", "control", "matplotlib", "pandas", "pyarrow")

BASE = {"units", "task", "maths", "random", "clock", "errors", "files", "native", "outside"}
RUN = BASE | {"block", "mistakes", "wiring", "loop", "simulation"}
PLACES = BASE | {"block", "vehicles", "path", "courses"}
PARTS = PLACES | {"tracker", "doe", "controllers", "plants"}
MAY_IMPORT: dict[str, set[str]] = {
    "units": set(),
    "task": {"units"},
    "clock": set(),
    "maths": set(),
    "native": {"files", "errors", "units"},
    "files": {"errors", "units"},
    "errors": {"units"},
    "outside": {"errors"},
    "random": {"errors", "maths"},
    "block": BASE,
    "mistakes": BASE | {"block"},
    "wiring": BASE | {"block"},
    "loop": BASE | {"block", "mistakes", "wiring"},
    "simulation": RUN,
    "realtime": RUN,
    "vehicles": BASE,
    "waypoints": BASE | {"land"},
    "land": {"files"},
    "path": BASE | {"block", "waypoints"},
    "tracker": BASE | {"block", "path"},
    "courses": BASE | {"path", "waypoints"},
    "roads": BASE | {"path", "waypoints"},
    "doe": BASE | {"block"},
    "controllers": BASE | {"block", "vehicles", "path"},
    "plants": BASE | {"block", "vehicles", "path", "tracker"},
    "compiled": RUN,
    "analysis": RUN | {"plots"},
    "metrics": RUN,
    "plots": RUN | {"path"},
    "assembly": RUN | PARTS,
    "catalogue": BASE | PARTS | {"mistakes"},
    "scenario": RUN | PARTS | {"assembly", "catalogue", "compiled", "metrics", "waypoints", "roads"},
    "learning": RUN | PARTS | {"assembly", "catalogue", "compiled", "metrics", "plots", "scenario"},
    "logs": RUN | {"vehicles", "plants", "plots"},
    "identification": RUN | {"logs", "vehicles", "plants", "compiled", "plots"},
    "gym": RUN | PARTS | {"assembly", "catalogue", "compiled", "scenario", "learning"},
    "redrive": RUN | PARTS | {"assembly", "catalogue", "compiled", "logs", "plots"},
    "export": RUN | PARTS | {"compiled", "scenario", "learning", "gym"},
    "on_car": RUN | PARTS | {"realtime", "assembly", "catalogue", "scenario", "learning"},
}
"""A module or package at the top of steerkit, and which others it may import; itself always."""
PROGRAMS = ("__main__", "cli")
"""Programs over the library: they may import all of it."""
NEVER = {
    "learning": {"steerkit.plants.real_car"},
    "gym": {"steerkit.plants.real_car"},
    "scenario": {"steerkit.plants.real_car"},
}
"""Modules below a package that it may import, which are none of its business."""
WHEN_USED = {"block": {"plots"}, "loop": {"plots", "analysis"}, "simulation": {"plots"}}
"""More that a module may import inside a function: how a thing is shown."""
AT_HOME = {
    "torch": {"learning.nfq"},
    "casadi": {"compiled", "maths", "analysis", "controllers.mpc"},
    "control": {"analysis"},
    "matplotlib": {"plots", "learning.pictures"},
    "pandas": {"simulation"},
    "pyarrow": {"simulation", "learning.data", "logs.tables", "export.minari"},
    "typer": {"cli"},
    "onnx": {"export.onnx"},
    "onnxruntime": {"export.onnx"},
    "minari": {"export.minari"},
    "pythonfmu": {"export.fmu"},
    "fmpy": {"plants.fmu"},
    "rosbags": {"logs.ros", "logs.ros_out", "logs.mcap_rest"},
    "foxglove": {"logs.stream"},
    "asammdf": {"logs.mdf"},
    "opendbc": {"logs.can_frames"},
    "gymnasium": {"gym", "export.minari"},
    "defusedxml": {"roads.xml_stream"},
    "ijson": {"roads.tracks"},
    "PIL": {"gym.frames", "learning.pictures.film"},
}
"""Where a package may be imported: a module or package of steerkit."""

MODULES = {name.partition(".")[2]: file for name, file in house.modules(ROOT, "steerkit").items() if "." in name}
modules = pytest.mark.parametrize("module", [name for name in MODULES if name.split(".")[0] not in PROGRAMS])


@modules
def test_layers(module: str) -> None:
    home = module.split(".")[0]
    assert home in MAY_IMPORT, f"say in MAY_IMPORT what steerkit/{home} may import"
    for name, top in imported(MODULES[module]):
        package, *rest = name.split(".")
        if package == "steerkit":
            allowed = MAY_IMPORT[home] | {home} | (set() if top else WHEN_USED.get(home, set()))
            assert rest, f"{module} imports all of steerkit"
            assert rest[0] in allowed, f"{module} imports {name}; allowed: {', '.join(sorted(allowed))}"
            assert not any(name.startswith(far) for far in NEVER.get(home, ())), f"{module} imports {name}"


@modules
def test_plants_does_and_controllers_do_not_know_each_other(module: str) -> None:
    parts = {"plants", "doe", "controllers"}
    known = {name.split(".")[1] for name, _ in imported(MODULES[module]) if name.startswith("steerkit.")}
    if module.split(".")[0] in parts:
        assert not known & (parts - {module.split(".")[0]})


@modules
def test_heavy_packages_stay_where_they_are_used(module: str) -> None:
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


def test_a_circle_would_be_seen(tmp_path: Path) -> None:
    package = tmp_path / "house"
    package.mkdir()
    (package / "a.py").write_text("from house import b\n")
    (package / "b.py").write_text("def later():\n    from house.c import x\n")
    (package / "c.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from house import a\nx = 1\n"
    )
    assert house.cycles(house.graph(house.modules(tmp_path, "house"))) == []
    (package / "c.py").write_text("import house.a\nx = 1\n")
    assert house.cycles(house.graph(house.modules(tmp_path, "house"))) == [["house.a", "house.b", "house.c"]]


def loaded_by(code: str, packages: tuple[str, ...] = HEAVY) -> set[str]:
    """Those of the packages that are loaded after running `code` in a fresh interpreter."""
    report = f"{code}\nimport sys\nprint([name for name in {packages!r} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", report], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    return set(ast.literal_eval(answer.stdout.splitlines()[-1]))


def test_importing_steerkit_loads_nothing_heavy() -> None:
    assert loaded_by("import steerkit") == set()


def test_the_command_line_starts_with_nothing_heavy_not_even_arrays() -> None:
    assert loaded_by("import steerkit.cli.app, benchmarks.app", ("numpy", "scipy", *HEAVY)) == set()


def test_building_and_driving_a_loop_loads_nothing_heavy() -> None:
    code = """
from steerkit import Integrator, LinearSingleTrack, NfqPolicy, Stanley
from steerkit import course, placed, simulate, steering_loop, vehicle
from steerkit.plants.human import ConstantSpeed
path, passat = course("paper"), vehicle("vw-passat")
loop = steering_loop(car=placed(LinearSingleTrack(vehicle=passat, v0=5.0), path), path=path,
                     human=ConstantSpeed(speed=5.0), controller=NfqPolicy(), doe=Integrator(),
                     recovery=Stanley.of(passat))
simulate(loop, 1.0)
"""
    assert loaded_by(code) == set()


def test_no_public_name_is_also_a_module_which_would_take_its_place() -> None:
    assert not set(steerkit.__all__) & {module.name for module in pkgutil.iter_modules(steerkit.__path__)}


def test_every_public_name_is_there() -> None:
    for name in steerkit.__all__:
        assert getattr(steerkit, name) is not None
    assert set(steerkit.__all__) <= set(dir(steerkit))
    with pytest.raises(AttributeError, match=r"module 'steerkit' has no attribute 'loop_'; it offers: MPC, Block, "):
        _ = steerkit.loop_
