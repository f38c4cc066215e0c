"""What stands once: a search through the source finds one place for it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

FILES = "steerkit/files.py"
ONCE = {
    "an atomic write": (r"\bos\.(replace|rename)\b|\b(draft|part|temporary)\.(replace|rename)\(", FILES),
    "a wait for the disk": (r"\bfsync\b", FILES),
    "writing an .npz": (r"\bsavez(_compressed)?\b", FILES),
    "reading an .npz": (r"\bnp\.load\b|\bNpzFile\b", FILES),
}
"""What, how a search finds it, and the only file that may hold it."""
FOLDERS = ("steerkit", "benchmarks")


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
    assert found == {home}, f"{what} stands in {', '.join(sorted(found))}; expected {home} alone"
