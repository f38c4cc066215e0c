"""What users write themselves, found by name: `my_file.py:make` or `package.module:make`."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

from steerkit._support.errors import require

_PREFIX = "_steerkit_outside_"
"""How the names of modules begin that are files of users."""


def is_outside(name: str) -> bool:
    """Does the name point out of the library: to a file, or to a module, and a thing in it?"""
    return ":" in name


def imported(name: str, where: str) -> Any:
    """The thing that `name` points to, such as the function `make` of my_file.py.

    name: `FILE.py:THING` or `PACKAGE.MODULE:THING`. where: what it is wanted for, such as `controller`; errors begin
    with it. A file is run as it stands now, with its folder on the path, so that it can import its neighbours. Raises
    ValueError, in one line, for a file or module that is not there, or fails when it is run, or lacks the thing.
    """
    home, _, thing = name.rpartition(":")
    where = f"{where} '{name}'"
    require(home and thing.isidentifier(), where, "expected FILE.py:NAME or PACKAGE.MODULE:NAME")
    module = _from_file(Path(home), where) if home.endswith(".py") else _from_package(home, where)
    public = [key for key in vars(module) if not key.startswith("_")]
    require(hasattr(module, thing), where, f"{home} has no '{thing}'; it has {', '.join(public) or 'nothing'}")
    return getattr(module, thing)


def name_of(thing: type) -> str:
    """The name by which `imported` finds a class again, in this program and in a later one; empty: by none."""
    module = sys.modules.get(thing.__module__)
    file = getattr(module, "__file__", None)
    home = thing.__module__
    if home.startswith(_PREFIX) and file:
        home = os.path.relpath(file) if Path(file).is_relative_to(Path.cwd()) else file
    name = f"{home}:{thing.__qualname__}"
    if home == "__main__" or module is None or "." in thing.__qualname__ or not file:
        return ""
    try:
        return name if imported(name, "class") is thing else ""
    except ValueError:
        return ""


def fingerprint(name: str, where: str) -> str:
    """16 hexadecimal digits that change with the file, or the module's file, in which `name` is to be found."""
    home = name.rpartition(":")[0]
    if home.endswith(".py"):
        return _digest(_text(Path(home), f"{where} '{name}'"))
    imported(name, where)
    file = getattr(sys.modules[home], "__file__", None)
    return _digest(Path(file).read_bytes()) if file else ""


def _from_file(file: Path, where: str) -> ModuleType:
    text = _text(file, where)
    try:
        return _run(file.resolve(), text)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        raise ValueError(f"{where}: {file} fails when it is imported: {_line(error)}") from error


@lru_cache
def _run(file: Path, text: bytes) -> ModuleType:
    """The module in a file; once for each text, so that classes in it stay the same ones."""
    key = f"{_PREFIX}{_digest(str(file).encode() + text)}_{file.stem}"
    spec = importlib.util.spec_from_file_location(key, file)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[key] = module  # dataclasses and pickle look their module up
    sys.path.insert(0, str(file.parent))
    try:
        exec(compile(text, str(file), "exec"), vars(module))
    except BaseException:
        del sys.modules[key]
        raise
    finally:
        sys.path.remove(str(file.parent))
    return module


def _from_package(home: str, where: str) -> ModuleType:
    try:
        return importlib.import_module(home)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        raise ValueError(f"{where}: module {home} cannot be imported: {_line(error)}") from error


def _text(file: Path, where: str) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise ValueError(f"{where}: {file} cannot be read ({error.strerror}), looked for in {Path.cwd()}") from error


def _digest(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()[:16]


def _line(error: BaseException) -> str:
    return f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"
