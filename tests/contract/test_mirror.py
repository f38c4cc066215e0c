"""Tests mirror the house: the test of a file is found by its name.

`steerkit/plants/sensors.py` is tested in `tests/unit/plants/test_sensors.py`, `benchmarks/run/compare.py` in
`tests/unit/benchmarks/run/test_compare.py`, what a package itself holds in `tests/unit/gym/test_gym.py`. A long test
is split by what it is about, `test_app_habits.py` beside `test_app.py`. What is tested elsewhere stands in ELSEWHERE.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.support.house import mirror, modules, tree
from tests.support.places import ROOT

UNIT = ROOT / "tests" / "unit"

ELSEWHERE = {
    "steerkit": "contract/test_imports.py",
    "steerkit._support.console": "unit/cli/test_drive.py",
    "steerkit.__main__": "unit/cli/test_app.py",
    "steerkit.analysis.period": "evals/test_analysis_closed_forms.py",
    "steerkit.cli.demo": "unit/cli/test_app.py",
    "steerkit.cli.options": "unit/cli/test_app.py",
    # one program, run in every way that it can be
    "steerkit.compiled.c_code": "unit/compiled/test_compiled.py",
    "steerkit.compiled.python_code": "unit/compiled/test_compiled.py",
    "steerkit.compiled.vm": "unit/compiled/test_compiled.py",
    # both MPCs are one table of cases
    "steerkit.controllers.mpc.path_model": "evals/test_mpc_closed_forms.py",
    "steerkit.controllers.policy": "unit/controllers/test_nfq_policy.py",
    "steerkit.paths.courses.make_courses": "evals/test_path_closed_forms.py",
    "steerkit.gym.drives": "unit/gym/test_vector_env.py",
    "steerkit.learning.nfq.rprop": "evals/test_rprop.py",
    "steerkit.logs.tables": "unit/logs/test_reading_formats.py",
    "steerkit.logs.contents": "unit/logs/test_contents.py",
    # the programs on the car, in a world of processes and simulated hardware
    "steerkit.car.learner": "evals/test_car_learning.py",
    "steerkit.car.session": "evals/test_car_processes.py",
    # both cars are one table of cases
    "steerkit.plants.linear_single_track": "unit/plants/test_single_track.py",
    "steerkit.plants.nonlinear_single_track": "unit/plants/test_single_track.py",
    "steerkit.paths.importers": "unit/paths/importers/test_reading.py",
    "steerkit.task": "contract/test_once.py",
    "steerkit.vehicles": "unit/vehicles/test_parameters.py",
    "steerkit.paths.waypoints": "unit/paths/test_path.py",
    "benchmarks.peers.python_control": "unit/benchmarks/studies/test_studies.py",
    "benchmarks.report.figures": "unit/benchmarks/report/test_page.py",
    "benchmarks.run.provenance": "unit/benchmarks/run/test_results.py",
    "benchmarks.run.trainings": "unit/benchmarks/run/test_runner.py",
}
"""Module and the file under tests/ that tests it, where that is not the one of its name."""


def holds_something(file: Path) -> bool:
    """More than a docstring and the names it passes on."""

    def counts(node: ast.stmt) -> bool:
        passed_on = isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
        return isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Assign, ast.AnnAssign)) and not passed_on

    return any(map(counts, tree(file).body))


def mirror_of(file: Path, root: Path = ROOT, unit: Path = UNIT) -> Path:
    """The test file of a module's file."""
    return unit / Path(mirror(str(file.relative_to(root)))).relative_to("tests/unit")


def missing(root: Path, unit: Path, elsewhere: dict[str, str]) -> list[str]:
    """What does not mirror."""
    files = modules(root, "steerkit") | modules(root, "benchmarks")
    mirrors = {name: mirror_of(file, root, unit) for name, file in files.items()}
    found = [
        f"{name} has no {test.relative_to(root)}"
        for name, test in mirrors.items()
        if holds_something(files[name])
        and not test.is_file()
        and name not in elsewhere
        and not name.startswith("benchmarks.studies.")  # programs: test_studies.py runs every one
    ]
    known = set(mirrors.values())
    for test in sorted(unit.rglob("test_*.py")):
        words = test.stem.split("_")
        stems = {"_".join(words[:n]) for n in range(2, len(words) + 1)}
        if not {test.with_name(f"{stem}.py") for stem in stems} & known:
            found.append(f"{test.relative_to(root)} is the test of no module")
    for name, test in elsewhere.items():
        if name not in files:
            found.append(f"ELSEWHERE: there is no {name}")
        if not (root / "tests" / test).is_file():
            found.append(f"ELSEWHERE: there is no tests/{test}")
    return found


@pytest.mark.skipif(not (ROOT / "steerkit").is_dir(), reason="runs on the sources; here steerkit is installed")
def test_every_module_has_its_test_and_every_test_its_module() -> None:
    assert not missing(ROOT, UNIT, ELSEWHERE)


def test_a_gap_would_be_seen(tmp_path: Path) -> None:
    for name in (
        "steerkit/a.py",
        "steerkit/__init__.py",
        "steerkit/p/__init__.py",
        "steerkit/p/b.py",
        "steerkit/p/c.py",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("" if name == "steerkit/__init__.py" else "X = 1\n")
    unit = tmp_path / "tests" / "unit"
    for name in ("test_a.py", "test_old.py", "p/test_b_slowly.py", "p/test_p.py"):
        (unit / name).parent.mkdir(parents=True, exist_ok=True)
        (unit / name).touch()
    assert missing(tmp_path, unit, {"steerkit.gone": "unit/test_a.py", "steerkit.p.c": "unit/test_gone.py"}) == [
        "steerkit.p.b has no tests/unit/p/test_b.py",
        "tests/unit/test_old.py is the test of no module",
        "ELSEWHERE: there is no steerkit.gone",
        "ELSEWHERE: there is no tests/unit/test_gone.py",
    ]
