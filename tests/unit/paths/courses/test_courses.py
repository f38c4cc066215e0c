"""Built-in courses on disk are those that would be made, and nothing else is taken for them."""

import importlib
from pathlib import Path as File

import numpy as np
import pytest

from steerkit._support import native
from steerkit.paths.courses import circle, kept
from steerkit.paths.path import Path


def never() -> Path:
    raise AssertionError("made anew")


@pytest.fixture
def folder(tmp_path: File, monkeypatch: pytest.MonkeyPatch) -> File:
    monkeypatch.setattr(native, "directory", lambda: tmp_path)
    return tmp_path


def test_the_second_is_the_first_to_the_bit(folder: File) -> None:
    first, second = kept("circle", circle), kept("circle", never)
    assert np.array_equal(first.table.rows, second.table.rows)
    for name in ("length", "closed", "name", "h"):
        assert getattr(first, name) == getattr(second, name), name


@pytest.mark.parametrize("spoilt", [b"", b"PK", None])
def test_a_broken_file_is_made_anew(folder: File, spoilt: bytes | None) -> None:
    first = kept("circle", circle)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes()[:-200] if spoilt is None else spoilt)
    assert np.array_equal(kept("circle", circle).table.rows, first.table.rows)
    assert np.array_equal(kept("circle", never).table.rows, first.table.rows)


def test_changed_code_makes_it_anew(folder: File, monkeypatch: pytest.MonkeyPatch) -> None:
    kept("circle", circle)
    monkeypatch.setattr(importlib.import_module("steerkit.paths.courses"), "_state", lambda: "another")
    with pytest.raises(AssertionError, match="made anew"):
        kept("circle", never)


def test_what_cannot_be_written_is_only_not_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: File) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setattr(native, "directory", lambda: tmp_path / "file" / "below")
    assert kept("circle", circle).length == circle().length
