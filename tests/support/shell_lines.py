"""The shell lines that README, CONTRIBUTING and docs show a reader, and what the tests do with each of them."""

import functools
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from tests.support.places import ROOT, SUPPORT

DOORS = [ROOT / "docs" / f"{name}.md" for name in ("control-engineer", "rl-researcher", "vehicle-tester")]
"""The pages for users (test_package.py)."""
PAGES = list(
    dict.fromkeys([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOORS, *sorted((ROOT / "docs").glob("**/*.md"))])
)
"""In this order: what a page shows too that an earlier one has shown is run but once."""
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)
FITTED = ("identification", "vehicle-tester")
"""Pages whose programs fit models to recordings, which takes longer than to optimise what drives them."""
TABLE = SUPPORT / "shell_lines.toml"
STUDIES = tuple(sorted({file.stem for file in (ROOT / "benchmarks" / "studies").glob("*.py")} - {"__init__"}))
EXAMPLES = tuple(sorted(file.name for file in (ROOT / "examples").glob("*.py")))
STUDY = "python -m benchmarks study {} --quick --json"
EXAMPLE = "python examples/{} --quick"
"""How each study (tests/unit/benchmarks/studies) and each example is run, whether a page names it or not."""
PROGRAMS = ("steerkit", "python", "pip", "make", "dask", "git")
"""Inline code is a command if it begins with one of these and goes on after a space."""


def blocks(page: Path) -> list[tuple[str, str]]:
    """(language, text) of the fenced blocks."""
    return BLOCK.findall(page.read_text(encoding="utf-8"))


def lines_in(text: str) -> list[str]:
    """The commands in a block, each in one line, without its comment."""
    lines = re.sub(r"\s*\\\n\s*", " ", text).splitlines()
    return [line for line in (re.sub(r"(^|\s)# .*", "", line).strip() for line in lines) if line]


@functools.cache
def lines_of(page: Path) -> list[str]:
    """The commands on a page: each line of a block without a language or marked `sh`, then those in running text."""
    fenced = [line for language, text in blocks(page) if language in ("", "sh") for line in lines_in(text)]
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    inline = [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", text)]
    return [*fenced, *(code for code in inline if code.partition(" ")[0] in PROGRAMS and " " in code)]


@dataclass(frozen=True, kw_only=True)
class Step:
    """A line as it is run by the tests."""

    shown: str
    """The line as the reader sees it."""
    run: str
    """The line as it is run, a shorter form where the one shown takes long."""
    package: str = ""
    """One that not every environment has: see `possible`."""
    needs: tuple[str, ...] = ()
    """Files that have to be there: those that the text has the reader make."""
    files: tuple[str, ...] = ()
    """Files that the line is to make; patterns."""
    prints: str = ""
    """Regular expression for its standard output; of a program that stays, for the line that says that it is up."""
    stays: bool = False
    """A program that runs until it is stopped: it stays in the background until the page ends."""
    ends: bool = False
    """Is nothing that stays needed after this line?"""
    codes: tuple[int, ...] = (0,)
    """Exit codes that it may end with."""

    @property
    def possible(self) -> bool:
        """Is the package installed that the line needs? Else it is left out, and what it would make is made."""
        return not self.package or find_spec(self.package) is not None


def step(shown: str, **changes: object) -> Step:
    """A step from its entry in the table; tuples where TOML has arrays."""
    fields = {name: tuple(value) if isinstance(value, list) else value for name, value in changes.items()}
    return Step(**{"shown": shown, "run": shown, **fields})  # type: ignore[arg-type]


@functools.cache
def table() -> tuple[dict[str, Step], dict[str, str]]:
    """(line -> how it is run, line -> why it is not run), as tests/support/shell_lines.toml says."""
    text = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    reasons = {line: group["reason"] for group in text["not_run"] for line in group["lines"]}
    steps = [step(**entry) for entry in text["line"]]
    if len({s.shown for s in steps}) != len(steps) or reasons.keys() & {s.shown for s in steps}:
        raise ValueError(f"{TABLE.name}: a line stands in it twice")
    return {s.shown: s for s in steps}, reasons


def steps_of(page: Path) -> Iterator[Step]:
    """What is run of a page, in its order: each line in its short form or, if the table does not know it, as it stands.

    What has been run in the same form for an earlier page, or as a study or an example, is not run again.
    """
    steps, reasons = table()
    earlier = {*map(STUDY.format, STUDIES), *map(EXAMPLE.format, EXAMPLES)}
    for other in PAGES[: PAGES.index(page)]:
        earlier |= {steps.get(line, step(line)).run for line in lines_of(other)}
    for line in lines_of(page):
        now = steps.get(line, step(line))
        if line not in reasons and now.run not in earlier:
            earlier.add(now.run)
            yield now
