"""Single measurements, each a module here, all called alike: `python -m benchmarks study NAME [--quick] [--json] ...`.

A study module has a docstring, whose first line says what it measures, and these functions:

    measure(options) -> dict     measures, prints tables for people, returns its figures
    add_options(parser)          its own command line options, beside --quick and --json, if it has any
    objection(figures) -> str    why its figures do not count, or nothing, if it compares what may differ
`--quick` is a form that takes seconds: it shows that a study runs, not what it measures.
"""

import argparse
import ast
import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from steerkit._support.errors import known

_FILES = {file.stem: file for file in sorted(Path(__file__).parent.glob("*.py")) if file.stem != "__init__"}
NAMES = tuple(_FILES)
"""All studies."""
_EXTRA = {
    **dict.fromkeys(("car_kill", "car_realtime"), "car"),
    "foreign": "peers",
    "gym_steps": "gym",
    "production_cars": "production",
}
"""Studies that need an extra of the package, and which."""
_OF_MANY = {"joblib": "bench", "distributed": "bench"}
"""Packages that several studies need, and the extra that brings them."""


@cache
def about(name: str) -> str:
    """The first line of a study's docstring; nothing is imported for it. Raises ValueError for an unknown name."""
    file = _FILES[known(name, _FILES, "study")]
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.split("\n", 1)[0]


def parser_of(name: str, study: ModuleType) -> argparse.ArgumentParser:
    """The command line of a study."""
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks study {name}",
        description=study.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--quick", action="store_true", help="a form that takes seconds: not a measurement")
    parser.add_argument("--json", action="store_true", help="print one JSON object as the last line")
    if hasattr(study, "add_options"):
        study.add_options(parser)
    return parser


def carry_out(name: str, words: Sequence[str] = ()) -> dict[str, Any]:
    """Run a study with command line words and return its figures, as JSON can hold them.

    Numbers that are not finite become None. Raises ValueError for an unknown name or a missing extra; SystemExit for a
    usage error, or after all is printed when the study objects to its own figures.
    """
    known(name, _FILES, "study")
    try:
        study = import_module(f"benchmarks.studies.{name}")
        options = parser_of(name, study).parse_args(list(words))
        figures = _plain(study.measure(options))
    except ModuleNotFoundError as error:
        extra = _OF_MANY.get(error.name or "") or _EXTRA.get(name)
        if extra is None:
            raise
        what = f"study {name}: {error.name} is not installed"
        raise ValueError(f"{what}: pip install 'steerkit-control[{extra}]'") from error
    if options.json:
        print(json.dumps(figures, allow_nan=False), flush=True)
    objection = study.objection(figures) if hasattr(study, "objection") else ""
    if objection:
        raise SystemExit(f"study {name}: {objection}")
    return figures


def _plain(value: Any) -> Any:
    """What JSON knows: text keys, and None for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
