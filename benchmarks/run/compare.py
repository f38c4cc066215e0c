"""What changed between two results: provenance, cases that came or went, and metrics, case by case."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.run.results import TIMES, Results

REL, ABS = 1e-9, 1e-12
"""By how much a number may differ, of its size and in its unit, and still count as the same."""


@dataclass(frozen=True)
class Change:
    """A number of one case that is not the same."""

    case: str
    metric: str
    before: float
    after: float

    @property
    def relative(self) -> float:
        """Change over the number before [1]; infinite where that is 0 or either is no number."""
        gap = self.after - self.before
        return abs(gap / self.before) if self.before and math.isfinite(gap) else math.inf


@dataclass(frozen=True)
class Comparison:
    """Everything that differs between results A and B."""

    provenance: dict[str, tuple[Any, Any]]
    """Entries that differ: versions, commit, processor, ..."""
    only_a: tuple[str, ...]
    """Cases that only A has."""
    only_b: tuple[str, ...]
    """Cases that only B has."""
    status: tuple[tuple[str, str, str], ...]
    """Cases that ended differently: id, how in A, how in B."""
    changes: tuple[Change, ...]
    """Metrics beyond the tolerance, the largest relative change first."""
    compared: int
    """Numbers that were compared."""

    @property
    def same(self) -> bool:
        """Do all numbers agree, of the same cases?"""
        return not (self.only_a or self.only_b or self.status or self.changes)


def compare(a: Results, b: Results, *, rel: float = REL, absolute: float = ABS) -> Comparison:
    """Compare case by case; computing times are left out. Raises ValueError when no case is in both.

    rel [1], absolute [the metric's unit]: a number is the same if |b - a| <= max(rel*max(|a|, |b|), absolute).
    """
    if not (rel >= 0.0 and absolute >= 0.0):
        raise ValueError(f"compare: rel = {rel}, absolute = {absolute}, expected >= 0")
    first, second = ({case.id: case for case in results.cases} for results in (a, b))
    both = [name for name in first if name in second]
    if not both:
        raise ValueError(f"compare: {a.place} and {b.place} have no case in common; run the same suite")
    status, changes, compared = [], [], 0
    for name in both:
        one, two = first[name], second[name]
        if (one.status, one.error) != (two.status, two.error):
            status.append((name, one.error or one.status, two.error or two.status))
        before, after = ({k: x for k, x in c.metrics.items() if f"metric.{k}" not in TIMES} for c in (one, two))
        compared += len({*before, *after})
        changes += differences(name, before, after, rel, absolute)
    keys = ("commit", "dirty", "source", "versions", "platform", "processor", "cores")
    facts = {key: (a.provenance.get(key), b.provenance.get(key)) for key in keys}
    return Comparison(
        provenance={key: pair for key, pair in facts.items() if pair[0] != pair[1]},
        only_a=tuple(name for name in first if name not in second),
        only_b=tuple(name for name in second if name not in first),
        status=tuple(status),
        changes=tuple(sorted(changes, key=lambda change: -change.relative)),
        compared=compared,
    )


def differences(
    case: str, before: Mapping[str, float], after: Mapping[str, float], rel: float, absolute: float
) -> list[Change]:
    """Metrics of a case that are not the same within the tolerance, or came or went (NaN on the other side)."""
    pairs = {name: (before.get(name, math.nan), after.get(name, math.nan)) for name in {**before, **after}}
    return [Change(case, name, a, b) for name, (a, b) in pairs.items() if not _same(a, b, rel, absolute)]


def _same(a: float, b: float, rel: float, absolute: float) -> bool:
    """Are two numbers equal within the tolerance? Two NaN are, and equal infinities."""
    return (math.isnan(a) and math.isnan(b)) or math.isclose(a, b, rel_tol=rel, abs_tol=absolute)
