"""Recorded transitions (s, a, s_next): all that the learner ever sees of a car, and who steered."""

import copy
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steerkit._support.errors import optional, require
from steerkit._support.files import read_arrays, write_arrays
from steerkit.controllers.policy import StateDescription

if TYPE_CHECKING:
    import pandas as pd


class Transitions:
    """A growing record of transitions in contiguous arrays.

    s, s_next: states and those one sample later (n, columns) float64, SI; a: actions (n,) float64 [rad]; episode: their
    numbers (n,) int64; own: (n,) bool, False where another than the learner steered, such as the recovery controller:
    that teaches how the car answers, and no Q-function. Consecutive rows of one episode are consecutive samples;
    whoever records starts a new episode number at every break in time. Appending costs O(1) on average: the arrays
    double. The attributes of these names are read-only views of what is recorded so far; a view taken earlier stays
    valid and does not grow. Non-finite rows are refused with ValueError. rows: what is recorded at first, as for
    `extend`.
    """

    s: NDArray[np.float64]
    a: NDArray[np.float64]
    s_next: NDArray[np.float64]
    episode: NDArray[np.int64]
    own: NDArray[np.bool_]

    def __init__(self, names: Sequence[str] = StateDescription().names, *rows: ArrayLike):
        require(len(names) > 0, "Transitions", "names is empty, expected the state's columns")
        self.names, none = tuple(names), np.empty((0, len(names)))
        self._kept = {"s": none, "a": none[:, 0], "s_next": none, "episode": none[:, 0].astype(np.int64)}
        self._kept["own"] = none[:, 0].astype(bool)
        self.extend(*rows or (none, (), none, ()))

    def __len__(self) -> int:
        return len(self.a)

    def __repr__(self) -> str:
        return f"Transitions({len(self)} rows, {len(np.unique(self.episode))} episodes of {', '.join(self.names)})"

    def append(self, s: ArrayLike, a: float, s_next: ArrayLike, episode: int, own: bool = True) -> None:
        """Record one transition; raises ValueError for a wrong length or a non-finite number."""
        self.extend(np.atleast_2d(s), [a], np.atleast_2d(s_next), [episode], own)

    def extend(self, s: ArrayLike, a: ArrayLike, s_next: ArrayLike, episode: ArrayLike, own: ArrayLike = True) -> None:
        """Record n transitions: s, s_next (n, columns), a (n,), episode, own (n,) or one each; all or none of them."""
        s, a, s_next = np.asarray(s, dtype=float), np.asarray(a, dtype=float), np.asarray(s_next, dtype=float)
        n, columns = a.size, len(self.names)
        for name, rows in (("s", s), ("s_next", s_next)):
            fault = f"{name} of shape {rows.shape}, expected ({n}, {columns}): {', '.join(self.names)}"
            require(rows.shape == (n, columns) and a.shape == (n,), "Transitions", fault)
            if not np.isfinite(rows).all():
                row, column = np.argwhere(~np.isfinite(rows))[0]
                fault = f"{name}.{self.names[column]} = {rows[row, column]} in row {row}, expected a finite number"
                raise ValueError(f"Transitions: {fault}; end the episode before the faulty sample")
        require(bool(np.isfinite(a).all()), "Transitions", f"a = {a[~np.isfinite(a)][:1]} [rad], expected finite")
        begin = len(getattr(self, "a", ()))
        end, each = begin + n, [np.broadcast_to(values, n) for values in (episode, own)]
        for name, rows in zip(self._kept, (s, a, s_next, *each)):
            kept = self._kept[name]
            if end > len(kept):
                kept = np.empty((max(end, 2 * begin, 256), *kept.shape[1:]), dtype=kept.dtype)
                kept[:begin] = self._kept[name][:begin]
                self._kept[name] = kept
            kept[begin:end] = rows
            view = kept[:end]
            view.flags.writeable = False
            setattr(self, name, view)

    def frozen(self) -> "Transitions":
        """The rows of this moment, without a copy: recorded rows never change."""
        same = copy.copy(self)
        same._kept = {name: getattr(self, name) for name in self._kept}
        return same

    def part(self, rows: slice | NDArray[Any]) -> "Transitions":
        """Those rows alone, copied."""
        return Transitions(self.names, *(getattr(self, name)[rows] for name in self._kept))

    def to_pandas(self) -> "pd.DataFrame":
        """A row a transition, in SI: s by its columns' names, a, s_next with `next_` before them, episode, own.

        Needs pandas (extra `bench`).
        """
        pandas = optional("pandas", "Transitions.to_pandas", "bench")
        columns = [*self.names, "a", *(f"next_{name}" for name in self.names)]
        frame: pd.DataFrame = pandas.DataFrame(np.column_stack([self.s, self.a, self.s_next]), columns=columns)
        return frame.assign(episode=self.episode, own=self.own)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything to one .npz file (no pickle)."""
        write_arrays(path, "transitions", {name: getattr(self, name) for name in ("names", *self._kept)})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Transitions":
        """What `save` wrote, bit for bit; raises ValueError for a truncated or foreign file."""
        f = read_arrays(path, "transitions")
        try:
            return cls(f["names"].tolist(), f["s"], f["a"], f["s_next"], f["episode"], f["own"])
        except (ValueError, TypeError, KeyError) as why:
            raise ValueError(f"{path}: the transitions in it do not hold together: {why}") from why
