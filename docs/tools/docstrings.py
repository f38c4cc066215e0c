"""Docstrings for the site: they are written for the terminal, with equations as plain lines, which are typeset here,
and Markdown must not make emphasis of a product.

An indented block is equations, and so is a paragraph that begins with one; what follows after `::` is shown as it is.
"""

from __future__ import annotations

import inspect
import logging
import re
import sys
from pathlib import Path
from typing import Any

import griffe

sys.path.insert(0, str(Path(__file__).parent))
from formulas import FormulaError, typeset

EQUATION = re.compile(r"^(\([\w', ]+\)|[A-Za-z_][\w.']*(\([^)]*\))?)'*\s+(=|<-|~)\s")
FIELD = re.compile(r"^(inputs?|outputs?|state|valid|errors|source|parameters?|raises|returns|no inputs)\b", re.I)
SPECIAL = re.compile(r"(\*\*[\w ]+\*\*)|([\\*_{}\[\]<>#|$])")
"""What Markdown would take for its own; **bold** is meant."""
ENTITIES = {"<": "&lt;", ">": "&gt;"}


log = logging.getLogger("mkdocs.docstrings")


def as_markdown(text: str) -> str:
    """The same text in Markdown, its equations in HTML. Raises FormulaError for lines that are none."""
    shown: list[str] = []
    announced = literal = False
    for block in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        literal = announced or (literal and block.startswith("    "))
        announced = not literal and block.endswith("::")
        shown.append(_code(block) if literal else _block(block[:-1] if announced else block))
    return "\n\n".join(shown)


def _code(block: str) -> str:
    return "```text\n" + inspect.cleandoc("\n" + block) + "\n```"


def _block(block: str) -> str:
    lines = block.split("\n")
    at = next((i for i, line in enumerate(lines) if line.startswith("    ")), len(lines))
    if EQUATION.match(lines[0]) or at == 0:
        return typeset(inspect.cleandoc("\n" + block))
    if at < len(lines):  # a text that runs into its equation
        return _text(lines[:at]) + "\n\n" + _block("\n".join(lines[at:]))
    return _text(lines)


def _text(lines: list[str]) -> str:
    """Markdown's characters escaped outside backticks; a new line before each of inputs, outputs, state, ..."""
    shown = []
    for n, line in enumerate(lines):
        parts = line.split("`")
        parts[::2] = [SPECIAL.sub(_literally, part) for part in parts[::2]]
        mark = (
            "" if n == 0 or not (FIELD.match(line) or line.startswith("* ")) else "\n" if line[0] == "*" else "<br>\n"
        )
        shown.append(mark + "`".join(parts).replace("\\* ", "* ", 1 if line.startswith("* ") else 0))
    return "\n".join(shown)


def _literally(found: re.Match[str]) -> str:
    return found[1] or ENTITIES.get(found[2], f"\\{found[2]}")


class Docstrings(griffe.Extension):
    """Rewrites every docstring as it is read."""

    def on_instance(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Called by griffe for every object."""
        if obj.docstring:
            try:
                obj.docstring.value = as_markdown(obj.docstring.value)
            except FormulaError as error:
                log.warning("%s: %s (docs/tools/formulas.py says what is understood)", obj.path, error)
