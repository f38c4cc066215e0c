"""steerkit beside the best that others wrote, in their own measure: each part of it is a table and some figures.

    python -m benchmarks study scoreboard [--parts PART ...] [--quick] [--json]

Parts (`benchmarks.scoreboard`): what each measures stands in its docstring, whose first line is printed before its
table.
"""

import argparse
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from benchmarks import scoreboard
from benchmarks.run import spread

PARTS = tuple(sorted(file.stem for file in Path(scoreboard.__path__[0]).glob("*.py") if file.stem != "__init__"))
"""All parts."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which parts, and the options of each."""
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="what to measure (default all)")
    spread.add_options(parser)
    for part in PARTS:
        _module(part).add_options(parser.add_argument_group(f"of the part {part}"))


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the parts, one after the other."""
    figures: dict[str, Any] = {}
    for part in options.parts:
        module = _module(part)
        print((module.__doc__ or part).split("\n", 1)[0], flush=True)
        figures |= module.measure(options)
    return figures


def _module(part: str) -> ModuleType:
    return import_module(f"benchmarks.scoreboard.{part}")
