"""A command line as a function: what it prints, for the exit code that is expected."""

import json
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from tests.support.command_lines import run


@pytest.fixture(autouse=True)
def quick(undrawn: None) -> None:
    """Commands make many pictures."""


class Said(NamedTuple):
    """What a command printed."""

    out: str
    err: str

    @property
    def json(self) -> Any:
        """The last line on standard output."""
        return json.loads(self.out.strip().splitlines()[-1])


@pytest.fixture
def cli(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    def said(*words: object, code: int = 0) -> Said:
        assert run(*map(str, words), monkeypatch=monkeypatch) == code
        return Said(*capsys.readouterr())

    return said
