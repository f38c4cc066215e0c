"""Docstrings for the site: they are written for the terminal, with equations as plain lines, and Markdown must not
make emphasis of a product or a paragraph of three equations."""

from __future__ import annotations

import inspect
import re
from typing import Any

import griffe

EQUATION = re.compile(r"^(\([\w', ]+\)|[A-Za-z_][\w.']*(\([^)]*\))?)'*\s+(=|<-|~)\s")
FIELD = re.compile(r"^(inputs?|outputs?|state|valid|errors|source|parameters?|raises|returns|no inputs)\b", re.I)
SPECIAL = re.compile(r"(\*\*[\w ]+\*\*)|([\\*_{}\[\]<>#|])")
"""What Markdown would take for its own; **bold** is meant."""


def as_markdown(text: str) -> str:
    """The same text in Markdown: equations and indented lines as code, everything else literally."""
    blocks = re.split(r"\n\s*\n", inspect.cleandoc(text))
    return "\n\n".join(_block(block) for block in blocks)


def _block(block: str) -> str:
    lines = block.split("\n")
    at = next((i for i, line in enumerate(lines) if line.startswith("    ")), len(lines))
    if EQUATION.match(lines[0]) or at == 0 or _is_table(lines):
        return "```text\n" + inspect.cleandoc("\n" + block) + "\n```"
    if at < len(lines):  # a text that runs into its equation
        return _text(lines[:at]) + "\n\n" + _block("\n".join(lines[at:]))
    return _text(lines)


def _is_table(lines: list[str]) -> bool:
    return len(lines) > 1 and sum("   " in line.strip() for line in lines) > len(lines) / 2


def _text(lines: list[str]) -> str:
    """Markdown's characters escaped outside backticks; a new line before each of inputs, outputs, state, ..."""
    shown = []
    for n, line in enumerate(lines):
        parts = line.split("`")
        parts[::2] = [SPECIAL.sub(lambda found: found[1] or f"\\{found[2]}", part) for part in parts[::2]]
        mark = (
            "" if n == 0 or not (FIELD.match(line) or line.startswith("* ")) else "\n" if line[0] == "*" else "<br>\n"
        )
        shown.append(mark + "`".join(parts).replace("\\* ", "* ", 1 if line.startswith("* ") else 0))
    return "\n".join(shown)


class Docstrings(griffe.Extension):
    """Rewrites every docstring as it is read."""

    def on_instance(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Called by griffe for every object."""
        if obj.docstring:
            obj.docstring.value = as_markdown(obj.docstring.value)
