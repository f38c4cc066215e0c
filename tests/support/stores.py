"""Transitions in a store, and whether two records are the same."""

from pathlib import Path

import numpy as np

from steerkit.learning.data.store import TransitionStore
from steerkit.learning.data.transitions import Transitions

AWKWARD = (-0.0, 5e-324, 0.1 + 0.2, -1e300, 1.0, -3.5)
ARRAYS = ("s", "a", "s_next", "episode", "own")


def drive(n: int, seed: int = 0, first_episode: int = 1) -> Transitions:
    rng = np.random.default_rng(seed)
    record = Transitions()
    s, a, s_next = rng.normal(size=(n, 6)), rng.normal(size=n), rng.normal(size=(n, 6))
    record.extend(s, a, s_next, first_episode + np.arange(n) // 10, np.arange(n) % 3 > 0)
    return record


def same(one: Transitions, other: Transitions) -> bool:
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in ARRAYS)


def kept(path: Path, record: Transitions, run: str = "a") -> Path:
    with TransitionStore(path, run=run) as store:
        fill(store, record)
    return path


def fill(store: TransitionStore, record: Transitions) -> None:
    """Append all of a record."""
    for row in zip(*(getattr(record, name).tolist() for name in ARRAYS)):
        store.append(*row)
