"""Command lines: run in this process, or checked without being run."""

import contextlib
from collections.abc import Sequence

import pytest
import typer

from steerkit.cli import app as cli


def parsed(words: Sequence[str]) -> None:
    """Parse `steerkit WORDS` as the command line does; raises its usage error. `--help` asks for no arguments."""
    command, rest = cli.command(), list(words)
    while hasattr(command, "resolve_command") and rest != ["--help"]:
        _, command, rest = command.resolve_command(typer.Context(command), rest)
    with contextlib.suppress(typer.Exit), command.make_context(command.name, rest):
        pass


def run(*words: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """Run `steerkit WORDS`; its exit code."""
    monkeypatch.setattr("sys.argv", ["steerkit", *words])
    try:
        cli.main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0
