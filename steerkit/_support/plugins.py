"""What users write themselves, found by name: `my_file.py:make` or `package.module:make`.

Only what the user names is run, in a call or on the command line. A file is data: it brings in nothing by a name in it
that the user has not named too, and nothing that has changed since the file was written.
"""

import hashlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

from steerkit._support.errors import require
from steerkit._support.files import read_bytes

_PREFIX = "_steerkit_outside_"
"""How the names of modules begin that are files of users."""

_mine: set[str] = set()
"""Files and modules that the user has named in this program."""
_data: ContextVar[tuple[str, Mapping[str, Any], bool] | None] = ContextVar("_data", default=None)


def mine(code: str) -> None:
    """Let files name what is in that file or module of the user's; it is imported only when one does."""
    _mine.add(code.rpartition(":")[0] or code)


@contextmanager
def named_in(file: str, prints: Any = None, *, loaded: bool = True) -> Iterator[None]:
    """Inside, names come from `file`: `imported` refuses what the user has not named, and no loaded module has.

    prints: fingerprints of what it names, as `fingerprints` gave them when it was written; others are refused.
    loaded: may it name what is in a module that the program has loaded already: for classes, which are looked at first.
    """
    before = _data.set((file, prints if isinstance(prints, Mapping) else {}, loaded))
    try:
        yield
    finally:
        _data.reset(before)


def is_outside(name: str) -> bool:
    """Does the name point out of the library: to a file, or to a module, and a thing in it?"""
    return ":" in name


def imported(name: str, where: str, parent: str = "") -> Any:
    """The thing that `name` points to, such as the function `make` of my_file.py.

    name: `FILE.py:THING` or `PACKAGE.MODULE:THING`. where: what it is wanted for, such as `controller`; errors begin
    with it. parent: the module that `from . import` in a file means. A file is run as it stands now, with its folder on
    the path, so that it can import its neighbours. Raises ValueError, in one line, for a file or module that is not
    there, or fails when it is run, or lacks the thing, or is named by a file alone: see `named_in`.
    """
    home, _, thing = name.rpartition(":")
    where = f"{where} '{name}'"
    require(home and thing.isidentifier(), where, "expected FILE.py:NAME or PACKAGE.MODULE:NAME")
    _note(home, where)
    module = _module(home, where, parent)
    public = [key for key in vars(module) if not key.startswith("_")]
    require(hasattr(module, thing), where, f"{home} has no '{thing}'; it has {', '.join(public) or 'nothing'}")
    return getattr(module, thing)


def _note(home: str, where: str) -> None:
    """Take note of what the user names; refuse what a file alone does, and what has changed since that was written."""
    if (data := _data.get()) is None:
        _mine.add(home)
        return
    file, prints, loaded = data
    loaded = loaded and not home.endswith(".py") and home in sys.modules
    trust = f"if you trust it: steerkit --code {home} ..., or import it in Python"
    require(loaded or home in _mine, where, f"{file} names it, and nothing that a file names is run; {trust}")
    changed = f"{home} has changed since {file} was written: another SHA-256"
    require(prints.get(home) in (None, _print(home, where)), where, changed)


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
    home, where = name.rpartition(":")[0], f"{where} '{name}'"
    if _data.get():
        _note(home, where)
    return _print(home, where)


def _print(home: str, where: str) -> str:
    if home.endswith(".py"):
        return _digest(_text(Path(home), where))
    _module(home, where)
    file = getattr(sys.modules[home], "__file__", None)
    return _digest(Path(file).read_bytes()) if file else ""


def fingerprints(data: Any) -> dict[str, str]:
    """Of all that nested tables name as `kind`, `doe` or `plant`, by file or module."""
    found = dict[str, str]()
    for key, value in data.items():
        if isinstance(value, dict):
            found |= fingerprints(value)
        elif key in ("kind", "doe", "plant") and is_outside(str(value)):
            found[value.rpartition(":")[0]] = fingerprint(value, key)
    return found


def _module(home: str, where: str, parent: str = "") -> ModuleType:
    """The module of that name, or in that file."""
    text = _text(Path(home), where) if home.endswith(".py") else None
    try:
        return importlib.import_module(home) if text is None else _run(Path(home).resolve(), text, parent)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        what = f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"
        raise ValueError(f"{where}: {home} fails when it is imported: {what}") from error


@lru_cache
def _run(file: Path, text: bytes, parent: str = "") -> ModuleType:
    """The module in a file; once for each text, so that classes in it stay the same ones."""
    key = f"{parent}{'.' * bool(parent)}{_PREFIX}{_digest(str(file).encode() + text)}_{file.stem}"
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


def _text(file: Path, where: str) -> bytes:
    try:
        return read_bytes(file)
    except OSError as error:
        raise ValueError(f"{where}: {file} cannot be read ({error.strerror}), looked for in {Path.cwd()}") from error


def _digest(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()[:16]
