"""What stands once: a search through the source finds one place for it."""

import re
from functools import cache

import pytest

from tests.support.places import ROOT

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
NUMBERS = {"trip|e_limit": "0.5", "release": "0.1", "goal|dt|preview_dt|period": "0.05", "a_y_max": "3.0"}
"""A field, argument or constant of this name (case does not matter) with this number takes it from `steerkit.task`."""
SECOND_HOME = re.compile(
    "|".join(
        [
            rf"\b(?:{names})(?:: [\w. |]+)? ?= ?(?:field\(.*\b|number\()?{n}(?![\d ]* ?[*/])\b"
            for names, n in NUMBERS.items()
        ]
        + [r"= ?(?:radians_of\()?-?520\b", r"\babs(?:olute)?\([^)]*\be\b[^)]*\) *[<>]=? *[\d.]+"]
    ),
    re.I,
)


def test_the_numbers_of_the_task_stand_once() -> None:
    found = [f"{n}: {m[0]}" for n, text in sources().items() if n != TASK for m in SECOND_HOME.finditer(text)]
    assert found == [], f"take these from {TASK}"
