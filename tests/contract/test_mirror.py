"""Tests mirror the house: the test of a file is found by its name.

`steerkit/plants/sensors.py` is tested in `tests/unit/plants/test_sensors.py`, `benchmarks/run/compare.py` in
`tests/unit/benchmarks/run/test_compare.py`, what a package itself holds in `tests/unit/gym/test_gym.py`. A long test
is split by what it is about, `test_app_habits.py` beside `test_app.py`. What is tested elsewhere is imported there.
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
    "steerkit.analysis.period": "evals/test_analysis_closed_forms.py",
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


def mirror_of(file: Path, root: Path = ROOT, unit: Path = UNIT) -> Path:
    """The test file of a module's file."""
    return unit / Path(mirror(str(file.relative_to(root)))).relative_to("tests/unit")


def missing(root: Path, unit: Path) -> list[str]:
    """What does not mirror: a module without a test, a test without a module."""
    files = modules(root, "steerkit") | modules(root, "benchmarks")
    mirrors = {name: mirror_of(file, root, unit) for name, file in files.items()}
    tests = modules(root, "tests")
    tested = {target for name, targets in graph(files | tests).items() if name in tests for target in targets}
    found = [
        f"{name} has no {test.relative_to(root)}, and no test imports it"
        for name, test in mirrors.items()
        if holds_something(files[name])
        and not test.is_file()
        and name not in tested
        and not name.startswith(PROGRAMS)
        and not (root / "tests" / BEHIND.get(name, "-")).is_file()
    ]
    found += [f"BEHIND: there is no {name}" for name in BEHIND if root == ROOT and name not in files]
    known = set(mirrors.values())
    for test in sorted(unit.rglob("test_*.py")):
        words = test.stem.split("_")
        stems = {"_".join(words[:n]) for n in range(2, len(words) + 1)}
        if not {test.with_name(f"{stem}.py") for stem in stems} & known:
            found.append(f"{test.relative_to(root)} is the test of no module")
    return found


@pytest.mark.skipif(not (ROOT / "steerkit").is_dir(), reason="runs on the sources; here steerkit is installed")
def test_every_module_has_its_test_and_every_test_its_module() -> None:
    assert not missing(ROOT, UNIT)


def test_a_gap_would_be_seen(tmp_path: Path) -> None:
    unit = tmp_path / "tests" / "unit"
    files = {f"steerkit/{name}.py": "X = 1\n" for name in ("a", "p/__init__", "p/b", "p/c", "p/d")}
    files |= {f"tests/unit/{name}.py": "" for name in ("test_a", "test_old", "p/test_b_slowly", "p/test_p")}
    files["tests/unit/test_a.py"] = "from steerkit.p import c\n"
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert missing(tmp_path, unit) == [
        "steerkit.p.b has no tests/unit/p/test_b.py, and no test imports it",
        "steerkit.p.d has no tests/unit/p/test_d.py, and no test imports it",
        "tests/unit/test_old.py is the test of no module",
    ]
