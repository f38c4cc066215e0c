"""Which files and packages numbers depend on."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.run import sources
from benchmarks.run.sources import identity, source
from tests.support.places import ROOT

MAKES_NUMBERS = [f"benchmarks/{one}" for one in ("suites.py", "run/drives.py", "peers/agents.py")]
MAKES_NUMBERS += ["steerkit/learning/nfq/kernel.c", "steerkit/paths/courses/genesis.csv"]
READERS = ("app.py", "report/report.html.j2", "studies/throughput.py", "run/compare.py", "run/golden.py")
READS_ONLY = [f"benchmarks/{one}" for one in READERS]


@pytest.mark.parametrize("everything", [False, True])
@pytest.mark.parametrize("name", [*MAKES_NUMBERS, *READS_ONLY, "tests/test_x.py"])
def test_what_makes_numbers_changes_the_hash_and_for_machines_that_work_together_every_source_does(
    name: str, everything: bool, tmp_path: Path
) -> None:
    assert name.startswith("tests") or (ROOT / name).is_file()
    hashes = []
    for text in ("1\n", "2\n"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
        source.cache_clear()
        hashes.append(source(tmp_path, everything=everything))
    (tmp_path / name).rename((tmp_path / name).with_stem("moved"))
    source.cache_clear()
    hashes.append(source(tmp_path, everything=everything))
    counts = name in MAKES_NUMBERS or (everything and name.endswith(".py") and not name.startswith("tests"))
    assert len(set(hashes)) == 3 if counts else hashes[0] == hashes[1], hashes


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


def test_it_loads_neither_package() -> None:
    """Another machine answers at once."""
    code = "import sys, benchmarks.run.sources; print([n for n in ('numpy', 'torch', 'steerkit') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    assert done.stdout.strip() == "[]", done.stderr
