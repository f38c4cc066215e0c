"""Golden numbers of the small suite `golden`: what they are, what differs, how to renew them."""

import json
from collections.abc import Mapping
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory

from benchmarks.run.compare import Change, differences
from benchmarks.run.results import Results
from benchmarks.run.runner import run
from benchmarks.suites import suite
from steerkit._support.files import write_text

FILE = FilePath(__file__).parents[2] / "tests" / "golden" / "benchmarks.json"
"""Where the golden numbers are in a checkout; they are no part of an installed package."""
TOLERANCES = {"rel": 1e-6, "abs": 1e-8}
"""Other compilers and libms move the numbers by 1e-12 or so; anything that counts moves them by far more."""
Numbers = Mapping[str, Mapping[str, float]]
"""Metrics by case."""


def measured() -> Results:
    """The suite `golden`, run anew; only the cases in memory are left of it."""
    with TemporaryDirectory() as place:
        return run([suite("golden")], FilePath(place) / "golden", workers=1, quiet=True)


def numbers(results: Results) -> dict[str, dict[str, float]]:
    """Metrics by case. Raises ValueError for a case that ended with an error."""
    for case in results.cases:
        if case.status != "done":
            raise ValueError(f"golden: {case.id}: {case.error}")
    return {case.id: dict(case.metrics) for case in results.cases}


def kept(file: FilePath) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """The golden numbers and their tolerances. Raises ValueError for a missing or broken file."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        return data["cases"], data["tolerances"]
    except FileNotFoundError as error:
        what = f"{file} is missing, which only a checkout has; `python -m benchmarks golden --update` makes it"
        raise ValueError(what) from error
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{file} is broken ({error}); `python -m benchmarks golden --update` makes it anew") from error


def difference(new: Numbers, old: Numbers, tolerances: Mapping[str, float]) -> list[Change]:
    """Every number that is not the golden one, and every one that came or went (NaN on the other side)."""
    changes = list[Change]()
    for case in {**old, **new}:
        changes += differences(case, old.get(case, {}), new.get(case, {}), tolerances["rel"], tolerances["abs"])
    return changes


def update(new: Numbers, file: FilePath) -> None:
    """Make these the golden numbers."""
    data = {
        "about": "python -m benchmarks golden; renew with --update, which prints the difference",
        "tolerances": TOLERANCES,
        "cases": new,
    }
    write_text(file, json.dumps(data, indent=1) + "\n")
