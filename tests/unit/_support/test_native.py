"""C source to a library: which compiler, which cache, and what a library in it is known by."""

import ctypes
import re
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from steerkit._support import native

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="needs a C compiler")
SUM = "double sum(double a, double b) { return a + b; }"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A cache of the test's own, empty."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    native.directory.cache_clear()
    yield tmp_path / "steerkit"
    native.directory.cache_clear()


def called(library: ctypes.CDLL, name: str, *numbers: float) -> float:
    function = getattr(library, name)
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double] * len(numbers)
    return float(function(*numbers))


def noting(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A compiler in $CC that is the usual one, and writes down what it was asked; returns the file of its notes."""
    notes, script = folder / "notes", folder / "my cc"
    tool = " ".join(native.compiler() or ())
    script.write_text(f'#!/bin/sh\necho "$@" >> "{notes}"\nexec {tool} "$@"\n')
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("CC", f"'{script}' -DOWN -O1 -ffp-contract=fast")
    return notes


def test_the_compiler_is_that_of_cc_then_gcc_then_cc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("mine", "cc", "gcc"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "mine -O1 -g")
    assert native.compiler() == (str(tmp_path / "mine"), "-O1", "-g")
    monkeypatch.setenv("CC", "absent")
    assert native.compiler() is None, "another than the one asked for is never taken"
    with pytest.raises(native.NoCompilerError, match="CC = absent is not there"):
        native.load(SUM)
    monkeypatch.setenv("CC", "")
    assert native.compiler() == (str(tmp_path / "gcc"),)
    (tmp_path / "gcc").unlink()
    assert native.compiler() == (str(tmp_path / "cc"),)
    (tmp_path / "cc").unlink()
    with pytest.raises(native.NoCompilerError, match="neither gcc nor cc is there"):
        native.load(SUM)


@needs_compiler
def test_a_source_is_compiled_once_as_cc_says(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notes = noting(tmp_path, monkeypatch)
    for _ in range(2):
        assert called(native.load(SUM), "sum", 1.0, 2.0) == 3.0
    compiled = [line for line in notes.read_text().splitlines() if "--version" not in line]
    assert len(compiled) == 1
    assert "-DOWN" in compiled[0]
    assert re.findall(r"-O\d", compiled[0]) == ["-O3", "-O1"], "the last one counts: that of $CC"
    assert re.findall(r"-ffp-contract=\w+", compiled[0])[-1] == "-ffp-contract=off", "no rounding of its own"
    assert "-ffast-math" not in compiled[0]
    assert [file.suffix for file in cache.iterdir()] == [".so"], "what was on the way is gone"
    native.load(SUM, optimise=True)
    last = notes.read_text().splitlines()[-1]
    assert re.findall(r"-O\d|-ffp-contract=\w+", last)[-2:] == ["-O3", "-ffp-contract=off"], "what computes for minutes"


@needs_compiler
def test_libraries_that_may_differ_are_different_files(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By source, rounding, options and machine: none is taken for another."""
    native.load(SUM)
    native.load(SUM + " ")
    native.load(SUM, fused=True)
    native.load(SUM, vector_maths=True)
    assert len(list(cache.glob("*.so"))) == 4
    monkeypatch.setattr(native, "_machine", lambda tool: "another processor")
    native.load(SUM)
    assert len(list(cache.glob("*.so"))) == 5
    monkeypatch.setenv("CC", " ".join((*(native.compiler() or ()), "-DOWN")))
    native.load(SUM)
    assert len(list(cache.glob("*.so"))) == 6


@needs_compiler
def test_what_the_compiler_refuses_is_told_and_leaves_nothing(cache: Path) -> None:
    with pytest.raises(native.NoCompilerError, match="refused the generated code"):
        native.load("this is no C;")
    assert list(cache.iterdir()) == []


@needs_compiler
def test_a_cache_that_cannot_be_made_is_a_private_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    native.directory.cache_clear()
    folder = native.directory()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert called(native.load(SUM), "sum", 1.0, 2.0) == 3.0
    assert list(folder.glob("*.so"))
