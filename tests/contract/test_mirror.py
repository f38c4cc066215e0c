"""Tests mirror the house: the test of a file is found by its name.

`steerkit/plants/sensors.py` is tested in `tests/unit/plants/test_sensors.py`, `benchmarks/run/compare.py` in
`tests/unit/benchmarks/run/test_compare.py`, what a package itself holds in `tests/unit/scenario/test_scenario.py`. A
long test is split by what it is about, `test_app_habits.py` beside `test_app.py`. What is tested elsewhere is imported
there.
"""

import ast
from pathlib import Path

import pytest

from tests.support.house import graph, mirror, modules, tree
from tests.support.places import ROOT

UNIT = ROOT / "tests" / "unit"
PROGRAMS = ("benchmarks.studies.", "benchmarks.__main__", "steerkit.__main__", "steerkit.cli.")
"""Run as programs by tests (test_studies.py, test_commands.py)."""
BEHIND = {
    "steerkit._support.console": "unit/cli/test_app.py",
    "steerkit.compiled.python_code": "unit/compiled/test_compiled.py",
    "steerkit.logs.tables": "unit/logs/test_reading.py",
    "steerkit.paths.waypoints": "unit/paths/test_path.py",
}
"""Modules behind another's names, and the file under tests/ that tests them."""


def holds_something(file: Path) -> bool:
    """More than a docstring and the names it passes on."""

    def counts(node: ast.stmt) -> bool:
        passed_on = isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
        return isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Assign, ast.AnnAssign)) and not passed_on

    return any(map(counts, tree(file).body))


@pytest.mark.skipif(not (ROOT / "steerkit").is_dir(), reason="runs on the sources; here steerkit is installed")
def test_every_module_has_its_test_and_every_test_its_module() -> None:
    files = modules(ROOT, "steerkit") | modules(ROOT, "benchmarks")
    mirrors = {name: ROOT / mirror(str(file.relative_to(ROOT))) for name, file in files.items()}
    tests = modules(ROOT, "tests")
    tested = {target for name, targets in graph(files | tests).items() if name in tests for target in targets}
    found = [
        f"{name} has no {test.relative_to(ROOT)}, and no test imports it"
        for name, test in mirrors.items()
        if holds_something(files[name])
        and not test.is_file()
        and name not in tested
        and not name.startswith(PROGRAMS)
        and not (ROOT / "tests" / BEHIND.get(name, "-")).is_file()
    ]
    found += [f"BEHIND: there is no {name}" for name in BEHIND if name not in files]
    known = set(mirrors.values())
    for test in sorted(UNIT.rglob("test_*.py")):
        words = test.stem.split("_")
        stems = {"_".join(words[:n]) for n in range(2, len(words) + 1)}
        if not {test.with_name(f"{stem}.py") for stem in stems} & known:
            found.append(f"{test.relative_to(ROOT)} is the test of no module")
    assert not found
