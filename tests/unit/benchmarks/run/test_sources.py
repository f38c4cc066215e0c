"""Which files and packages numbers depend on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.run import sources
from benchmarks.run.sources import identity, source, versions

MAKES_NUMBERS = (
    "steerkit/controllers/stanley.py",
    "steerkit/learning/nfq/kernel.c",
    "steerkit/paths/courses/genesis.csv",
    "benchmarks/scenarios.py",
    "benchmarks/entries.py",
    "benchmarks/suites.py",
    "benchmarks/run/drives.py",
    "benchmarks/run/trainings.py",
    "benchmarks/run/runner.py",
    "benchmarks/peers/agents.py",
)
READS_ONLY = (
    "benchmarks/__main__.py",
    "benchmarks/app.py",
    "benchmarks/report/page.py",
    "benchmarks/report/report.html.j2",
    "benchmarks/studies/throughput.py",
    "benchmarks/run/compare.py",
    "benchmarks/run/golden.py",
    "tests/test_x.py",
)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree with these files."""
    for name in (*MAKES_NUMBERS, *READS_ONLY):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("1\n", encoding="utf-8")
    return tmp_path


def changed(tree: Path, name: str) -> bool:
    source.cache_clear()
    before = source(tree)
    (tree / name).write_text("2\n", encoding="utf-8")
    source.cache_clear()
    return source(tree) != before


@pytest.mark.parametrize("name", MAKES_NUMBERS)
def test_what_makes_numbers_changes_the_hash(tree: Path, name: str) -> None:
    assert changed(tree, name)


@pytest.mark.parametrize("name", READS_ONLY)
def test_what_only_reads_results_does_not(tree: Path, name: str) -> None:
    assert not changed(tree, name)


@pytest.mark.parametrize("name", [*MAKES_NUMBERS, "benchmarks/studies/throughput.py"])
def test_for_machines_that_work_together_every_source_counts(tree: Path, name: str) -> None:
    before = source(tree, everything=True)
    (tree / name).write_text("2\n", encoding="utf-8")
    source.cache_clear()
    assert source(tree, everything=True) != before


def test_a_short_word_for_sources_and_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    words = set()
    for hashed, numpy in (("a", "2.0"), ("b", "2.0"), ("a", "2.1")):
        monkeypatch.setattr(sources, "source", lambda *, everything, hashed=hashed: f"{hashed}{everything}")
        monkeypatch.setattr(sources, "versions", lambda numpy=numpy: {"numpy": numpy})
        identity.cache_clear()
        words.add(identity())
    monkeypatch.undo()
    identity.cache_clear()
    assert len(words) == 3
    assert identity() not in words


def test_a_file_that_moves_changes_the_hash(tree: Path) -> None:
    source.cache_clear()
    before = source(tree)
    (tree / "benchmarks/run/drives.py").rename(tree / "benchmarks/run/driven.py")
    source.cache_clear()
    assert source(tree) != before


def test_the_files_named_here_are_there() -> None:
    root = Path(sys.modules["benchmarks.run.sources"].__file__ or "").parents[2]
    assert [name for name in (*MAKES_NUMBERS, *READS_ONLY[:-1]) if not (root / name).is_file()] == []


def test_versions_of_what_numbers_depend_on() -> None:
    assert versions()["python"] == sys.version.split()[0]
    assert {"numpy", "casadi", "control"} <= versions().keys()


def test_it_loads_neither_package() -> None:
    """Another machine answers at once."""
    code = "import sys, benchmarks.run.sources; print([n for n in ('numpy', 'torch', 'steerkit') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    assert done.stdout.strip() == "[]", done.stderr
