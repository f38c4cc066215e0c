"""Rules that the tests themselves keep."""

import ast
from pathlib import Path

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
