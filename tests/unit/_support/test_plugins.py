"""What users write themselves, found by name, and one line for everything that can be wrong with it."""

import sys
from pathlib import Path

import pytest

from steerkit._support.plugins import fingerprint, imported, is_outside


def test_a_file_is_run_as_it_stands_with_its_neighbours(tmp_path: Path) -> None:
    (tmp_path / "gains_of_mine.py").write_text("K = 3.0\n")
    (tmp_path / "mine.py").write_text("from gains_of_mine import K\n\ndef make():\n    return K\n")
    name = f"{tmp_path}/mine.py:make"
    make = imported(name, "controller")
    assert make() == 3.0
    assert imported(name, "controller") is make  # once for each text
    before = fingerprint(name, "controller")
    (tmp_path / "mine.py").write_text("def make():\n    return 4.0\n")
    assert imported(name, "controller")() == 4.0
    assert fingerprint(name, "controller") != before


def test_a_file_leaves_nothing_behind_but_its_module(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def make():\n    return 1.0\n")
    (tmp_path / "broken.py").write_text("1 / 0\n")
    before, modules = list(sys.path), set(sys.modules)
    imported(f"{tmp_path}/mine.py:make", "controller")
    with pytest.raises(ValueError, match="ZeroDivisionError"):
        imported(f"{tmp_path}/broken.py:make", "controller")
    assert sys.path == before
    assert len(set(sys.modules) - modules) == 1


def test_a_modules_fingerprint_changes_with_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a_module_of_mine.py"
    monkeypatch.syspath_prepend(tmp_path)
    prints = []
    for text in ("def make(): return 1\n", "def make(): return 2\n"):
        file.write_text(text)
        prints.append(fingerprint("a_module_of_mine:make", "controller"))
    assert len(set(prints)) == 2
    assert all(len(digits) == 16 for digits in prints)


def test_a_module_is_imported() -> None:
    assert imported("steerkit.diagram.units:radians_of", "controller")(180.0) == pytest.approx(3.14159, abs=1e-5)
    assert len(fingerprint("steerkit.diagram.units:radians_of", "controller")) == 16
    assert is_outside("steerkit.diagram.units:radians_of")
    assert not is_outside("stanley")


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("", "mine.py:make", r"mine.py has no 'make'; it has nothing$"),
        ("import no_such_package\n", "mine.py:make", "fails when it is imported: ModuleNotFoundError: No module named"),
        ("raise SystemExit('bye')\n", "mine.py:make", "fails when it is imported: SystemExit: bye"),
        ("", "yours.py:make", r"yours.py cannot be read \(No such file or directory\), looked for in /"),
        ("", "mine.py:", "expected FILE.py:NAME or PACKAGE.MODULE:NAME"),
        ("", "no.such.module:make", "no.such.module fails when it is imported: ModuleNotFoundError"),
    ],
)
def test_mistakes_are_one_line(
    text: str, name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message) as refused:
        imported(name, "controller")
    assert str(refused.value).startswith(f"controller '{name}': ")
    assert "\n" not in str(refused.value)
