"""The list of slips is fresh, and the tool that runs it tells killed from survived."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from tests.contract.test_mirror import holds_something
from tests.support import mutate
from tests.support.places import ROOT

sources = pytest.mark.skipif(not (ROOT / "steerkit").is_dir(), reason="runs on the sources; here steerkit is installed")

SUMS = '''"""Sums."""


def total(a, b):
    return a + b


def half(a):
    return a / 2
'''
TEST = "tests/unit/tiny/test_sums.py"
TEST_OF_SUMS = """from tiny.sums import half, total


def test_total():
    assert total(2, 3) == 5


def test_half_runs():
    half(3)
"""
SLIPS = """
[[slip]]
file = "tiny/sums.py"
before = "a + b"
after = "a - b"
why = "subtracts"

[[slip]]
file = "tiny/sums.py"
before = "a / 2"
after = "a * 2"
why = "doubles"

[[slip]]
file = "tiny/sums.py"
before = "a ** 2"
after = "a ** 3"
why = "is not there any more"

[[slip]]
file = "tiny/sums.py"
before = "return a"
after = "return b"
why = "stands there twice"

[[slip]]
file = "tiny/sums.py"
before = "def half(a):"
after = "def half(a:"
why = "is no Python"

[[slip]]
file = "tiny/sums.py"
before = "a + b"
after = "a * b"
why = "names a test that moved"
tests = ["tests/unit/tiny/test_sums.py::test_of_before"]
"""


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """A project of one module, with a test, and a list of slips."""
    files = {
        "tiny/__init__.py": "",
        "tiny/sums.py": SUMS,
        "tests/unit/tiny/test_sums.py": TEST_OF_SUMS,
        "tests/support/slips/sums.toml": SLIPS,
        "pyproject.toml": '[tool.pytest.ini_options]\npythonpath = ["."]\n',
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def slips_of(tiny: Path) -> list[mutate.Slip]:
    return mutate.read(tiny / "tests/support/slips")


@sources
def test_every_slip_can_still_be_made() -> None:
    old = [f"{verdict.slip}: {verdict.detail}" for verdict in mutate.stale(mutate.read())]
    assert not old, "\n".join(old)


def without_slip(root: Path, slips: list[mutate.Slip]) -> list[str]:
    """Packages of the code none of whose own modules has a slip; those that hold nothing need none."""
    homes = {Path(slip.file).parent for slip in slips}
    files = [file for folder in ("steerkit", "benchmarks", "tiny") for file in (root / folder).rglob("*.py")]
    packages = {file.parent.relative_to(root) for file in files if holds_something(file)}
    return sorted(str(package) for package in packages - homes)


@sources
def test_the_list_is_long_and_every_package_has_a_slip() -> None:
    slips = mutate.read()
    assert len(slips) >= 150
    assert not without_slip(ROOT, slips)


def test_a_package_without_a_slip_is_named(tiny: Path) -> None:
    for name, text in (("more/__init__.py", ""), ("more/sums.py", SUMS), ("empty/__init__.py", '"""Nothing."""\n')):
        (tiny / "tiny" / name).parent.mkdir(exist_ok=True)
        (tiny / "tiny" / name).write_text(text)
    assert without_slip(tiny, slips_of(tiny)) == ["tiny/more"]


@sources
def test_no_slip_is_listed_twice() -> None:
    slips = mutate.read()
    assert len({(slip.file, slip.before, slip.after) for slip in slips}) == len(slips)


def test_the_tool_tells_killed_from_survived_and_stale(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert mutate.main(["--root", str(tiny), "--json", "--jobs", "2"]) == 1
    result = json.loads(capsys.readouterr().out)
    assert {slip["why"]: slip["outcome"] for slip in result["slips"]} == {
        "subtracts": "killed",
        "doubles": "survived",
        "is not there any more": "stale",
        "stands there twice": "stale",
        "is no Python": "stale",
        "names a test that moved": "stale",
    }
    killed = result["slips"][0]
    assert killed["detail"] == f"{TEST}::test_total"
    assert result["numbers"] == {"killed": 1, "survived": 1, "stale": 4}
    assert (tiny / "tiny/sums.py").read_text(encoding="utf-8") == SUMS, "the tree itself is never touched"
    assert mutate.main(["--root", str(tiny), "--only", "subtracts"]) == 0
    assert mutate.main(["--root", str(tiny), "--list"]) == 1
    assert mutate.main(["--root", str(tiny), "--only", "subtracts", "--minutes", "0"]) == 0
    assert "1 slips, 1 not run" in capsys.readouterr().out


def test_a_slip_that_hangs_is_not_called_killed(
    tiny: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tiny / "tests/support/slips/sums.toml").write_text(
        '[[slip]]\nfile = "tiny/sums.py"\nbefore = "return a / 2"\nafter = "while True: pass"\nwhy = "hangs"\n'
    )
    monkeypatch.setattr(mutate, "GRACE", 1.0)
    assert mutate.main(["--root", str(tiny)]) == 1
    assert "1 slips, 1 timed out" in capsys.readouterr().out


def test_a_test_that_fails_without_a_slip_says_nothing_about_it(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tiny / "tests/unit/tiny/test_sums.py").write_text("def test_wrong():\n    assert False\n")
    assert mutate.main(["--root", str(tiny), "--only", "subtracts", "--json"]) == 1
    (slip,) = json.loads(capsys.readouterr().out)["slips"]
    assert slip["outcome"] == "untested"
    assert slip["detail"] == f"{TEST} fails without a slip: {TEST}::test_wrong"


def test_the_whole_suite_is_asked_about_survivors(tiny: Path) -> None:
    (tiny / "tests/test_far_away.py").write_text(
        "from tiny.sums import half\n\n\ndef test_half():\n    assert half(3) == 1.5\n"
    )
    (doubles,) = mutate.run([s for s in slips_of(tiny) if s.why == "doubles"], tiny, all_tests=True)
    assert (doubles.outcome, doubles.detail) == ("killed", "tests/test_far_away.py::test_half")


def test_only_files_that_changed(tiny: Path) -> None:
    def git(*words: str) -> None:
        subprocess.run(["git", "-C", str(tiny), "-c", "user.name=a", "-c", "user.email=a@b", *words], check=True)

    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "one")
    slips = slips_of(tiny)
    assert mutate.selected(slips, "", mutate.changed(tiny, "")) == slips, "without a base: all"
    assert mutate.selected(slips, "", mutate.changed(tiny, "HEAD")) == []
    (tiny / "new.py").write_text("")
    assert mutate.changed(tiny, "HEAD") == {"new.py"}
    assert mutate.selected(slips, "", mutate.changed(tiny, "HEAD")) == []
    assert mutate.selected(slips, "", {"tests/unit/tiny/test_sums.py"}) == slips
    assert mutate.selected(slips, "", {"tests/support/slips/sums.toml"}) == slips
    (tiny / "tiny/sums.py").write_text(SUMS + "\n")
    assert mutate.selected(slips, "", mutate.changed(tiny, "HEAD")) == slips
    git("commit", "-q", "-a", "-m", "two")
    assert mutate.changed(tiny, "") == {"new.py", "tiny/sums.py"}, "the commit before"
    with pytest.raises(SystemExit, match="--changed nowhere"):
        mutate.changed(tiny, "nowhere")


def test_a_files_name_leads_to_its_test() -> None:
    assert mutate.mirror("steerkit/plants/sensors.py") == "tests/unit/plants/test_sensors.py"
    assert mutate.mirror("steerkit/compiled/__init__.py") == "tests/unit/compiled/test_compiled.py"
    assert mutate.mirror("steerkit/units.py") == "tests/unit/test_units.py"
    assert mutate.mirror("benchmarks/run/store.py") == "tests/unit/benchmarks/run/test_store.py"


def test_a_slip_with_a_wrong_field_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('[[slip]]\nfile = "a"\nbefore = "b"\nafter = "c"\nwhy = "d"\ntest = "e"\n')
    with pytest.raises(ValueError, match=r"a\.toml, slip 'd': unknown fields \['test'\]; valid: .*'tests'"):
        mutate.read(tmp_path)
    (tmp_path / "a.toml").write_text('[[slip]]\nfile = "a"\nwhy = "d"\n')
    with pytest.raises(ValueError, match=r"fields \['after', 'before'\] are missing"):
        mutate.read(tmp_path)
