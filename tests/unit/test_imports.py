"""What may import what, and that nothing heavy is loaded before it is used."""

from __future__ import annotations

import ast
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import steerkit

ROOT = Path(steerkit.__file__).parent
HEAVY = ("torch", "casadi", "control", "matplotlib", "pandas", "pyarrow")

BASE = {"block", "maths", "units", "random"}
RUN = BASE | {"loop", "simulation"}
MAY_IMPORT: dict[str, set[str]] = {
    "units": set(),
    "maths": set(),
    "block": {"units"},
    "random": {"block", "maths"},
    "loop": {"block"},
    "simulation": {"block", "loop"},
    "path": BASE,
    "tracker": BASE | {"path"},
    "doe": BASE,
    "courses": BASE | {"path"},
    "clock": set(),
    "plants": BASE | {"path", "tracker", "clock"},
    "controllers": BASE | {"path"},
    "assembly": RUN | {"path", "tracker", "controllers"},
    "compiled": RUN,
    "c_export": RUN | {"compiled"},
    "realtime": RUN | {"clock"},
    "analysis": RUN | {"plotting"},
    "metrics": RUN,
    "diagram": {"loop"},
    "plotting": RUN | {"path", "diagram"},
    "notebook": {"block"},
    "animation": BASE | {"plotting"},
    "identification": RUN | {"plants", "compiled", "plotting"},
    "learning": RUN | {"clock", "realtime", "path", "tracker", "doe", "courses", "plants", "controllers", "assembly",
                       "compiled", "metrics", "plotting"},
    "onnx_export": BASE | {"controllers"},
    "fmu_export": RUN | {"compiled"},
    "gym": RUN | {"path", "doe", "plants", "controllers", "assembly", "learning", "compiled"},
}  # fmt: skip
"""A module or package at the top of steerkit, and which others it may import; itself always."""
PROGRAMS = ("__main__", "cli", "car", "car_cli", "car_panel", "car_replay", "car_session", "export_cli", "identify_cli")
"""Programs over the library: they may import all of it."""
WHEN_USED = {
    "block": {"notebook"},
    "loop": {"plotting", "analysis", "notebook"},
    "simulation": {"plotting", "notebook", "animation"},
}
"""More that a module may import inside a function."""
AT_HOME = {
    "torch": {"learning"},
    "casadi": {
        "compiled",
        "maths",
        "analysis",
        "controllers.mpc",
        "controllers.mpc_model",
        "controllers.mpc_qp",
        "controllers.nonlinear_mpc",
    },
    "control": {"analysis", "controllers.lqr", "controllers.mpc_model"},
    "matplotlib": {"plotting", "animation", "learning.figures"},
    "pandas": {"simulation"},
    "pyarrow": {"simulation", "learning.store_exchange", "identification.reading", "gym.minari_export"},
    "typer": {"cli", "car_cli", "export_cli", "identify_cli"},
    "onnx": {"onnx_export"},
    "onnxruntime": {"onnx_export"},
    "minari": {"gym.minari_export"},
    "pythonfmu": {"fmu_export"},
    "fmpy": {"plants.fmu_plant"},
    "gymnasium": {"gym"},
    "PIL": {"gym.frames"},
}
"""Where a package may be imported: a module or package of steerkit."""

MODULES = {
    ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file
    for file in sorted(ROOT.rglob("*.py"))
}
modules = pytest.mark.parametrize("module", [name for name in MODULES if name not in ("__init__", *PROGRAMS)])


def imports(file: Path) -> Iterator[tuple[str, bool]]:
    """(what is imported, is it at the top of the file); what only type checkers see is left out."""

    def walk(node: ast.AST, top: bool) -> Iterator[tuple[str, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.Import):
                yield from ((alias.name, top) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"{file}: relative import"
                names = [f"steerkit.{a.name}" for a in child.names] if child.module == "steerkit" else [child.module]
                yield from ((str(name), top) for name in names)
            yield from walk(child, top and not isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)))

    return walk(ast.parse(file.read_text(encoding="utf-8")), True)


@modules
def test_layers(module: str) -> None:
    home = module.split(".")[0]
    assert home in MAY_IMPORT, f"say in MAY_IMPORT what steerkit/{home} may import"
    for name, top in imports(MODULES[module]):
        package, *rest = name.split(".")
        if package == "steerkit":
            allowed = MAY_IMPORT[home] | {home} | (set() if top else WHEN_USED.get(home, set()))
            assert rest, f"{module} imports all of steerkit"
            assert rest[0] in allowed, f"{module} imports {name}; allowed: {', '.join(sorted(allowed))}"


@modules
def test_plants_does_and_controllers_do_not_know_each_other(module: str) -> None:
    parts = {"plants", "doe", "controllers"}
    known = {name.split(".")[1] for name, _ in imports(MODULES[module]) if name.startswith("steerkit.")}
    if module.split(".")[0] in parts:
        assert not known & (parts - {module.split(".")[0]})


@modules
def test_heavy_packages_stay_where_they_are_used(module: str) -> None:
    for name, top in imports(MODULES[module]):
        package = name.split(".")[0]
        if package in AT_HOME:
            homes = AT_HOME[package]
            at_home = any(module == home or module.startswith(f"{home}.") for home in homes)
            assert at_home, f"{module} imports {name}; only {', '.join(sorted(homes))} may"
            if package in ("matplotlib", "pandas", "pyarrow"):
                assert not top, f"{module} imports {name} at its top; do it in the function that needs it"


def loaded_by(code: str) -> set[str]:
    """The heavy packages that are loaded after running `code` in a fresh interpreter."""
    report = f"{code}\nimport sys\nprint([name for name in {HEAVY!r} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", report], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    return set(ast.literal_eval(answer.stdout.splitlines()[-1]))


def test_importing_steerkit_loads_nothing_heavy() -> None:
    assert loaded_by("import steerkit") == set()


def test_building_and_driving_a_loop_loads_nothing_heavy() -> None:
    code = """
from steerkit import Integrator, LinearSingleTrack, NfqPolicy, Stanley
from steerkit import course, placed, simulate, steering_loop, vehicle
from steerkit.plants.human_driver import ConstantSpeed
path, passat = course("paper"), vehicle("vw-passat")
loop = steering_loop(car=placed(LinearSingleTrack(vehicle=passat, v0=5.0), path), path=path,
                     driver=ConstantSpeed(speed=5.0), controller=NfqPolicy(), doe=Integrator(),
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
