"""Rules that the tests themselves keep, and habits of the code that no tool checks."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.support.house import tree
from tests.support.places import ROOT

TESTS = sorted((ROOT / "tests").rglob("*.py"))


def gives(file: Path, keyword: str) -> bool:
    """Does any call in a file give that keyword?"""
    calls = (node for node in ast.walk(tree(file)) if isinstance(node, ast.Call))
    return any(given.arg == keyword for call in calls for given in call.keywords)


def test_no_property_has_a_deadline_and_one_profile_says_so() -> None:
    """How fast a machine is, is no property of the code."""
    assert settings().deadline is None
    assert [file.name for file in TESTS if gives(file, "deadline")] == ["conftest.py"]


CODE = [file for folder in ("steerkit", "benchmarks") for file in sorted((ROOT / folder).rglob("*.py"))]


def in_the_machines_encoding(tree: ast.AST) -> Iterator[str]:
    """Calls that read or write text in whatever encoding the machine is set to."""
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        given = {keyword.arg: keyword.value for keyword in call.keywords}
        if "encoding" in given:
            continue
        method = isinstance(call.func, ast.Attribute)
        name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        if ast.unparse(given.get("text", call)) == "True" or (method and name in ("read_text", "write_text")):
            yield ast.unparse(call)
        elif name in ("open", "fdopen"):
            modes = [*call.args[0 if method and name == "open" else 1 :], *([given["mode"]] if "mode" in given else [])]
            text = [mode.value for mode in modes[:1] if isinstance(mode, ast.Constant) and isinstance(mode.value, str)]
            if (text and "b" not in text[0]) or (not modes and (not method or not call.args)):
                yield ast.unparse(call)


@pytest.mark.skipif(not CODE, reason="runs on the sources; here steerkit is installed")
def test_text_is_utf_8_whatever_the_machine_is_set_to() -> None:
    calls = {file: [*in_the_machines_encoding(tree(file))] for file in CODE}
    assert not [f"{file.relative_to(ROOT)}: {call}" for file, found in calls.items() for call in found]


@pytest.mark.parametrize(
    "call",
    [
        "file.read_text()",
        "file.write_text(text)",
        "open(file)",
        "open(file, 'w')",
        "open(file, mode='a')",
        "file.open()",
        "file.open('w')",
        "os.fdopen(number, 'w')",
        "subprocess.run(words, text=True)",
    ],
)
def test_the_machines_encoding_is_seen(call: str) -> None:
    assert [*in_the_machines_encoding(ast.parse(call))] == [ast.unparse(ast.parse(call))]


@pytest.mark.parametrize(
    "call",
    [
        "file.read_text(encoding='utf-8')",
        "open(file, 'rb')",
        "file.open('wb')",
        "archive.open(member)",
        "os.open(device, os.O_RDWR)",
        "write_text(file, text)",
        "subprocess.run(words, encoding='utf-8')",
    ],
)
def test_what_says_its_encoding_or_needs_none_passes(call: str) -> None:
    assert not [*in_the_machines_encoding(ast.parse(call))]
