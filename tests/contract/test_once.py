"""What stands once: a search through the source finds one place for it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.support.house import parsed

ROOT = Path(__file__).parents[2]

FILES = "steerkit/_support/files.py"
ONCE: dict[str, tuple[str, str | None]] = {
    "an atomic write": (r"\bos\.(replace|rename)\b|\b(draft|part|temporary)\.(replace|rename)\(", FILES),
    "a wait for the disk": (r"\bfsync\b", FILES),
    "writing an .npz": (r"\bsavez(_compressed)?\b", FILES),
    "reading an .npz": (r"\bnp\.load\b|\bNpzFile\b", FILES),
    "the names of the learner's state": (r'"e_dot", "v", "psi_e"|"v", "psi_e", "r_e"', None),
    "a column of the learner's state by number": (
        r"\b(s|s_next|states|moved|signs|record\.s(_next)?)\[[:\w. -]+, [0-9]\]|\b(low|high|mirror_signs)\[5\]",
        None,
    ),
}
"""What, how a search finds it, and the only file that may hold it; None: no file may."""
FOLDERS = ("steerkit", "benchmarks")


@cache
def sources() -> dict[str, str]:
    """The lines of code of every module by its path; comments are left out."""
    files = (file for folder in FOLDERS for file in sorted((ROOT / folder).rglob("*.py")))
    return {
        file.relative_to(ROOT).as_posix(): re.sub(r"^\s*#.*|  # .*", "", file.read_text(encoding="utf-8"), flags=re.M)
        for file in files
    }


@pytest.mark.parametrize("what", ONCE)
def test_it_stands_once(what: str) -> None:
    pattern, home = ONCE[what]
    found = {name for name, text in sources().items() if re.search(pattern, text)}
    expected = {home} - {None}
    assert found == expected, f"{what} stands in {sorted(found)}; expected {sorted(map(str, expected))}"


TASK = "steerkit/task.py"
NUMBERS = {
    "trip": 0.5,
    "e_limit": 0.5,
    "release": 0.1,
    "goal": 0.05,
    "dt": 0.05,
    "preview_dt": 0.05,
    "period": 0.05,
    "a_y_max": 3.0,
}
"""A field, argument or constant of this name (case does not matter) with this number takes it from `steerkit.task`."""


def written(tree: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Every name that is given a value in the code, with that value: fields, constants, defaults, keywords."""
    for node in ast.walk(tree):
        if isinstance(node, ast.AnnAssign) and node.value is not None:
            yield ast.unparse(node.target), node.value
        elif isinstance(node, ast.Assign):
            for target in node.targets:
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    yield from ((ast.unparse(name), value) for name, value in zip(target.elts, node.value.elts))
                else:
                    yield ast.unparse(target), node.value
        elif isinstance(node, ast.keyword) and node.arg:
            yield node.arg, node.value
        elif isinstance(node, ast.arguments):
            plain = [*node.posonlyargs, *node.args]
            yield from ((a.arg, value) for a, value in zip(plain[len(plain) - len(node.defaults) :], node.defaults))
            yield from ((a.arg, value) for a, value in zip(node.kwonlyargs, node.kw_defaults) if value is not None)


def numbers_in(value: ast.expr) -> list[float]:
    """The number that a value is, or that its `field` or `radians_of` is of; a factor in a formula is neither."""
    if isinstance(value, ast.Call) and ast.unparse(value.func) in ("field", "radians_of"):
        return [n for part in [*value.args, *[k.value for k in value.keywords]] for n in numbers_in(part)]
    return [value.value] if isinstance(value, ast.Constant) and type(value.value) in (int, float) else []


def second_homes(name: str, text: str) -> list[str]:
    """Where the task's numbers are written once more in a module; 520 (degrees) and a bound on |e| under any name."""
    tree = parsed(text)
    found = []
    for target, value in written(tree):
        number = NUMBERS.get(target.rpartition(".")[2].lower())
        if number is not None and number in numbers_in(value):
            found.append(f"{name}:{value.lineno} {target} = {ast.unparse(value)}")
    for node in ast.walk(tree):
        numbers = isinstance(node, ast.Compare) and [part for part in node.comparators if numbers_in(part)]
        if numbers and re.search(r"abs(olute)?\(.*\be\b", ast.unparse(node.left)):
            found += [f"{name}:{node.lineno} {ast.unparse(node)}"] * len(numbers)
    constants = [node for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    return found + [f"{name}:{node.lineno} {node.value}" for node in constants if node.value == 520]


def test_the_numbers_of_the_task_stand_once() -> None:
    files = {name: (ROOT / name).read_text(encoding="utf-8") for name in sources() if name != TASK}
    found = [place for name, text in files.items() for place in second_homes(name, text)]
    assert found == [], f"take these from {TASK}"


@pytest.mark.parametrize(
    "line",
    [
        "trip: float = 0.5",
        "GOAL, TRIP = 0.05, 0.6",
        "f(release=0.1)",
        "def f(*, dt: float = 0.05): ...",
        "def f(e, goal=0.05): ...",
        "limit = radians_of(-520)",
        "near = abs(e) < 0.1",
        "preview_dt: float = field(init=False, default=0.05)",
    ],
)
def test_a_second_home_is_seen(line: str) -> None:
    assert second_homes("house.py", line)


@pytest.mark.parametrize("line", ["half = 0.5 * h", "trip: float = TRIP", "share: float = 0.05", "dt = 0.05 * rest"])
def test_a_factor_is_no_trip(line: str) -> None:
    assert second_homes("house.py", line) == []
